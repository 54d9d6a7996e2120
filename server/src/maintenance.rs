//! Periodic maintenance: expires leases, deletes orphaned content, prunes old rows.
//!
//! It changes no state itself; it calls the queue and the store.

use std::sync::Arc;
use std::time::Duration;

use futures_util::stream::TryStreamExt;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use crate::content_store::{self, Kind};
use crate::database::StoreError;
use crate::farm::{Farm, Leftovers};
use crate::retention;

/// Interval at which leases are checked.
const RESCUE: Duration = Duration::from_secs(1);
/// Interval at which rows and folders are cleaned up.
const TIDY: Duration = Duration::from_mins(10);
/// Bytes without a report are kept this long.
const UNREPORTED: Duration = Duration::from_mins(10);
/// Hashes per database query.
const BATCH: usize = 500;

/// Works until the farm is closed.
pub(crate) async fn run(farm: Arc<Farm>, mut leftovers: mpsc::UnboundedReceiver<Leftovers>, end: CancellationToken) {
    let mut rescue = tokio::time::interval(RESCUE);
    rescue.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut tidy = tokio::time::interval(TIDY);
    loop {
        let done = tokio::select! {
            () = end.cancelled() => return,
            Some(left) = leftovers.recv() => sweep(&farm, left.kind, &left.hashes).await,
            _ = rescue.tick() => count_rescued(&farm).await,
            _ = tidy.tick() => look_through(&farm).await,
        };
        if let Err(error) = done {
            tracing::error!(%error, cause = ?std::error::Error::source(&error), "maintenance could not be done");
        }
    }
}

async fn count_rescued(farm: &Farm) -> Result<(), StoreError> {
    let count = farm.queue.rescue().await?;
    farm.totals.expired.fetch_add(count, std::sync::atomic::Ordering::Relaxed);
    Ok(())
}

async fn sweep(farm: &Arc<Farm>, kind: Kind, hashes: &[String]) -> Result<(), StoreError> {
    let queue = &farm.queue;
    let (count, young) = match kind {
        Kind::Blob => farm.pictures.sweep(kind, hashes, async |names| queue.unneeded_blobs(&names).await).await?,
        Kind::Picture => farm.pictures.sweep(kind, hashes, async |names| queue.unneeded_pictures(&names).await).await?,
    };
    if !young.is_empty() {
        let farm = Arc::clone(farm);
        tokio::spawn(async move {
            tokio::time::sleep(content_store::YOUNG).await;
            farm.sweep_later(kind, young);
        });
    }
    if count > 0 {
        tracing::debug!(count, ?kind, "removed bytes that nobody needs");
    }
    Ok(())
}

async fn look_through(farm: &Arc<Farm>) -> Result<(), StoreError> {
    farm.queue.tidy().await?;
    farm.queue.drop_traces().await?;
    farm.queue.prune_events().await?;
    if let Err(error) = retention::collect_all(farm).await {
        tracing::error!(%error, cause = ?std::error::Error::source(&error), "old jobs could not be removed");
    }
    if let Err(error) = farm.sketches.tidy() {
        tracing::warn!(%error, "old previews could not be removed");
    }
    farm.queue.prune_wishes().await?;
    farm.queue.prune_deliveries().await?;
    let data = farm.config.data.clone();
    let removed = tokio::task::spawn_blocking(move || content_store::remove_half_done(&data, UNREPORTED)).await;
    if let Err(error) = removed.map_err(std::io::Error::other).flatten() {
        tracing::warn!(%error, "what half-done writes left could not be removed");
    }
    for kind in [Kind::Blob, Kind::Picture] {
        let names = match old_names(farm, kind).await {
            Ok(names) => names,
            Err(error) => {
                tracing::warn!(%error, ?kind, "a folder could not be listed");
                continue;
            }
        };
        for batch in names.chunks(BATCH) {
            sweep(farm, kind, batch).await?;
        }
    }
    Ok(())
}

async fn old_names(farm: &Farm, kind: Kind) -> object_store::Result<Vec<String>> {
    let now_seconds = farm.queue.wall_seconds();
    farm.pictures
        .list(kind)
        .try_filter_map(async |meta| {
            let age_seconds = now_seconds - meta.last_modified.timestamp();
            let is_old = age_seconds > UNREPORTED.as_secs().cast_signed();
            Ok(meta.location.filename().filter(|_| is_old).map(ToOwned::to_owned))
        })
        .try_collect()
        .await
}
