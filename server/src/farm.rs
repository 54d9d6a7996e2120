//! State shared by all handlers (queue, content store, pool) and the operations that need more than one of them.
//!
//! Depends on no HTTP types.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use proto::worker_protocol::{LeaseOutcome, LeaseReport};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use crate::admission::Admission;
use crate::config::Config;
use crate::content_store::{ContentError, ContentHash, ContentKind, ContentStore};
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
    pub(crate) content: ContentStore,
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
        self.verify_reports(&mut turn.reports).await?;
        let worker = turn.worker;
        let again = SyncInput { reports: Vec::new(), ..turn.clone() };
        let taken = self.queue.turn(turn).await?;
        drop(gate);
        let Some(mut turned) = taken else { return Ok(None) };
        self.count(&turned);
        self.sweep_later(ContentKind::Blob, std::mem::take(&mut turned.leftovers));
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

    /// Drops reports whose bytes are not in the store; their tiles are requeued.
    async fn verify_reports(&self, reports: &mut [LeaseReport]) -> Result<(), ContentError> {
        let mut last: Option<(String, bool)> = None;
        for report in reports {
            let (kind, hash, size_bytes) = match &report.outcome {
                LeaseOutcome::Blob { hash, size_bytes } => (ContentKind::Blob, hash, *size_bytes),
                LeaseOutcome::Picture { hash, size_bytes } => (ContentKind::Picture, hash, *size_bytes),
                LeaseOutcome::BadBlobs { .. } | LeaseOutcome::Failed { .. } | LeaseOutcome::Released => continue,
            };
            let there = match &last {
                Some((same, there)) if same == hash => *there,
                _ => match ContentHash::parse(hash) {
                    None => false,
                    Some(name) => self.content.size_bytes(kind, &name).await? == Some(size_bytes),
                },
            };
            last = Some((hash.clone(), there));
            if !there {
                tracing::warn!(lease = %report.lease, %hash, "a result's bytes are missing; its tile is requeued");
                report.outcome = LeaseOutcome::Released;
            }
        }
        Ok(())
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
