//! A worker's session with its server, from registration to the end: renews leases, reports results, takes
//! new batches, and drops revoked leases. It renders nothing itself.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use proto::worker_protocol::{
    Batch, BatchWork, LeaseOutcome, LeaseReport, RegisterResponse, SyncRequest, SyncResponse, TileRecord, TracedBatch,
};
use proto::{JobId, LeaseId};
use tokio::sync::mpsc::{self, UnboundedReceiver, UnboundedSender};
use tokio::task::{JoinError, JoinSet};
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;
use tracing::Instrument;

use super::AgentConfig;
use super::back_off::BackOff;
use super::beside::Beside;
use super::executor::{BatchEvent, BatchExecutor, LeaseHandle};
use super::metrics::MetricsBuffer;
use super::pending_sync::PendingSync;
use super::rendering::milliseconds;
use super::server_client::{ServerClient, ServerError};
use super::store_access::StoreAccess;
use super::throughput::ThroughputEstimate;
use crate::image::Encoders;
use crate::renderer::Renderer;

/// A batch that used the device for at most this long is short: the next one is requested while it renders, so
/// that the device does not wait for the server. After longer batches nothing is requested ahead.
const SHORT_BATCH: Duration = Duration::from_millis(50);
/// Device time of the short batches that are requested ahead.
const AHEAD: Duration = Duration::from_millis(100);
/// Maximum number of short batches that wait for the device or use it.
const MAX_AHEAD: usize = 16;
/// How long a call may take beyond the wait requested of the server.
const TIMEOUT_MARGIN: Duration = Duration::from_secs(10);
/// Minimum time between the starts of two waiting calls.
const MIN_SYNC_INTERVAL: Duration = Duration::from_millis(50);
/// While a batch is unfinished, its reports are held back for up to 200 ms and sent together, because each call
/// costs the server a commit.
const REPORT_DELAY: Duration = Duration::from_millis(200);
/// Timeout of the last call of a session.
const FINAL_SYNC_TIMEOUT: Duration = Duration::from_secs(2);

/// Reason for the end of a session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum SessionEnd {
    /// The worker was drained, and holds no leases.
    Drained,
    /// The server does not know this worker, or no longer.
    NotRegistered,
    /// The device is lost, for this reason; no leases are held any more.
    DeviceLost(String),
    /// A render does not stop, for this reason; no leases are held any more.
    Stuck(String),
}

/// State of a session.
pub(super) struct Session {
    link: Arc<ServerClient>,
    registration: RegisterResponse,
    lease: Duration,
    grace: Duration,
    workbench: Arc<BatchExecutor>,
    events: UnboundedReceiver<BatchEvent>,
    /// Stored so that `events` never closes.
    _events: UnboundedSender<BatchEvent>,
    runs: JoinSet<()>,
    /// Number of batches still rendering, without those beside them.
    rendering: usize,
    beside: Beside,
    /// How long the last batch used the device, if it was short.
    last_short_batch: Option<Duration>,
    /// Job of the last batch rendered, if it was a whole frame.
    rendered_frame_of: Option<JobId>,
    /// Job of the last batch accepted, if it is a whole frame.
    accepted_frame_of: Option<JobId>,
    /// Reason to end the session at once, if there is one.
    broken: Option<SessionEnd>,
    holds: HashMap<LeaseId, LeaseHandle>,
    pending_reports: Vec<LeaseReport>,
    /// Records of the tiles that are reported.
    records: HashMap<LeaseId, TileRecord>,
    speed: ThroughputEstimate,
    measurements: MetricsBuffer,
    draining: bool,
    /// No work was ready: the next request for work waits until something changes here.
    awaits_change: bool,
    /// Start of the last call that the server responded to.
    last_renewal: Instant,
    /// Earliest time of the next heartbeat.
    heartbeat_at: Instant,
    /// Until then, reports wait to be sent together, if some lease is unfinished.
    report_after: Instant,
    /// Earliest time of the next call after a failed one.
    retry_at: Instant,
    call_back_off: BackOff,
    /// Earliest time of the next request for work, after the server could not store a result.
    claim_after: Instant,
    store_back_off: BackOff,
}

impl Session {
    pub(super) fn new(
        config: &AgentConfig,
        welcome: RegisterResponse,
        link: Arc<ServerClient>,
        renderer: Arc<dyn Renderer>,
        encoders: Encoders,
    ) -> Self {
        let (sender, events) = mpsc::unbounded_channel();
        let measurements = MetricsBuffer::new(&renderer.device());
        let folders = welcome.folders.clone().filter(|_| config.is_pool_worker);
        let store = folders.map_or_else(|| StoreAccess::Server(link.clone()), StoreAccess::Folders);
        let workbench =
            BatchExecutor::new(link.clone(), store, renderer, encoders, config.scratch.clone(), sender.clone());
        let now = Instant::now();
        Self {
            beside: Beside::new(welcome.gives_way),
            lease: Duration::from_millis(welcome.lease_ms),
            registration: welcome,
            grace: config.grace,
            workbench: Arc::new(workbench),
            link,
            events,
            _events: sender,
            runs: JoinSet::new(),
            rendering: 0,
            last_short_batch: None,
            rendered_frame_of: None,
            accepted_frame_of: None,
            broken: None,
            holds: HashMap::new(),
            pending_reports: Vec::new(),
            records: HashMap::new(),
            speed: ThroughputEstimate::default(),
            measurements,
            draining: false,
            awaits_change: false,
            last_renewal: now,
            heartbeat_at: now,
            report_after: now,
            retry_at: now,
            call_back_off: BackOff::new(Duration::from_millis(50), Duration::from_secs(2)),
            claim_after: now,
            store_back_off: BackOff::new(Duration::from_secs(1), Duration::from_secs(30)),
        }
    }

    /// Runs until the worker is drained or unknown; an error is the server's rejection.
    pub(super) async fn work(mut self, shutdown: &CancellationToken) -> Result<SessionEnd, ServerError> {
        let mut call: Option<PendingSync> = None;
        let mut hand_back_at: Option<Instant> = None;
        let ending = loop {
            if let Some(end) = self.broken.take() {
                self.release_leases();
                break Ok(end);
            }
            if self.is_done() {
                break Ok(SessionEnd::Drained);
            }
            self.give_way();
            if call.as_ref().is_some_and(PendingSync::is_heartbeat) && self.must_sync(Instant::now()) {
                call = None;
            }
            if call.is_none() {
                call = self.next_sync();
            }
            let has_heartbeat = call.as_ref().is_some_and(PendingSync::is_heartbeat);
            let (holding, is_quiet) = (!self.holds.is_empty(), call.is_none() || has_heartbeat);
            let (next_at, give_up_at) = (self.next_instant(has_heartbeat), self.leases_expire_at());
            tokio::select! {
                (answered, answer) = PendingSync::response_of(&mut call) => match answer {
                    Ok(reply) => self.on_response(&answered, reply),
                    Err(error) if error.is_not_found() => break Ok(SessionEnd::NotRegistered),
                    Err(error) if error.is_transient() => self.on_failure(answered, &error),
                    Err(error) => break Err(error),
                },
                Some(event) = self.events.recv() => self.on_event(event),
                Some(ended) = self.runs.join_next() => self.on_batch_end(ended),
                () = sleep_until(next_at), if is_quiet => {}
                () = sleep_until(give_up_at), if holding => {
                    tracing::warn!(leases = self.holds.len(), "leases not renewed in time; stopping their work");
                    self.take_back_reports(call.take());
                    self.release_leases();
                }
                () = shutdown.cancelled(), if hand_back_at.is_none() => {
                    self.draining = true;
                    hand_back_at = Some(Instant::now() + self.grace);
                    // Cancels a request for work that is still waiting.
                    call = call.filter(|call| !call.request.wants_work || !call.request.reports.is_empty());
                }
                () = sleep_until(hand_back_at.unwrap_or(next_at)), if hand_back_at.is_some() => {
                    self.release_leases();
                    break Ok(SessionEnd::Drained);
                }
            }
        };
        if let Ok(SessionEnd::Drained | SessionEnd::DeviceLost(_) | SessionEnd::Stuck(_)) = ending {
            self.take_back_reports(call);
            self.final_sync().await;
        }
        for hold in self.holds.values() {
            hold.dropped.cancel();
        }
        ending
    }

    fn is_done(&self) -> bool {
        self.draining && self.holds.is_empty() && self.pending_reports.is_empty() && self.runs.is_empty()
    }

    /// Whether a report must be sent before an open heartbeat returns.
    fn must_sync(&self, now: Instant) -> bool {
        now >= self.retry_at
            && (self.wants_work(now)
                || self.wants_work_beside(now)
                || !(self.pending_reports.is_empty() || self.is_batching_reports(now)))
    }

    fn wants_work(&self, now: Instant) -> bool {
        self.room() > 0 && (self.holds.is_empty() || !self.awaits_change) && !self.draining && now >= self.claim_after
    }

    /// Whether a batch of another submitter could be rendered beside one that takes long, and there may be one.
    fn wants_work_beside(&self, now: Instant) -> bool {
        self.rendering > 0 && self.beside.wants_work(now) && !self.draining && now >= self.claim_after
    }

    /// Time from which the batches of other submitters may be rendered beside one that renders.
    fn gives_way_at(&self) -> Option<Instant> {
        self.beside.gives_way_at().filter(|_| self.rendering > 0 && !self.draining)
    }

    /// Hands back the batches that wait behind one that takes long, so that they can be rendered beside it or elsewhere.
    fn give_way(&mut self) {
        if self.gives_way_at().is_none_or(|at| Instant::now() < at) {
            return;
        }
        self.last_short_batch = None;
        let waiting = self.beside.take_waiting();
        let leases = waiting.iter().filter_map(|hold| self.holds.remove(&hold.lease));
        self.pending_reports.extend(leases.map(|hold| hold.hand_back()));
    }

    /// Whether reports wait for reports of unfinished leases.
    fn is_batching_reports(&self, now: Instant) -> bool {
        !self.holds.is_empty() && now < self.report_after
    }

    /// Records of the tiles of these reports.
    fn records_of(&self, reports: &[LeaseReport]) -> Vec<TileRecord> {
        reports.iter().filter_map(|report| self.records.get(&report.lease).cloned()).collect()
    }

    /// The call to make now, if any.
    fn next_sync(&mut self) -> Option<PendingSync> {
        let now = Instant::now();
        if now < self.retry_at || !(self.must_sync(now) || now >= self.heartbeat_at) {
            return None;
        }
        let (mut holding, mut results): (Vec<_>, _) = (self.holds.keys().copied().collect(), Vec::new());
        if self.is_batching_reports(now) {
            holding.extend(self.pending_reports.iter().map(|report| report.lease));
        } else {
            results = std::mem::take(&mut self.pending_reports);
            // Reports may make work ready: the last tile of a frame creates its stitch.
            self.awaits_change &= results.is_empty();
        }
        let gives_way_at = self.gives_way_at().filter(|_| !self.wants_work(now));
        let beside = gives_way_at.is_some_and(|at| now >= at) && self.beside.has_lane(&self.workbench);
        let wants_work = self.wants_work(now) || beside && self.wants_work_beside(now);
        // The server responds to results at once, so that a lost call is noticed.
        let wait = match (results.is_empty(), wants_work) {
            (true, true) if self.holds.is_empty() => self.lease / 3,
            (true, false) if now < self.claim_after => (self.lease / 6).min(self.claim_after - now),
            (true, false) => {
                let gives_way_in = gives_way_at.filter(|_| !beside).map(|at| at - now);
                gives_way_in.map_or(self.lease / 6, |wait| wait.min(self.lease / 6))
            }
            (true, true) | (false, _) => Duration::ZERO,
        };
        if !results.is_empty() {
            self.report_after = now + REPORT_DELAY;
        }
        let request = SyncRequest {
            worker: self.registration.worker,
            rays_per_second: self.speed.rays_per_second(),
            held_leases: holding,
            records: self.records_of(&results),
            reports: results,
            wants_work,
            beside,
            max_batches: self.room().clamp(1, self.registration.max_batches.max(1)),
            wait_ms: wait.as_millis() as u64,
            shutting_down: false,
            metrics: self.measurements.take(),
        };
        // A waiting call starts only after a pause since the previous one.
        self.heartbeat_at = now + wait.max(MIN_SYNC_INTERVAL);
        Some(PendingSync::new(&self.link, request, wait + TIMEOUT_MARGIN))
    }

    /// Number of further batches that would start rendering soon. Of short frames of one job several are requested in one
    /// call, once half of the last ones have been rendered. Of other batches one is requested ahead: several workers may
    /// share a frame, and another job may be heavier.
    fn room(&self) -> u32 {
        let most = self.last_short_batch.map_or(1, |last| {
            let ahead = AHEAD.as_secs_f64() / last.as_secs_f64().max(1e-3);
            let is_stream = self.accepted_frame_of.is_some() && self.accepted_frame_of == self.rendered_frame_of;
            let most = if self.registration.max_batches > 1 && is_stream { MAX_AHEAD } else { 2 };
            (ahead as usize).clamp(2, most)
        });
        let delivering = self.runs.len().saturating_sub(self.rendering + self.beside.rendering());
        let deliverable = self.workbench.max_uploads().saturating_sub(delivering);
        if self.rendering > most / 2 { 0 } else { (most - self.rendering).min(deliverable) as u32 }
    }

    /// Time of the next call without a new event.
    fn next_instant(&self, has_heartbeat: bool) -> Instant {
        let now = Instant::now();
        let heartbeat = (!has_heartbeat).then_some(self.heartbeat_at);
        let company_until = if self.holds.is_empty() { now } else { self.report_after };
        let results = (!self.pending_reports.is_empty()).then_some(company_until);
        let work = (self.claim_after > now).then_some(self.claim_after);
        let gives_way = self.gives_way_at().filter(|_| self.beside.has_waiting() || self.wants_work_beside(now));
        let first = heartbeat.into_iter().chain(results).chain(work).chain(gives_way).min();
        first.unwrap_or(now + self.lease).max(self.retry_at)
    }

    /// Time from which the leases count as lost, because they have not been renewed.
    fn leases_expire_at(&self) -> Instant {
        self.last_renewal + self.lease * 2 / 3
    }

    fn on_response(&mut self, call: &PendingSync, reply: SyncResponse) {
        let sync_ms = milliseconds(call.start.elapsed());
        let (results, wait_ms, has_run) = (call.request.reports.len(), call.request.wait_ms, reply.batch.is_some());
        tracing::debug!(results, wait_ms, has_run, sync_ms, "synced");
        self.last_renewal = call.start;
        self.call_back_off.reset();
        let reported = call.request.reports.iter().map(|report| &report.lease);
        for lease in reported.chain(&reply.revoked_leases) {
            self.records.remove(lease);
        }
        if !reply.revoked_leases.is_empty() {
            self.heartbeat_at = Instant::now();
        } else if reply.batch.is_none() && call.request.wait_ms > 0 {
            // If the server responds without waiting, calls must still be paced.
            self.retry_at = call.start + MIN_SYNC_INTERVAL;
        }
        if self.pending_reports.iter().any(|report| reply.revoked_leases.contains(&report.lease)) {
            // The report was late; the server still compares it with the first result.
            self.report_after = Instant::now();
        }
        for lease in &reply.revoked_leases {
            if let Some(hold) = self.holds.remove(lease) {
                tracing::info!(%lease, "lease lost; dropping its work");
                hold.dropped.cancel();
            }
        }
        if reply.drain && !self.draining {
            tracing::info!("the server drains this worker");
            self.draining = true;
        }
        let is_beside = call.request.beside && call.request.wants_work;
        if is_beside {
            self.beside.answered(reply.batch.is_some());
        } else {
            self.beside.heard(reply.others_wait);
            self.awaits_change = call.request.wants_work && reply.batch.is_none();
        }
        if let Some(run) = reply.batch {
            // Soon a waiting call will be open, and its response would name revoked leases.
            self.heartbeat_at = self.heartbeat_at.min(Instant::now() + MIN_SYNC_INTERVAL);
            self.accept_batch(run, reply.trace, is_beside);
            for TracedBatch { batch, trace } in reply.more {
                self.accept_batch(batch, trace, is_beside);
            }
        }
    }

    fn on_failure(&mut self, call: PendingSync, error: &ServerError) {
        tracing::debug!(%error, "sync failed");
        self.take_back_reports(Some(call));
        self.retry_at = Instant::now() + self.call_back_off.next();
        self.heartbeat_at = self.retry_at;
    }

    /// Restores the reports of a call that the server may not have received.
    fn take_back_reports(&mut self, call: Option<PendingSync>) {
        if let Some(call) = call {
            self.pending_reports.splice(..0, call.request.reports);
        }
    }

    fn accept_batch(&mut self, run: Batch, trace: Option<String>, is_beside: bool) {
        let holds: Vec<LeaseHandle> = run.leases().map(|(lease, tile)| LeaseHandle::new(lease, tile)).collect();
        if self.draining {
            self.pending_reports.extend(holds.iter().map(|hold| hold.report(LeaseOutcome::Released)));
            return;
        }
        self.holds.extend(holds.iter().map(|hold| (hold.lease, hold.clone())));
        self.beside.batch_begins();
        let lane = if is_beside { self.beside.take_lane() } else { None };
        let executor = lane.unwrap_or_else(|| {
            let is_frame = matches!(run.work, BatchWork::Render { whole_frame: true, .. });
            if matches!(run.work, BatchWork::Render { .. }) {
                self.beside.waits(&holds);
            }
            self.accepted_frame_of = is_frame.then_some(run.job);
            self.rendering += 1;
            self.workbench.clone()
        });
        let span = tracing::info_span!("batch", job = %run.job, frame = run.frame, worker = %self.registration.worker);
        if let Some(trace) = trace {
            proto::trace_context::set_parent(&span, &trace);
        }
        self.runs.spawn(executor.execute(run, holds).instrument(span));
    }

    fn on_event(&mut self, event: BatchEvent) {
        // Only an event that frees memory can make room for another batch.
        self.awaits_change &= !matches!(
            event,
            BatchEvent::Rendered { .. } | BatchEvent::DeviceLost(_) | BatchEvent::Stuck(_) | BatchEvent::NotStored
        );
        match event {
            BatchEvent::Finished(reports) => {
                // Reports on leases revoked in the meantime are dropped.
                let wanted = reports.into_iter().filter(|report| self.holds.remove(&report.lease).is_some());
                self.pending_reports.extend(wanted);
            }
            BatchEvent::Begins(lease) => self.beside.has_device(lease),
            BatchEvent::Recorded(record) => _ = self.records.insert(record.lease, record),
            BatchEvent::Rendered { took, frame_of } => {
                self.rendering = self.rendering.saturating_sub(1);
                if let Some(took) = took {
                    self.last_short_batch = (took < SHORT_BATCH).then_some(took);
                    self.rendered_frame_of = frame_of;
                }
            }
            BatchEvent::RenderedBeside(lane) => self.beside.free(lane),
            BatchEvent::DeviceLost(reason) => self.broken = Some(SessionEnd::DeviceLost(reason)),
            BatchEvent::Stuck(reason) => self.broken = Some(SessionEnd::Stuck(reason)),
            BatchEvent::Speed { rays, seconds } => self.speed.update(rays, seconds),
            BatchEvent::Timed { phase, took, rays } => self.measurements.add(phase, took, rays),
            BatchEvent::Stored => self.store_back_off.reset(),
            BatchEvent::NotStored => self.claim_after = Instant::now() + self.store_back_off.next(),
        }
    }

    fn on_batch_end(&mut self, ended: Result<(), JoinError>) {
        self.awaits_change = false;
        if let Err(error) = ended {
            tracing::error!(%error, "a batch panicked");
        }
        if self.runs.is_empty() {
            // No work is in progress for leases that are still held then.
            self.release_leases();
            self.rendering = 0;
            self.beside.free_all();
        }
    }

    /// Stops all work and releases all leases.
    fn release_leases(&mut self) {
        while let Ok(event) = self.events.try_recv() {
            self.on_event(event);
        }
        self.pending_reports.extend(self.holds.drain().map(|(_, hold)| hold.hand_back()));
    }

    /// Sends the remaining reports in a last call. The server may have exited as well.
    async fn final_sync(&mut self) {
        let request = SyncRequest {
            worker: self.registration.worker,
            rays_per_second: self.speed.rays_per_second(),
            held_leases: Vec::new(),
            records: self.records_of(&self.pending_reports),
            reports: std::mem::take(&mut self.pending_reports),
            wants_work: false,
            beside: false,
            max_batches: 1,
            wait_ms: 0,
            shutting_down: true,
            metrics: self.measurements.take(),
        };
        if let Err(error) = self.link.sync(&request, FINAL_SYNC_TIMEOUT).await {
            tracing::debug!(%error, "the last sync failed; the released tiles will be leased again");
        }
    }
}
