//! State shared by all handlers (queue, content store, pool) and the operations that need more than one of them.
//!
//! Nothing here knows about HTTP.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use proto::worker_protocol::{LeaseOutcome, LeaseReport};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use crate::admission::Doors;
use crate::config::Config;
use crate::content_store::{Kind, Name, PictureError, Pictures};
use crate::database::StoreError;
use crate::events::Events;
use crate::job_cache::{JobError, Jobs};
use crate::pool::Pool;
use crate::preview_helper::Sketches;
use crate::queue::{NewJob, Next, Opened, Opening, Queue, Submitted, Turn, Turned, Wish};
use crate::signed_links::Links;
use crate::telemetry::Watch;
use crate::tile_plan::Plan;
use crate::webhooks::Webhooks;

/// Maximum number of frames of a job that are looked up in the picture cache at submission; the others are
/// looked up when they are opened.
const REUSED_AT_ONCE: u32 = 64;

/// Stored bytes that may be orphans.
#[derive(Clone, Debug)]
pub(crate) struct Leftovers {
    /// Pictures or blobs.
    pub(crate) kind: Kind,
    /// Their hashes.
    pub(crate) hashes: Vec<String>,
}

/// Numbers since the start, for `/metrics`.
#[derive(Debug, Default)]
pub(crate) struct Totals {
    /// Leases that ran out.
    pub(crate) expired: AtomicU64,
    /// Results without effect.
    pub(crate) fenced: AtomicU64,
    /// Tiles that two workers rendered differently.
    pub(crate) nondeterministic: AtomicU64,
    /// Attempts to deliver a webhook that failed.
    pub(crate) webhook_failures: AtomicU64,
}

/// State shared by all handlers.
#[derive(Debug)]
pub(crate) struct Farm {
    /// The operator's settings.
    pub(crate) config: Config,
    /// Jobs, tiles, leases, workers.
    pub(crate) queue: Queue,
    /// Sender of webhooks.
    pub(crate) webhooks: Webhooks,
    /// Distributor of events.
    pub(crate) events: Events,
    /// Pictures and blobs.
    pub(crate) pictures: Pictures,
    /// Parsed job files.
    pub(crate) jobs: Jobs,
    /// Admission: keys, rates, the audit log.
    pub(crate) doors: Doors,
    /// Local workers.
    pub(crate) pool: Pool,
    /// Children that draw previews.
    pub(crate) sketches: Sketches,
    /// Signatures of links.
    pub(crate) links: Links,
    /// Numbers since the start.
    pub(crate) totals: Totals,
    /// Metrics and status.
    pub(crate) watch: Watch,
    /// Channel that announces possible orphans to the maintenance task.
    pub(crate) leftovers: mpsc::UnboundedSender<Leftovers>,
    /// No more jobs are taken.
    pub(crate) closing: CancellationToken,
    /// Cancelled when waiting requests must end.
    pub(crate) ending: CancellationToken,
}

/// Error of a worker's sync.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TurnError {
    /// The database could not do it.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The store could not be asked.
    #[error(transparent)]
    Pictures(#[from] PictureError),
}

impl Farm {
    /// Accepts a job, and stores at once the frames whose pictures are there already.
    pub(crate) async fn submit(&self, new: NewJob, job: Arc<scene::Job>, wish: Wish) -> Result<Submitted, StoreError> {
        let (plan, fresh, text_bytes) = (new.plan, new.fresh, new.text.len());
        let submitted = self.queue.submit_once(new, wish).await?;
        let Submitted::New(number) = submitted else { return Ok(submitted) };
        self.jobs.keep(number, text_bytes, Arc::clone(&job));
        if fresh {
            return Ok(submitted);
        }
        for frame in 0..plan.frames.min(REUSED_AT_ONCE) {
            // Without a thread to read the job on, the frame is opened like any other.
            let Ok(opening) = self.opening_of(number, frame, plan, &job).await else { break };
            if !self.queue.has_picture(&opening.picture_key).await?
                || self.queue.reuse(opening).await? != Opened::Stored
            {
                break;
            }
        }
        Ok(submitted)
    }

    /// Runs a worker's sync until it has work or there is none; `None` if the worker is unknown.
    pub(crate) async fn turn(&self, mut turn: Turn) -> Result<Option<Turned>, TurnError> {
        let gate = if turn.delivers() { Some(self.pictures.keep_all().await) } else { None };
        self.check_delivered(&mut turn.results).await?;
        let worker = turn.worker;
        let again = Turn { results: Vec::new(), ..turn.clone() };
        let taken = self.queue.turn(turn).await?;
        drop(gate);
        let Some(mut turned) = taken else { return Ok(None) };
        self.count(&turned);
        self.sweep_later(Kind::Blob, std::mem::take(&mut turned.leftovers));
        while let Next::Frame { job, frame, plan } = turned.next {
            let Some(opening) = self.opening(job, frame, plan).await? else {
                turned.next = Next::Nothing(None);
                break;
            };
            let Some(more) = self.queue.turn(Turn { opening: Some(opening), ..again.clone() }).await? else {
                tracing::warn!(%worker, "a worker was ended while it claimed");
                return Ok(None);
            };
            self.count(&more);
            turned.next = more.next;
            turned.drain |= more.drain;
        }
        Ok(Some(turned))
    }

    fn count(&self, turned: &Turned) {
        self.totals.expired.fetch_add(turned.expired, Ordering::Relaxed);
        self.totals.fenced.fetch_add(turned.fenced, Ordering::Relaxed);
        self.totals.nondeterministic.fetch_add(turned.nondeterministic, Ordering::Relaxed);
    }

    async fn opening(&self, number: i64, frame: u32, plan: Plan) -> Result<Option<Opening>, StoreError> {
        let opening = match self.jobs.get(&self.queue, number).await {
            Ok(job) => self.opening_of(number, frame, plan, &job).await,
            Err(error) => Err(error),
        };
        match opening {
            Ok(opening) => Ok(Some(opening)),
            Err(JobError::Store(error)) => Err(error),
            Err(error @ JobError::Refused(_)) => {
                tracing::error!(job = number, %error, "a job that was accepted once is refused now");
                self.queue.refuse(number, error.to_string()).await?;
                Ok(None)
            }
            Err(error @ (JobError::Gone | JobError::Thread)) => {
                tracing::error!(job = number, %error, "a frame could not be opened");
                Ok(None)
            }
        }
    }

    async fn opening_of(
        &self,
        number: i64,
        frame: u32,
        plan: Plan,
        job: &Arc<scene::Job>,
    ) -> Result<Opening, JobError> {
        let picture_key = self.jobs.picture_key(job, frame).await?;
        Ok(Opening { job: number, frame, picture_key, tiles: plan.tiles(), samples: plan.samples })
    }

    /// Drops reports whose bytes are not in the store; their tiles are requeued.
    async fn check_delivered(&self, reports: &mut [LeaseReport]) -> Result<(), PictureError> {
        let mut last: Option<(String, bool)> = None;
        for report in reports {
            let (kind, hash, size_bytes) = match &report.outcome {
                LeaseOutcome::Blob { hash, size_bytes } => (Kind::Blob, hash, *size_bytes),
                LeaseOutcome::Picture { hash, size_bytes } => (Kind::Picture, hash, *size_bytes),
                LeaseOutcome::BadBlobs { .. } | LeaseOutcome::Failed { .. } | LeaseOutcome::Released => continue,
            };
            let there = match &last {
                Some((same, there)) if same == hash => *there,
                _ => match Name::parse(hash) {
                    None => false,
                    Some(name) => self.pictures.size_bytes(kind, &name).await? == Some(size_bytes),
                },
            };
            last = Some((hash.clone(), there));
            if !there {
                tracing::warn!(lease = %report.lease, %hash, "a result came without its bytes; its tile goes back");
                report.outcome = LeaseOutcome::Released;
            }
        }
        Ok(())
    }

    /// Has the maintenance task delete those of the given bytes that no row refers to.
    pub(crate) fn sweep_later(&self, kind: Kind, hashes: Vec<String>) {
        if !hashes.is_empty() {
            // Without a janitor the server is ending; the next one sweeps.
            drop(self.leftovers.send(Leftovers { kind, hashes }));
        }
    }
}
