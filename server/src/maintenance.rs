//! Periodic maintenance: expires leases, deletes orphaned content, prunes old rows.
//!
//! It changes no state itself; it calls the queue and the store.

mod history;
mod orphan_sweep;

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio::sync::mpsc;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use crate::blobs::BlobStore;
use crate::clock::monotonic_now;
use crate::counters::ServerCounters;
use crate::db::DatabaseError;
use crate::orphans::{OrphanCandidates, Orphans};
use crate::preview_helper::PreviewHelper;
use crate::queue::Queue;
use crate::retention::Retention;
use crate::space_reserve::SpaceReserve;
pub(crate) use history::HistoryRecorder;
pub(crate) use orphan_sweep::OrphanSweep;

/// Interval at which leases are checked.
const LEASE_CHECK_INTERVAL: Duration = Duration::from_secs(1);
/// Interval at which rows and folders are cleaned up.
const CLEANUP_INTERVAL: Duration = Duration::from_mins(10);
/// Age from which unreported files are deleted while the disk is full, and the interval.
const SPACE_SWEEP_AGE: Duration = Duration::from_secs(10);
const SPACE_SWEEP_INTERVAL: Duration = Duration::from_secs(5);
/// Delay after a piece of a large change that failed.
const FAILED_PIECE_DELAY: Duration = Duration::from_secs(1);

/// The maintenance task.
#[derive(Debug)]
pub(crate) struct Maintenance {
    /// Finishing of large changes.
    pub(crate) changes: ChangeFinisher,
    /// Expiry of leases.
    pub(crate) leases: LeaseExpiry,
    /// Recording of the throughput.
    pub(crate) history: HistoryRecorder,
    /// Deletion of orphans.
    pub(crate) sweep: OrphanSweep,
    /// Pruning of old rows and files.
    pub(crate) cleanup: Cleanup,
}

/// Makes the pieces that are left of large changes.
#[derive(Debug)]
pub(crate) struct ChangeFinisher {
    /// The queue.
    pub(crate) queue: Queue,
    /// Takes what the changes have removed.
    pub(crate) orphans: Orphans,
}

/// Expires leases, and restores the space set aside.
#[derive(Debug)]
pub(crate) struct LeaseExpiry {
    /// The queue.
    pub(crate) queue: Queue,
    /// Space set aside for a full disk.
    pub(crate) reserve: Arc<SpaceReserve>,
    /// Counters of what has expired.
    pub(crate) counters: Arc<ServerCounters>,
}

/// Prunes old rows, jobs past their retention, and partial files.
#[derive(Debug)]
pub(crate) struct Cleanup {
    /// The queue.
    pub(crate) queue: Queue,
    /// Deletion of jobs past their retention.
    pub(crate) retention: Arc<Retention>,
    /// Has old previews.
    pub(crate) preview_helper: Arc<PreviewHelper>,
    /// The store, which has partial files.
    pub(crate) content: Arc<BlobStore>,
}

impl Maintenance {
    /// Runs maintenance until the farm is closed.
    pub(crate) async fn run(self, candidates: mpsc::UnboundedReceiver<OrphanCandidates>, end: CancellationToken) {
        tokio::join!(
            self.run_periodically(candidates, &end),
            self.changes.run(&end),
            self.history.run(&end),
            // Apart, because leases must expire in time while the store is slow.
            self.clean_up_periodically(&end),
            self.sweep.delete_marked_periodically(&end)
        );
    }

    async fn run_periodically(
        &self,
        mut candidates: mpsc::UnboundedReceiver<OrphanCandidates>,
        end: &CancellationToken,
    ) {
        let mut swept_for_space_at: Option<Instant> = None;
        let mut lease_check = tokio::time::interval(LEASE_CHECK_INTERVAL);
        lease_check.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            let done = tokio::select! {
                () = end.cancelled() => return,
                Some(found) = candidates.recv() => self.sweep.sweep_in_pieces(found.kind, &found.hashes).await,
                _ = lease_check.tick() => match self.leases.expire().await {
                    Ok(()) => self.make_room(&mut swept_for_space_at, end).await,
                    Err(error) => Err(error),
                },
            };
            log_failure(done);
        }
    }

    async fn clean_up_periodically(&self, end: &CancellationToken) {
        let mut cleanup = tokio::time::interval(CLEANUP_INTERVAL);
        cleanup.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        while end.run_until_cancelled(cleanup.tick()).await.is_some() {
            log_failure(self.clean_up(end).await);
        }
    }

    async fn clean_up(&self, end: &CancellationToken) -> Result<(), DatabaseError> {
        self.cleanup.clean_up(end).await?;
        self.sweep.sweep_unreported(self.cleanup.content.orphan_age(), end).await
    }

    /// While the disk is full, deletes what no worker has reported as soon as it cannot be reported any more.
    async fn make_room(&self, swept_at: &mut Option<Instant>, end: &CancellationToken) -> Result<(), DatabaseError> {
        let now = monotonic_now();
        let is_due = swept_at.is_none_or(|swept_at| now - swept_at >= SPACE_SWEEP_INTERVAL);
        if !is_due || !self.leases.reserve.is_released() || self.cleanup.content.is_shared() {
            return Ok(());
        }
        *swept_at = Some(now);
        self.sweep.sweep_unreported(SPACE_SWEEP_AGE, end).await
    }
}

fn log_failure(done: Result<(), DatabaseError>) {
    if let Err(error) = done {
        tracing::error!(%error, cause = ?std::error::Error::source(&error), "maintenance failed");
    }
}

impl ChangeFinisher {
    /// Makes the pieces that are left of large changes, also of those that the last server began.
    async fn run(&self, end: &CancellationToken) {
        loop {
            let wait = match self.queue.clean_up_piece().await {
                Ok(Some(removed)) => {
                    self.orphans.sweep_removed(removed);
                    if end.is_cancelled() {
                        return;
                    }
                    continue;
                }
                Ok(None) => CLEANUP_INTERVAL,
                Err(error) => {
                    let cause = std::error::Error::source(&error);
                    tracing::error!(%error, ?cause, "could not finish a change of a job");
                    FAILED_PIECE_DELAY
                }
            };
            tokio::select! {
                () = end.cancelled() => return,
                () = self.queue.wake_signals().cleanup.notified(), if wait == CLEANUP_INTERVAL => {}
                () = tokio::time::sleep(wait) => {}
            }
        }
    }
}

impl LeaseExpiry {
    async fn expire(&self) -> Result<(), DatabaseError> {
        if self.reserve.restore() {
            tracing::info!("there is room on the disk again");
            self.queue.wake_signals().work.notify_waiters();
        }
        let count = self.queue.expire_leases().await?;
        self.counters.expired.fetch_add(count, Ordering::Relaxed);
        let unverified = self.queue.expire_verifications().await?;
        self.counters.unverified.fetch_add(unverified, Ordering::Relaxed);
        Ok(())
    }
}

impl Cleanup {
    async fn clean_up(&self, end: &CancellationToken) -> Result<(), DatabaseError> {
        self.queue.prune().await?;
        self.queue.drop_traces().await?;
        self.queue.prune_events().await?;
        self.queue.prune_changes().await?;
        if let Err(error) = self.retention.collect_until_done(end).await {
            tracing::error!(%error, cause = ?std::error::Error::source(&error), "could not remove old jobs");
        }
        if let Err(error) = self.preview_helper.prune_coarse() {
            tracing::warn!(%error, "could not remove old previews");
        }
        self.queue.prune_idempotency_keys().await?;
        self.queue.prune_deliveries().await?;
        let content = Arc::clone(&self.content);
        let removed = tokio::task::spawn_blocking(move || content.remove_partial_writes()).await;
        if let Err(error) = removed.map_err(std::io::Error::other).flatten() {
            tracing::warn!(%error, "could not remove partial files");
        }
        Ok(())
    }
}
