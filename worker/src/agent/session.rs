//! A worker's session with its server, from registration to the end: renews leases, reports results, takes
//! new batches, and drops revoked leases. It renders nothing itself.

use std::collections::HashMap;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use proto::LeaseId;
use proto::worker_protocol::{Batch, LeaseOutcome, LeaseReport, RegisterResponse, SyncRequest, SyncResponse};
use tokio::sync::mpsc::{self, UnboundedReceiver, UnboundedSender};
use tokio::task::{JoinError, JoinSet};
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;
use tracing::Instrument;

use super::AgentConfig;
use super::back_off::BackOff;
use super::executor::{Event, Hold, Workbench, leases};
use super::metrics::Measurements;
use super::rendering::milliseconds;
use super::server_client::{Link, LinkError};
use super::store_access::Store;
use crate::image::Encoders;
use crate::renderer::Renderer;

/// A batch that used the device for at most this long is short: the next one is requested while one renders,
/// so that the device does not wait for the server. Longer ones are not requested ahead.
const SHORT_RUN: Duration = Duration::from_millis(50);
/// How long a call may take beyond the wait requested of the server.
const CALL_MARGIN: Duration = Duration::from_secs(10);
/// The least time from one waiting call to the next.
const PAUSE: Duration = Duration::from_millis(50);
/// While a batch is unfinished, its reports are held back for up to 200 ms and sent together, because each call costs the server a commit.
const GATHER: Duration = Duration::from_millis(200);
/// Timeout of the last call of a session.
const FAREWELL: Duration = Duration::from_secs(2);

/// Reason for the end of a session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Ending {
    /// The worker was drained, and holds no leases.
    Drained,
    /// The server does not know this worker, or no longer.
    Unknown,
    /// The device is lost, for this reason; no leases are held any more.
    Retired(String),
}

/// The state of the talk.
pub(super) struct Session {
    link: Arc<Link>,
    welcome: RegisterResponse,
    lease: Duration,
    grace: Duration,
    workbench: Arc<Workbench>,
    events: UnboundedReceiver<Event>,
    /// Kept so that `events` never closes.
    _events: UnboundedSender<Event>,
    runs: JoinSet<()>,
    /// Number of batches still rendering.
    rendering: usize,
    /// The last run was short.
    is_quick: bool,
    /// Why the device is lost, if it is.
    retired: Option<String>,
    holds: HashMap<LeaseId, Hold>,
    outbox: Vec<LeaseReport>,
    speed: Speed,
    measurements: Measurements,
    draining: bool,
    /// No work was ready: ask again when something has changed here.
    asked: bool,
    /// Start of the last call that the server responded to.
    last_renewal: Instant,
    /// No heartbeat is due before.
    heartbeat_at: Instant,
    /// Results wait for company until then, as long as something else is held.
    gather_until: Instant,
    /// Earliest time of the next call after a failed one.
    retry_at: Instant,
    retries: BackOff,
    /// No work is wanted before: the server could not store the last.
    work_at: Instant,
    refusals: BackOff,
}

/// Rays and the time they took, of which the older counts less and less.
#[derive(Clone, Copy, Debug, Default)]
struct Speed {
    rays: f64,
    seconds: f64,
}

impl Speed {
    /// Measurements older than about this long hardly count.
    const MEMORY_SECONDS: f64 = 4.0;
    /// Added to the measured time, so that one very short first batch does not produce a huge speed estimate.
    const DOUBT_SECONDS: f64 = 0.05;

    fn learn(&mut self, rays: f64, seconds: f64) {
        let fade = (1.0 - seconds / Self::MEMORY_SECONDS).max(0.0);
        *self = Self { rays: self.rays * fade + rays, seconds: self.seconds * fade + seconds };
    }

    fn rays_per_second(self) -> Option<f64> {
        (self.seconds > 0.0).then(|| self.rays / (self.seconds + Self::DOUBT_SECONDS))
    }
}

struct Call {
    request: SyncRequest,
    start: Instant,
    answer: Pin<Box<dyn Future<Output = Result<SyncResponse, LinkError>> + Send>>,
}

impl Call {
    /// Whether the call may be dropped: it reports nothing, and nothing can be lost with its response.
    fn is_heartbeat(&self) -> bool {
        self.request.reports.is_empty() && !self.request.wants_work
    }
}

impl Session {
    pub(super) fn new(
        config: &AgentConfig,
        welcome: RegisterResponse,
        link: Arc<Link>,
        renderer: Arc<dyn Renderer>,
        encoders: Encoders,
    ) -> Self {
        let (sender, events) = mpsc::unbounded_channel();
        let measurements = Measurements::new(&renderer.device());
        let folders = welcome.folders.clone().filter(|_| config.of_pool);
        let store = folders.map_or_else(|| Store::Server(link.clone()), Store::Folders);
        let workbench = Workbench::new(link.clone(), store, renderer, encoders, config.scratch.clone(), sender.clone());
        let now = Instant::now();
        Self {
            lease: Duration::from_millis(welcome.lease_ms),
            welcome,
            grace: config.grace,
            workbench: Arc::new(workbench),
            link,
            events,
            _events: sender,
            runs: JoinSet::new(),
            rendering: 0,
            is_quick: false,
            retired: None,
            holds: HashMap::new(),
            outbox: Vec::new(),
            speed: Speed::default(),
            measurements,
            draining: false,
            asked: false,
            last_renewal: now,
            heartbeat_at: now,
            gather_until: now,
            retry_at: now,
            retries: BackOff::new(Duration::from_millis(50), Duration::from_secs(2)),
            work_at: now,
            refusals: BackOff::new(Duration::from_secs(1), Duration::from_secs(30)),
        }
    }

    /// Runs until the worker is drained or unknown; an error is the server's rejection.
    pub(super) async fn work(mut self, shutdown: &CancellationToken) -> Result<Ending, LinkError> {
        let mut call: Option<Call> = None;
        let mut hand_back_at: Option<Instant> = None;
        let ending = loop {
            if let Some(reason) = self.retired.take() {
                self.hand_back();
                break Ok(Ending::Retired(reason));
            }
            if self.is_done() {
                break Ok(Ending::Drained);
            }
            if call.as_ref().is_some_and(Call::is_heartbeat) && self.has_to_call(Instant::now()) {
                call = None;
            }
            if call.is_none() {
                call = self.due_call();
            }
            let has_heartbeat = call.as_ref().is_some_and(Call::is_heartbeat);
            let (holding, is_quiet) = (!self.holds.is_empty(), call.is_none() || has_heartbeat);
            let (next_at, give_up_at) = (self.next_instant(has_heartbeat), self.give_up_at());
            tokio::select! {
                (answered, answer) = answered(&mut call) => match answer {
                    Ok(reply) => self.hear(&answered, reply),
                    Err(error) if error.is_not_found() => break Ok(Ending::Unknown),
                    Err(error) if error.is_passing() => self.miss(answered, &error),
                    Err(error) => break Err(error),
                },
                Some(event) = self.events.recv() => self.absorb(event),
                Some(ended) = self.runs.join_next() => self.end_run(ended),
                () = sleep_until(next_at), if is_quiet => {}
                () = sleep_until(give_up_at), if holding => {
                    tracing::warn!(leases = self.holds.len(), "could not renew the leases in time; stopping their work");
                    self.recall(call.take());
                    self.hand_back();
                }
                () = shutdown.cancelled(), if hand_back_at.is_none() => {
                    self.draining = true;
                    hand_back_at = Some(Instant::now() + self.grace);
                    // Cancels a request for work that is still waiting.
                    call = call.filter(|call| !call.request.wants_work || !call.request.reports.is_empty());
                }
                () = sleep_until(hand_back_at.unwrap_or(next_at)), if hand_back_at.is_some() => {
                    self.hand_back();
                    break Ok(Ending::Drained);
                }
            }
        };
        if let Ok(Ending::Drained | Ending::Retired(_)) = ending {
            self.recall(call);
            self.farewell().await;
        }
        for hold in self.holds.values() {
            hold.dropped.cancel();
        }
        ending
    }

    fn is_done(&self) -> bool {
        self.draining && self.holds.is_empty() && self.outbox.is_empty() && self.runs.is_empty()
    }

    /// Whether there is something to report that must not wait for an open heartbeat.
    fn has_to_call(&self, now: Instant) -> bool {
        now >= self.retry_at && (self.wants_work(now) || !(self.outbox.is_empty() || self.gathers(now)))
    }

    fn wants_work(&self, now: Instant) -> bool {
        self.has_room() && (self.holds.is_empty() || !self.asked) && !self.draining && now >= self.work_at
    }

    /// Whether results wait for those of what is still held.
    fn gathers(&self, now: Instant) -> bool {
        !self.holds.is_empty() && now < self.gather_until
    }

    /// The call to make now, if any.
    fn due_call(&mut self) -> Option<Call> {
        let now = Instant::now();
        if now < self.retry_at || !(self.has_to_call(now) || now >= self.heartbeat_at) {
            return None;
        }
        let (mut holding, mut results): (Vec<_>, _) = (self.holds.keys().copied().collect(), Vec::new());
        if self.gathers(now) {
            holding.extend(self.outbox.iter().map(|report| report.lease));
        } else {
            results = std::mem::take(&mut self.outbox);
            // Reports may make work ready: the last tile of a frame readies its stitch.
            self.asked &= results.is_empty();
        }
        let wants_work = self.wants_work(now);
        // Results are answered at once, so that their loss is noticed.
        let wait = match (results.is_empty(), wants_work) {
            (true, true) if self.holds.is_empty() => self.lease / 3,
            (true, false) if now < self.work_at => (self.lease / 6).min(self.work_at - now),
            (true, false) => self.lease / 6,
            (true, true) | (false, _) => Duration::ZERO,
        };
        if !results.is_empty() {
            self.gather_until = now + GATHER;
        }
        let request = SyncRequest {
            worker: self.welcome.worker,
            rays_per_second: self.speed.rays_per_second(),
            held_leases: holding,
            reports: results,
            wants_work,
            wait_ms: wait.as_millis() as u64,
            shutting_down: false,
            metrics: self.measurements.take(),
        };
        // A waiting call is opened only after a pause in other calls.
        self.heartbeat_at = now + wait.max(PAUSE);
        Some(self.call(request, wait + CALL_MARGIN))
    }

    /// Whether one more run would be worked off soon.
    fn has_room(&self) -> bool {
        let rendering = if self.is_quick { 2 } else { 1 };
        let delivering = self.runs.len().saturating_sub(self.rendering);
        self.rendering < rendering && delivering < self.workbench.deliveries()
    }

    fn call(&self, request: SyncRequest, timeout: Duration) -> Call {
        let (link, sent) = (self.link.clone(), request.clone());
        Call { request, start: Instant::now(), answer: Box::pin(async move { link.sync(&sent, timeout).await }) }
    }

    /// When the next call may become due on its own.
    fn next_instant(&self, has_heartbeat: bool) -> Instant {
        let now = Instant::now();
        let heartbeat = (!has_heartbeat).then_some(self.heartbeat_at);
        let company_until = if self.holds.is_empty() { now } else { self.gather_until };
        let results = (!self.outbox.is_empty()).then_some(company_until);
        let work = (self.work_at > now).then_some(self.work_at);
        let first = heartbeat.into_iter().chain(results).chain(work).min();
        first.unwrap_or(now + self.lease).max(self.retry_at)
    }

    /// When the held leases can no longer be trusted.
    fn give_up_at(&self) -> Instant {
        self.last_renewal + self.lease * 2 / 3
    }

    fn hear(&mut self, call: &Call, reply: SyncResponse) {
        let sync_ms = milliseconds(call.start.elapsed());
        let (results, wait_ms, has_run) = (call.request.reports.len(), call.request.wait_ms, reply.batch.is_some());
        tracing::debug!(results, wait_ms, has_run, sync_ms, "synced");
        self.last_renewal = call.start;
        self.retries.reset();
        if !reply.revoked_leases.is_empty() {
            self.heartbeat_at = Instant::now();
        } else if reply.batch.is_none() && call.request.wait_ms > 0 {
            // A server that does not wait is not to be asked without pause.
            self.retry_at = call.start + PAUSE;
        }
        if self.outbox.iter().any(|report| reply.revoked_leases.contains(&report.lease)) {
            // It was late, and the server still compares it with the first result.
            self.gather_until = Instant::now();
        }
        for lease in &reply.revoked_leases {
            if let Some(hold) = self.holds.remove(lease) {
                tracing::info!(%lease, "lease lost; dropping its work");
                hold.dropped.cancel();
            }
        }
        if reply.drain && !self.draining {
            tracing::info!("told to drain");
            self.draining = true;
        }
        self.asked = call.request.wants_work && reply.batch.is_none();
        if let Some(run) = reply.batch {
            // From soon on a waiting call is open, through which its loss would be heard of.
            self.heartbeat_at = self.heartbeat_at.min(Instant::now() + PAUSE);
            self.take(run, reply.trace);
        }
    }

    fn miss(&mut self, call: Call, error: &LinkError) {
        tracing::debug!(%error, "a sync failed");
        self.recall(Some(call));
        self.retry_at = Instant::now() + self.retries.next();
        self.heartbeat_at = self.retry_at;
    }

    /// Takes back the reports of a call that the server may not have received.
    fn recall(&mut self, call: Option<Call>) {
        if let Some(call) = call {
            self.outbox.splice(..0, call.request.reports);
        }
    }

    fn take(&mut self, run: Batch, trace: Option<String>) {
        let holds: Vec<Hold> = leases(&run).map(|(lease, tile)| Hold::new(lease, tile)).collect();
        if self.draining {
            self.outbox.extend(holds.iter().map(|hold| hold.report(LeaseOutcome::Released)));
            return;
        }
        self.holds.extend(holds.iter().map(|hold| (hold.lease, hold.clone())));
        self.rendering += 1;
        let span = tracing::info_span!("run", job = %run.job, frame = run.frame, worker = %self.welcome.worker);
        if let Some(trace) = trace {
            proto::trace_context::set_parent(&span, &trace);
        }
        self.runs.spawn(self.workbench.clone().run(run, holds).instrument(span));
    }

    fn absorb(&mut self, event: Event) {
        // An event that frees no memory makes no work possible.
        self.asked &= !matches!(event, Event::Rendered(_) | Event::Retired(_) | Event::NotStored);
        match event {
            Event::Finished(reports) => {
                // Reports on leases revoked in the meantime are dropped.
                let wanted = reports.into_iter().filter(|report| self.holds.remove(&report.lease).is_some());
                self.outbox.extend(wanted);
            }
            Event::Rendered(render) => {
                self.rendering = self.rendering.saturating_sub(1);
                self.is_quick = render.map_or(self.is_quick, |render| render < SHORT_RUN);
            }
            Event::Retired(reason) => self.retired = Some(reason),
            Event::Speed { rays, seconds } => self.speed.learn(rays, seconds),
            Event::Took { phase, took, rays } => self.measurements.add(phase, took, rays),
            Event::Stored => self.refusals.reset(),
            Event::NotStored => self.work_at = Instant::now() + self.refusals.next(),
        }
    }

    fn end_run(&mut self, ended: Result<(), JoinError>) {
        self.asked = false;
        if let Err(error) = ended {
            tracing::error!(%error, "a run ended in a panic");
        }
        if self.runs.is_empty() {
            // Leases still held then have no work in progress.
            self.hand_back();
            self.rendering = 0;
        }
    }

    /// Stops all work and gives back what is held.
    fn hand_back(&mut self) {
        while let Ok(event) = self.events.try_recv() {
            self.absorb(event);
        }
        for (_, hold) in self.holds.drain() {
            hold.dropped.cancel();
            self.outbox.push(hold.report(LeaseOutcome::Released));
        }
    }

    /// The last call: sends the remaining reports. The server may be gone as well.
    async fn farewell(&mut self) {
        let request = SyncRequest {
            worker: self.welcome.worker,
            rays_per_second: self.speed.rays_per_second(),
            held_leases: Vec::new(),
            reports: std::mem::take(&mut self.outbox),
            wants_work: false,
            wait_ms: 0,
            shutting_down: true,
            metrics: self.measurements.take(),
        };
        if let Err(error) = self.link.sync(&request, FAREWELL).await {
            tracing::debug!(%error, "the last sync failed; what was held will be leased again");
        }
    }
}

/// Waits for a call's response; forever if there is no call.
async fn answered(call: &mut Option<Call>) -> (Call, Result<SyncResponse, LinkError>) {
    match call {
        Some(open) => {
            let answer = open.answer.as_mut().await;
            (call.take().expect("it is open"), answer)
        }
        None => std::future::pending().await,
    }
}
