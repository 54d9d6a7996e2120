//! A worker's sync: its results are checked and counted, and work is claimed, for which frames are opened as needed.
//!
//! Depends on no HTTP types; waiting for work is up to the caller.

mod frame_openings;
mod result_check;

use std::sync::Arc;
use std::sync::atomic::Ordering;

use crate::blobs::{ContentError, ContentKind};
use crate::counters::ServerCounters;
use crate::db::DatabaseError;
use crate::orphans::Orphans;
use crate::preview_helper::PreviewHelper;
use crate::queue::{NextWork, Queue, SyncInput, SyncOutcome};
use crate::space_reserve::SpaceReserve;
use crate::upload_ledger::UploadLedger;
pub(crate) use frame_openings::FrameOpenings;
pub(crate) use result_check::ResultCheck;

/// Error of a worker's sync.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SyncError {
    /// The database failed.
    #[error(transparent)]
    Store(#[from] DatabaseError),
    /// The content store failed.
    #[error(transparent)]
    Content(#[from] ContentError),
}

/// Service for the syncs of workers.
#[derive(Debug)]
pub(crate) struct WorkerSync {
    /// The queue.
    pub(crate) queue: Queue,
    /// Check of results before they count.
    pub(crate) results: ResultCheck,
    /// Opening of the frames that the queue has reached.
    pub(crate) openings: FrameOpenings,
    /// Unreported bytes of worker keys.
    pub(crate) ledger: Arc<UploadLedger>,
    /// Space set aside for a full disk.
    pub(crate) reserve: Arc<SpaceReserve>,
    /// Takes what the results have replaced.
    pub(crate) orphans: Orphans,
    /// Forgets what was drawn from refuted pictures.
    pub(crate) preview_helper: Arc<PreviewHelper>,
    /// Counters of outcomes.
    pub(crate) counters: Arc<ServerCounters>,
}

impl WorkerSync {
    /// Runs a worker's sync until it has work or there is none; `None` if the worker is unknown.
    pub(crate) async fn sync(&self, mut turn: SyncInput) -> Result<Option<SyncOutcome>, SyncError> {
        let gate = if turn.has_reports() { Some(self.results.block_sweep().await) } else { None };
        self.results.check(&mut turn).await?;
        // Results could not be stored, and would take the space that deletions need.
        turn.wants_work &= !self.reserve.is_released();
        turn.passed = self.openings.passed();
        let worker = turn.worker;
        let mut again = turn.without_reports();
        let reported = turn.reported_content();
        let taken = self.queue.turn(turn).await?;
        drop(gate);
        self.ledger.reported(&again.owner, &reported);
        let Some(mut synced) = taken else { return Ok(None) };
        self.count(&synced);
        self.orphans.sweep_later(ContentKind::Blob, std::mem::take(&mut synced.orphans));
        let forgotten = std::mem::take(&mut synced.verification.forgotten);
        for hash in &forgotten {
            self.preview_helper.forget(hash);
        }
        self.orphans.sweep_later(ContentKind::Picture, forgotten);
        let mut opening_turn = None;
        while let NextWork::OpenFrame { job, frame, plan } = synced.next {
            let (opening_turn, has_waited) = match &mut opening_turn {
                Some(turn) => (turn, false),
                none => {
                    let turn = none.insert(self.openings.turn().await);
                    let has_waited = turn.has_waited;
                    (turn, has_waited)
                }
            };
            // The syncs before this one may have opened its frame.
            let opening = if has_waited { None } else { self.openings.of(job, frame, plan, opening_turn).await? };
            let next_openings = match &opening {
                Some(opening) => self.openings.following(opening, plan, again.max_batches - 1, opening_turn).await?,
                None => Vec::new(),
            };
            again.passed = self.openings.passed();
            let input = SyncInput { opening, next_openings, ..again.clone() };
            let Some(more) = self.queue.turn(input).await? else {
                tracing::warn!(%worker, "a worker exited while it claimed work");
                return Ok(None);
            };
            self.count(&more);
            synced.next = more.next;
            synced.more = more.more;
            synced.drain |= more.drain;
        }
        Ok(Some(synced))
    }

    fn count(&self, synced: &SyncOutcome) {
        self.counters.expired.fetch_add(synced.expired, Ordering::Relaxed);
        self.counters.fenced.fetch_add(synced.fenced, Ordering::Relaxed);
        self.counters.nondeterministic.fetch_add(synced.nondeterministic, Ordering::Relaxed);
        self.counters.rejected.fetch_add(synced.rejected, Ordering::Relaxed);
        self.counters.rendered_rays.fetch_add(synced.rendered.rays, Ordering::Relaxed);
        self.counters.rendered_tiles.fetch_add(synced.rendered.tiles, Ordering::Relaxed);
        self.counters.rendered_frames.fetch_add(synced.rendered.frames, Ordering::Relaxed);
        self.counters.verified.fetch_add(synced.verification.agreed, Ordering::Relaxed);
        self.counters.refuted.fetch_add(synced.verification.differed, Ordering::Relaxed);
        self.counters.unverified.fetch_add(synced.verification.skipped, Ordering::Relaxed);
    }
}
