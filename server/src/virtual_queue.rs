//! A queue without a server, in virtual time: for the simulations of farms in `tests/lab`.
//!
//! Its database is in a folder of its own, and its clock stands still until it is advanced. It opens no address.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use futures_util::FutureExt;
use proto::bounded::RaysPerSecond;
use proto::tile::Tiling;
use proto::worker_protocol::{Batch, LeaseReport, RegisterRequest};
use proto::{JobId, LeaseId, WorkerId};

use crate::clock::{Clock, ManualClock};
use crate::db::{Database, DatabaseError};
use crate::queue::{
    FrameOpening, NewJob, NewWorker, NextWork, PassedJobs, Queue, SubmitOptions, SubmitOutcome, SyncInput,
};
use crate::tile_plan::TilePlan;

/// Length of a lease: no simulated worker vanishes, so none has to renew.
const LEASE_MS: i64 = 24 * 3_600_000;
/// Caller that speaks for all workers.
const OWNER: &str = "local";

/// Error of a queue in virtual time.
#[derive(Debug, thiserror::Error)]
pub enum VirtualQueueError {
    /// The folder has no usable database.
    #[error("could not open a queue in the folder")]
    Open(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// A transition of the queue failed.
    #[error("the queue failed")]
    Transition(#[from] DatabaseError),
    /// The queue rejected a job or a worker.
    #[error("the queue rejected a job or a worker: {0}")]
    Rejected(String),
    /// The queue does not know a worker.
    #[error("the queue does not know worker {0}")]
    UnknownWorker(WorkerId),
}

/// The queue's answer to a worker that requests work.
#[derive(Debug)]
pub struct VirtualTurn {
    /// Number of syncs: one, and one for each frame that the queue had opened.
    pub syncs: u64,
    /// Leases of the worker that have ended.
    pub revoked: Vec<LeaseId>,
    /// Work, if there is any.
    pub batch: Option<Batch>,
    /// Time after which there may be work, if the queue knows one.
    pub retry_ms: Option<i64>,
    /// Whether idle workers may get work now.
    pub is_waking: bool,
}

/// The queue that leases tiles to workers, on a clock of its own.
#[derive(Debug)]
pub struct VirtualQueue {
    database: Arc<Database>,
    queue: Queue,
    hand: ManualClock,
}

impl VirtualQueue {
    /// Opens a queue in an empty folder.
    pub async fn open(folder: &Path) -> Result<Self, VirtualQueueError> {
        let database = Database::open(folder).await.map_err(|error| VirtualQueueError::Open(Box::new(error)))?;
        let (database, (clock, hand)) = (Arc::new(database), Clock::manual());
        let (queue, _) = Queue::open(Arc::clone(&database), clock, LEASE_MS, "simulated").await?;
        Ok(Self { database, queue, hand })
    }

    /// Closes the database.
    pub async fn close(&self) {
        self.database.close().await;
    }

    /// Advances the clock.
    pub fn advance(&self, time: Duration) {
        self.hand.advance(time);
    }

    /// Registers a worker with a device.
    pub async fn register(&self, device: &str) -> Result<WorkerId, VirtualQueueError> {
        let request = RegisterRequest {
            name: String::new(),
            device: device.to_owned(),
            picture_version: scene::PICTURE_VERSION,
            max_nodes: None,
            process: 0,
        };
        let new = NewWorker { request, pool: false, name: "simulated".to_owned(), owner: OWNER.to_owned() };
        let registration = self.queue.register(new).await?;
        Ok(registration.ok_or_else(|| VirtualQueueError::Rejected("too many workers".to_owned()))?.worker)
    }

    /// Submits a job, all of whose frames have these tiles.
    pub async fn submit(&self, submitter: &str, tiling: Tiling, frames: u32) -> Result<JobId, VirtualQueueError> {
        let Tiling { width, height, samples, pixel_bytes, tile_edge } = tiling;
        let plan = TilePlan { width_px: width, height_px: height, samples, pixel_bytes, edge_px: tile_edge, frames };
        let new = NewJob::of_plan(submitter, plan);
        let id = new.id;
        match self.queue.submit_with(new, SubmitOptions::default()).await? {
            SubmitOutcome::Created(_) => Ok(id),
            other @ (SubmitOutcome::Replayed(_) | SubmitOutcome::KeyReused | SubmitOutcome::Rejected(_)) => {
                Err(VirtualQueueError::Rejected(format!("{other:?}")))
            }
        }
    }

    /// Reports a worker's speed, without a request for work.
    pub async fn report_speed(
        &self,
        worker: WorkerId,
        rays_per_second: Option<RaysPerSecond>,
    ) -> Result<(), VirtualQueueError> {
        let input = SyncInput { wants_work: false, ..sync_input(worker, rays_per_second, Vec::new()) };
        self.queue.turn(input).await?;
        Ok(())
    }

    /// Reports a worker's results, and requests work for it.
    pub async fn turn(
        &self,
        worker: WorkerId,
        rays_per_second: Option<RaysPerSecond>,
        reports: Vec<LeaseReport>,
    ) -> Result<VirtualTurn, VirtualQueueError> {
        let mut woken = Box::pin(self.queue.wake_signals().work.notified());
        woken.as_mut().enable();
        let mut input = sync_input(worker, rays_per_second, reports);
        let (mut syncs, mut revoked) = (0, Vec::new());
        let (batch, retry_ms) = loop {
            syncs += 1;
            let outcome = self.queue.turn(input.clone()).await?.ok_or(VirtualQueueError::UnknownWorker(worker))?;
            revoked.extend(outcome.revoked_leases);
            match outcome.next {
                NextWork::Run(batch) => break (Some(batch), None),
                NextWork::Nothing(retry_ms) => break (None, retry_ms),
                NextWork::OpenFrame { job, frame, plan } => {
                    let (picture_key, tiles) = (format!("{job} {frame}"), plan.tiles());
                    let opening = FrameOpening { job, frame, picture_key, scene: None, tiles, samples: plan.samples };
                    input = SyncInput { opening: Some(opening), ..input.without_reports() };
                }
            }
        };
        Ok(VirtualTurn { syncs, revoked, batch, retry_ms, is_waking: woken.now_or_never().is_some() })
    }
}

fn sync_input(worker: WorkerId, rays_per_second: Option<RaysPerSecond>, reports: Vec<LeaseReport>) -> SyncInput {
    SyncInput {
        worker,
        owner: OWNER.to_owned(),
        rays_per_second,
        held_leases: Vec::new(),
        reports,
        records: Vec::new(),
        rejected: Vec::new(),
        checked: None,
        wants_work: true,
        beside: false,
        shutting_down: false,
        opening: None,
        passed: PassedJobs::default(),
        max_batches: 1,
        next_openings: Vec::new(),
    }
}
