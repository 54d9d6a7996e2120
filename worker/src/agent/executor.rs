//! Executes batches one after another on the device, while earlier ones are encoded and delivered. Leases are
//! known here only as handles that may be dropped.

use std::any::Any;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use proto::worker_protocol::{Batch, BatchWork, LeaseOutcome, LeaseReport, Phase, Recording, TileRecord};
use proto::{JobId, LeaseId};
use scene::Job;
use tokio::sync::Semaphore;
use tokio::sync::mpsc::UnboundedSender;
use tokio::task::JoinError;
use tokio_util::sync::CancellationToken;

use super::back_off::BackOff;
use super::device_use::{DeviceSlots, SharedTime};
use super::job_cache::{JobCache, JobFetchError};
use super::rendering::TileTask;
use super::server_client::ServerClient;
use super::store_access::StoreAccess;
use crate::image::Encoders;
use crate::renderer::{CancelFlag, Renderer};

/// Maximum number of batches, or tiles of a batch, that are delivered concurrently.
const MAX_CONCURRENT_UPLOADS: usize = 32;
/// Maximum memory of pixels being rendered or delivered, in KiB.
pub(super) const MEMORY_KIB: u32 = 1 << 20;

/// Event from a batch to its session.
#[derive(Debug)]
pub(super) enum BatchEvent {
    /// These leases finished together, with their outcomes.
    Finished(Vec<LeaseReport>),
    /// A batch with this lease has the device.
    Begins(LeaseId),
    /// The record of a tile, before the tile is finished.
    Recorded(TileRecord),
    /// A batch no longer needs the device.
    Rendered {
        /// How long it used the device, if at all.
        took: Option<Duration>,
        /// Its job, if it was a whole frame.
        frame_of: Option<JobId>,
    },
    /// A batch in this lane beside another no longer needs the device.
    RenderedBeside(usize),
    /// The device is lost, for this reason.
    DeviceLost(String),
    /// A cancelled render does not stop, so that only the end of this process frees the device.
    Stuck(String),
    /// This many camera rays were rendered in this many seconds.
    Speed { rays: f64, seconds: f64 },
    /// Duration of a phase; for rendering, with its camera rays.
    Timed { phase: Phase, took: Duration, rays: u64 },
    /// The server stored something.
    Stored,
    /// The server could not store something.
    NotStored,
}

/// A worker's side of a lease.
#[derive(Clone, Debug)]
pub(super) struct LeaseHandle {
    /// Lease id.
    pub(super) lease: LeaseId,
    /// Index of the tile in its frame; `None` for a stitch.
    pub(super) tile: Option<u32>,
    /// Cancelled when its result is no longer wanted.
    pub(super) dropped: CancellationToken,
}

impl LeaseHandle {
    pub(super) fn new(lease: LeaseId, tile: Option<u32>) -> Self {
        Self { lease, tile, dropped: CancellationToken::new() }
    }

    pub(super) fn report(&self, outcome: LeaseOutcome) -> LeaseReport {
        LeaseReport { lease: self.lease, outcome }
    }

    /// Ends its work, and reports that.
    pub(super) fn hand_back(&self) -> LeaseReport {
        self.dropped.cancel();
        self.report(LeaseOutcome::Released)
    }
}

/// Waits until all these leases are dropped.
pub(super) async fn all_dropped(holds: &[LeaseHandle]) {
    for hold in holds {
        hold.dropped.cancelled().await;
    }
}

/// Cancels a flag when it goes out of scope.
#[derive(Debug, Default)]
pub(super) struct CancelOnDrop(pub(super) CancelFlag);

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        self.0.cancel();
    }
}

/// Frame being rendered or stitched.
#[derive(Clone, Debug)]
pub(super) struct FrameTask {
    /// Its job's id.
    pub(super) id: JobId,
    /// Its job.
    pub(super) job: Arc<Job>,
    /// Number of the frame in its job.
    pub(super) number: u32,
    /// Time limit for rendering a tile; `None` means no limit.
    pub(super) tile_seconds: Option<u32>,
    /// How its tiles are recorded, if that is wanted.
    pub(super) recording: Option<Recording>,
}

/// Device and server of the worker.
pub(super) struct BatchExecutor {
    pub(super) link: Arc<ServerClient>,
    pub(super) store: StoreAccess,
    pub(super) scratch: PathBuf,
    pub(super) renderer: Arc<dyn Renderer>,
    pub(super) encoders: Encoders,
    pub(super) device: DeviceSlots,
    /// Permits, each for one KiB of pixels.
    pub(super) memory: Arc<Semaphore>,
    /// Time in which the device was shared by several batches.
    pub(super) shared_time: Arc<SharedTime>,
    /// Number of its lane, if it renders beside another.
    lane: Option<usize>,
    jobs: Arc<JobCache>,
    events: UnboundedSender<BatchEvent>,
}

impl BatchExecutor {
    pub(super) fn new(
        link: Arc<ServerClient>,
        store: StoreAccess,
        renderer: Arc<dyn Renderer>,
        encoders: Encoders,
        scratch: PathBuf,
        events: UnboundedSender<BatchEvent>,
    ) -> Self {
        let (device, memory) = (DeviceSlots::new(renderer.overlapping()), Semaphore::new(MEMORY_KIB as usize));
        let (memory, shared_time, jobs) = (Arc::new(memory), Arc::default(), Arc::default());
        Self { link, store, scratch, renderer, encoders, device, memory, shared_time, lane: None, jobs, events }
    }

    /// Executes batches in a lane, with another renderer, at the same time as this one.
    pub(super) fn beside(&self, lane: usize, renderer: Arc<dyn Renderer>) -> Self {
        Self {
            link: self.link.clone(),
            store: self.store.clone(),
            scratch: self.scratch.clone(),
            device: DeviceSlots::new(renderer.overlapping()),
            renderer,
            encoders: self.encoders.clone(),
            memory: self.memory.clone(),
            shared_time: self.shared_time.clone(),
            lane: Some(lane),
            jobs: self.jobs.clone(),
            events: self.events.clone(),
        }
    }

    /// Number of batches, or tiles of a batch, delivered concurrently: one for each thread that encodes, and a few that
    /// are fetched or stored in the meantime.
    pub(super) fn max_uploads(&self) -> usize {
        let threads = self.encoders.count();
        (threads + threads / 2).clamp(2, MAX_CONCURRENT_UPLOADS)
    }

    /// Executes a batch; every lease ends in a report, unless it was dropped.
    pub(super) async fn execute(self: Arc<Self>, run: Batch, holds: Vec<LeaseHandle>) {
        let _shared = self.lane.map(|_| self.shared_time.begin());
        let job = tokio::select! {
            job = self.job(run.job) => job,
            () = all_dropped(&holds) => return self.send(BatchEvent::Rendered { took: None, frame_of: None }),
        };
        let job = match job {
            Ok(job) => job,
            Err(error) => {
                self.send(BatchEvent::Rendered { took: None, frame_of: None });
                return self.fail_all(&holds, &error);
            }
        };
        let frame =
            FrameTask { id: run.job, job, number: run.frame, tile_seconds: run.tile_seconds, recording: run.recording };
        match run.work {
            BatchWork::Stitch { inputs: parts, .. } => self.stitch(&frame, &parts, &holds[0]).await,
            BatchWork::Render { tiles, whole_frame } => {
                let rects = tiles.iter().map(|tile| tile.rect);
                let places: Vec<TileTask> = rects.zip(holds).map(|(rect, hold)| TileTask { rect, hold }).collect();
                if whole_frame {
                    self.render_whole(frame, &places).await;
                } else {
                    self.render_tiles(frame, places).await;
                }
            }
        }
    }

    /// Loads a job; waits while the server is unreachable.
    pub(super) async fn job(&self, id: JobId) -> Result<Arc<Job>, JobFetchError> {
        let mut back_off = BackOff::new(Duration::from_millis(50), Duration::from_secs(2));
        loop {
            match self.jobs.get(&self.link, id).await {
                Err(JobFetchError::Server(error)) if error.is_unavailable() => back_off.pause().await,
                job => return job,
            }
        }
    }

    pub(super) fn send(&self, event: BatchEvent) {
        let event = match (self.lane, event) {
            (Some(lane), BatchEvent::Rendered { .. }) => BatchEvent::RenderedBeside(lane),
            // It has only a part of the device.
            (Some(_), BatchEvent::Speed { .. }) => return,
            (_, event) => event,
        };
        // If the session has ended, no receiver is left.
        self.events.send(event).unwrap_or_default();
    }

    /// Reports the same outcome for several leases at once.
    pub(super) fn finish<'a>(&self, holds: impl IntoIterator<Item = &'a LeaseHandle>, outcome: &LeaseOutcome) {
        self.send(BatchEvent::Finished(holds.into_iter().map(|hold| hold.report(outcome.clone())).collect()));
    }

    fn fail_all(&self, holds: &[LeaseHandle], error: &JobFetchError) {
        tracing::warn!(%error, "could not start a batch");
        match error {
            JobFetchError::Server(_) => {
                self.send(BatchEvent::NotStored);
                self.finish(holds, &LeaseOutcome::Released);
            }
            JobFetchError::Refused(_) | JobFetchError::Panicked => {
                self.finish(holds, &LeaseOutcome::Failed { message: error.to_string() });
            }
        }
    }
}

/// Joins an error and its causes in one line.
pub(super) fn chain(error: &dyn std::error::Error) -> String {
    let mut line = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        line = format!("{line}: {error}");
        cause = error.source();
    }
    line
}

/// Message of a panic in a blocking task.
pub(super) fn panic_message(who: &str, error: JoinError) -> String {
    let Ok(panic) = error.try_into_panic() else { return format!("{who} was stopped") };
    let text = panic_text(&*panic);
    format!("{who} panicked: {text}")
}

fn panic_text(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no message")
}
