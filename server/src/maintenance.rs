//! Periodic maintenance: expires leases, deletes orphaned content, prunes old rows.
//!
//! It changes no state itself; it calls the queue and the store.

use std::sync::Arc;
use std::time::Duration;

use futures_util::stream::TryStreamExt;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use crate::blobs::ContentKind;
use crate::database::DatabaseError;
use crate::farm::{Farm, OrphanCandidates};
use crate::retention;

/// Interval at which leases are checked.
const LEASE_CHECK_INTERVAL: Duration = Duration::from_secs(1);
/// Interval at which rows and folders are cleaned up.
const CLEANUP_INTERVAL: Duration = Duration::from_mins(10);
/// Number of hashes that are checked, and deleted if they are orphans, while no result is taken.
const SWEEP_BATCH: usize = 32;
/// Delay after a piece of a large change that failed.
const FAILED_PIECE_DELAY: Duration = Duration::from_secs(1);

/// Runs maintenance until the farm is closed.
pub(crate) async fn run(farm: Arc<Farm>, leftovers: mpsc::UnboundedReceiver<OrphanCandidates>, end: CancellationToken) {
    tokio::join!(run_periodically(&farm, leftovers, &end), finish_changes(&farm, &end));
}

/// Makes the pieces that are left of large changes, also of those that the last server began.
async fn finish_changes(farm: &Farm, end: &CancellationToken) {
    loop {
        let wait = match farm.queue.clean_up_piece().await {
            Ok(Some(removed)) => {
                farm.sweep_removed(removed);
                if end.is_cancelled() {
                    return;
                }
                continue;
            }
            Ok(None) => CLEANUP_INTERVAL,
            Err(error) => {
                tracing::error!(%error, cause = ?std::error::Error::source(&error), "could not finish a change of a job");
                FAILED_PIECE_DELAY
            }
        };
        tokio::select! {
            () = end.cancelled() => return,
            () = farm.queue.wake_signals().cleanup.notified(), if wait == CLEANUP_INTERVAL => {}
            () = tokio::time::sleep(wait) => {}
        }
    }
}

async fn run_periodically(
    farm: &Arc<Farm>,
    mut leftovers: mpsc::UnboundedReceiver<OrphanCandidates>,
    end: &CancellationToken,
) {
    let mut rescue = tokio::time::interval(LEASE_CHECK_INTERVAL);
    rescue.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut tidy = tokio::time::interval(CLEANUP_INTERVAL);
    loop {
        let done = tokio::select! {
            () = end.cancelled() => return,
            Some(left) = leftovers.recv() => sweep_in_pieces(farm, left.kind, &left.hashes).await,
            _ = rescue.tick() => expire_leases(farm).await,
            _ = tidy.tick() => clean_up(farm).await,
        };
        if let Err(error) = done {
            tracing::error!(%error, cause = ?std::error::Error::source(&error), "maintenance failed");
        }
    }
}

async fn expire_leases(farm: &Farm) -> Result<(), DatabaseError> {
    if farm.reserve.restore() {
        tracing::info!("there is room on the disk again");
        farm.queue.wake_signals().work.notify_waiters();
    }
    let count = farm.queue.expire_leases().await?;
    farm.totals.expired.fetch_add(count, std::sync::atomic::Ordering::Relaxed);
    let unverified = farm.queue.expire_verifications().await?;
    farm.totals.unverified.fetch_add(unverified, std::sync::atomic::Ordering::Relaxed);
    Ok(())
}

/// Deletes orphans a few at a time: results wait while a sweep decides.
async fn sweep_in_pieces(farm: &Arc<Farm>, kind: ContentKind, hashes: &[String]) -> Result<(), DatabaseError> {
    for piece in hashes.chunks(SWEEP_BATCH) {
        sweep(farm, kind, piece).await?;
    }
    Ok(())
}

async fn sweep(farm: &Arc<Farm>, kind: ContentKind, hashes: &[String]) -> Result<(), DatabaseError> {
    let queue = &farm.queue;
    let (count, young) = match kind {
        ContentKind::Blob => farm.content.sweep(kind, hashes, async |names| queue.orphan_blobs(&names).await).await?,
        ContentKind::Picture => {
            farm.content.sweep(kind, hashes, async |names| queue.orphan_pictures(&names).await).await?
        }
    };
    // Young objects of a bucket are not remembered for that long: the next cleanup lists them again.
    if let (false, Some(delay)) = (young.is_empty(), farm.content.sweep_retry_delay()) {
        let farm = Arc::clone(farm);
        tokio::spawn(async move {
            tokio::time::sleep(delay).await;
            farm.sweep_later(kind, young);
        });
    }
    if count > 0 {
        tracing::debug!(count, ?kind, "removed orphaned content");
    }
    Ok(())
}

async fn clean_up(farm: &Arc<Farm>) -> Result<(), DatabaseError> {
    farm.queue.prune().await?;
    farm.queue.drop_traces().await?;
    farm.queue.prune_events().await?;
    if let Err(error) = retention::collect_until_done(farm).await {
        tracing::error!(%error, cause = ?std::error::Error::source(&error), "could not remove old jobs");
    }
    if let Err(error) = farm.preview_helper.prune_coarse() {
        tracing::warn!(%error, "could not remove old previews");
    }
    farm.queue.prune_idempotency_keys().await?;
    farm.queue.prune_deliveries().await?;
    let of_farm = Arc::clone(farm);
    let removed = tokio::task::spawn_blocking(move || of_farm.content.remove_partial_writes()).await;
    if let Err(error) = removed.map_err(std::io::Error::other).flatten() {
        tracing::warn!(%error, "could not remove partial files");
    }
    for kind in ContentKind::ALL {
        let names = match unreported_hashes(farm, kind).await {
            Ok(names) => names,
            Err(error) => {
                tracing::warn!(%error, ?kind, "could not list a folder");
                continue;
            }
        };
        sweep_in_pieces(farm, kind, &names).await?;
    }
    Ok(())
}

async fn unreported_hashes(farm: &Farm, kind: ContentKind) -> object_store::Result<Vec<String>> {
    let (now_seconds, min_age_seconds) = (farm.queue.wall_seconds(), farm.content.orphan_age().as_secs());
    farm.content
        .list(kind)
        .try_filter_map(async |meta| {
            let age_seconds = now_seconds - meta.last_modified.timestamp();
            let is_old = age_seconds > min_age_seconds.cast_signed();
            Ok(meta.location.filename().filter(|_| is_old).map(ToOwned::to_owned))
        })
        .try_collect()
        .await
}
