//! State shared by all handlers (queue, content store, pool) and the operations that need more than one of them.
//!
//! Depends on no HTTP types.

mod pictures;
mod reports;

pub(crate) use pictures::PictureState;

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use crate::admission::Admission;
use crate::config::Config;
use crate::content_store::{BlobStore, ContentError, ContentKind};
use crate::database::DatabaseError;
use crate::events::EventHub;
use crate::fair_queue::FairQueue;
use crate::job_cache::{JobCache, JobLoadError, Reader};
use crate::pool::Pool;
use crate::preview_helper::PreviewHelper;
use crate::queue::{
    FrameOpening, NewJob, NextWork, OpenOutcome, Queue, RemovedContent, SubmitOptions, SubmitOutcome, SyncInput,
    SyncOutcome,
};
use crate::signed_links::LinkSigner;
use crate::space_reserve::SpaceReserve;
use crate::telemetry::Telemetry;
use crate::tile_plan::TilePlan;
use crate::webhooks::Webhooks;

/// Maximum number of frames of a job that are looked up in the picture cache at submission; the others are
/// looked up when they are opened.
const MAX_EAGER_CACHE_LOOKUPS: u32 = 64;

/// Stored bytes that may be orphans.
#[derive(Clone, Debug)]
pub(crate) struct OrphanCandidates {
    /// Pictures or blobs.
    pub(crate) kind: ContentKind,
    /// Their hashes.
    pub(crate) hashes: Vec<String>,
}

/// Counters since the start, for `/metrics`.
#[derive(Debug, Default)]
pub(crate) struct ServerCounters {
    /// Expired leases.
    pub(crate) expired: AtomicU64,
    /// Fenced results.
    pub(crate) fenced: AtomicU64,
    /// Tiles that two workers rendered differently.
    pub(crate) nondeterministic: AtomicU64,
    /// Results that are not what was asked for.
    pub(crate) rejected: AtomicU64,
    /// Results that another worker confirmed.
    pub(crate) verified: AtomicU64,
    /// Second renderings that differ from the first.
    pub(crate) refuted: AtomicU64,
    /// Results that should have been verified, but could not be.
    pub(crate) unverified: AtomicU64,
    /// Failed attempts to deliver a webhook.
    pub(crate) webhook_failures: AtomicU64,
}

/// State shared by all handlers.
#[derive(Debug)]
pub(crate) struct Farm {
    /// Settings of the operator.
    pub(crate) config: Config,
    /// Queue of jobs, with tiles, leases and workers.
    pub(crate) queue: Queue,
    /// Sender of webhooks.
    pub(crate) webhooks: Webhooks,
    /// Distributor of events.
    pub(crate) events: EventHub,
    /// Pictures and blobs.
    pub(crate) content: BlobStore,
    /// Space set aside for a full disk.
    pub(crate) reserve: SpaceReserve,
    /// Parsed job files.
    pub(crate) jobs: JobCache,
    /// Admission: keys, rates, the audit log.
    pub(crate) admission: Admission,
    /// Local workers.
    pub(crate) pool: Pool,
    /// Turns of submitters for estimates.
    pub(crate) estimates: Arc<FairQueue>,
    /// Helper processes that draw previews.
    pub(crate) preview_helper: PreviewHelper,
    /// Signer of links.
    pub(crate) links: LinkSigner,
    /// Counters since the start.
    pub(crate) totals: ServerCounters,
    /// Metrics and status.
    pub(crate) telemetry: Telemetry,
    /// Channel that announces possible orphans to the maintenance task.
    pub(crate) orphans: mpsc::UnboundedSender<OrphanCandidates>,
    /// Whether new jobs are rejected.
    pub(crate) is_shutting_down: CancellationToken,
    /// Cancelled when waiting requests must end.
    pub(crate) shutdown: CancellationToken,
}

/// Error of a worker's sync.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SyncError {
    /// The database failed.
    #[error(transparent)]
    Store(#[from] DatabaseError),
    /// The content store failed.
    #[error(transparent)]
    Pictures(#[from] ContentError),
}

impl Farm {
    /// Accepts a job, and at once stores its first frames whose pictures are cached.
    pub(crate) async fn submit(
        &self,
        new: NewJob,
        job: Arc<scene::Job>,
        wish: SubmitOptions,
        reader: Reader<'_>,
    ) -> Result<SubmitOutcome, DatabaseError> {
        let (plan, fresh, text_bytes) = (new.plan, new.no_cache, new.file_text.len());
        let submitted = self.queue.submit_with(new, wish).await?;
        let SubmitOutcome::Created(number) = submitted else { return Ok(submitted) };
        self.jobs.insert(number, text_bytes, Arc::clone(&job));
        if fresh {
            return Ok(submitted);
        }
        for frame in 0..plan.frames.min(MAX_EAGER_CACHE_LOOKUPS) {
            // Without a thread to parse the job, the frame is opened like any other.
            let Ok(opening) = self.opening_of(number, frame, plan, &job, reader).await else { break };
            if !self.queue.has_picture(&opening.picture_key).await?
                || self.queue.reuse(opening).await? != OpenOutcome::Stored
            {
                break;
            }
        }
        Ok(submitted)
    }

    /// Runs a worker's sync until it has work or there is none; `None` if the worker is unknown.
    pub(crate) async fn sync(&self, mut turn: SyncInput) -> Result<Option<SyncOutcome>, SyncError> {
        let gate = if turn.has_reports() { Some(self.content.block_sweep().await) } else { None };
        self.check_reports(&mut turn).await?;
        // Results could not be stored, and would take the space that deletions need.
        turn.wants_work &= !self.reserve.is_released();
        let worker = turn.worker;
        let again = turn.without_reports();
        let taken = self.queue.turn(turn).await?;
        drop(gate);
        let Some(mut turned) = taken else { return Ok(None) };
        self.count(&turned);
        self.sweep_later(ContentKind::Blob, std::mem::take(&mut turned.leftovers));
        let forgotten = std::mem::take(&mut turned.verification.forgotten);
        for hash in &forgotten {
            self.preview_helper.forget(hash);
        }
        self.sweep_later(ContentKind::Picture, forgotten);
        while let NextWork::OpenFrame { job, frame, plan } = turned.next {
            let Some(opening) = self.frame_opening(job, frame, plan).await? else {
                turned.next = NextWork::Nothing(None);
                break;
            };
            let Some(more) = self.queue.turn(SyncInput { opening: Some(opening), ..again.clone() }).await? else {
                tracing::warn!(%worker, "a worker exited while it claimed work");
                return Ok(None);
            };
            self.count(&more);
            turned.next = more.next;
            turned.drain |= more.drain;
        }
        Ok(Some(turned))
    }

    fn count(&self, turned: &SyncOutcome) {
        self.totals.expired.fetch_add(turned.expired, Ordering::Relaxed);
        self.totals.fenced.fetch_add(turned.fenced, Ordering::Relaxed);
        self.totals.nondeterministic.fetch_add(turned.nondeterministic, Ordering::Relaxed);
        self.totals.rejected.fetch_add(turned.rejected, Ordering::Relaxed);
        self.totals.verified.fetch_add(turned.verification.agreed, Ordering::Relaxed);
        self.totals.refuted.fetch_add(turned.verification.differed, Ordering::Relaxed);
        self.totals.unverified.fetch_add(turned.verification.skipped, Ordering::Relaxed);
    }

    async fn frame_opening(
        &self,
        number: i64,
        frame: u32,
        plan: TilePlan,
    ) -> Result<Option<FrameOpening>, DatabaseError> {
        let opening = match self.jobs.get(&self.queue, number).await {
            Ok(job) => self.opening_of(number, frame, plan, &job, Reader::Claim(number)).await,
            Err(error) => Err(error),
        };
        match opening {
            Ok(opening) => Ok(Some(opening)),
            Err(JobLoadError::Store(error)) => Err(error),
            Err(error @ JobLoadError::Refused(_)) => {
                tracing::error!(job = number, %error, "an accepted job cannot be parsed any more");
                self.queue.fail_unreadable(number, error.to_string()).await?;
                Ok(None)
            }
            Err(error @ (JobLoadError::Gone | JobLoadError::Thread | JobLoadError::TooManyWaiting { .. })) => {
                tracing::error!(job = number, %error, "could not open a frame");
                Ok(None)
            }
        }
    }

    async fn opening_of(
        &self,
        number: i64,
        frame: u32,
        plan: TilePlan,
        job: &Arc<scene::Job>,
        reader: Reader<'_>,
    ) -> Result<FrameOpening, JobLoadError> {
        let picture_key = self.jobs.picture_key(reader, job, frame).await?;
        Ok(FrameOpening { job: number, frame, picture_key, tiles: plan.tiles(), samples: plan.samples })
    }

    /// Whether an operation that makes room should run again: the disk was too full even for that, but the database's
    /// WAL is shorter now, and the reserve is released.
    pub(crate) fn has_made_room(&self, error: &DatabaseError) -> bool {
        if error.is_full() {
            self.reserve.release();
        }
        error.is_full()
    }

    /// Requests the maintenance task to delete what no row refers to any more.
    pub(crate) fn sweep_removed(&self, removed: RemovedContent) {
        self.sweep_later(ContentKind::Picture, removed.pictures);
        self.sweep_later(ContentKind::Blob, removed.blobs);
    }

    /// Requests the maintenance task to delete those of the given bytes that no row refers to.
    pub(crate) fn sweep_later(&self, kind: ContentKind, hashes: Vec<String>) {
        if !hashes.is_empty() {
            // Without a maintenance task the server is shutting down; the next one sweeps.
            drop(self.orphans.send(OrphanCandidates { kind, hashes }));
        }
    }
}
