//! Deletes stored bytes that no row refers to: those that were announced, and those that no worker has reported.

use std::sync::Arc;

use futures_util::stream::TryStreamExt;

use crate::blobs::{BlobStore, ContentKind};
use crate::db::DatabaseError;
use crate::orphans::Orphans;
use crate::queue::Queue;

/// Number of hashes that are checked, and deleted if they are orphans, while no result is taken.
const SWEEP_BATCH: usize = 32;

/// Deletes orphans of the content store.
#[derive(Debug)]
pub(crate) struct OrphanSweep {
    /// The queue, whose rows decide.
    pub(crate) queue: Queue,
    /// The store.
    pub(crate) content: Arc<BlobStore>,
    /// Takes candidates that are too young.
    pub(crate) orphans: Orphans,
}

impl OrphanSweep {
    /// Deletes orphans a few at a time: results wait while a sweep decides.
    pub(super) async fn sweep_in_pieces(&self, kind: ContentKind, hashes: &[String]) -> Result<(), DatabaseError> {
        // Those that are too recent are found before results wait: most of what finished frames used is.
        let (mut young, mut old) = (Vec::new(), Vec::new());
        for hash in self.orphans.due(kind, hashes) {
            if self.content.is_too_recent(kind, &hash).await { &mut young } else { &mut old }.push(hash);
        }
        self.try_later(kind, young);
        for piece in old.chunks(SWEEP_BATCH) {
            self.sweep(kind, piece).await?;
        }
        Ok(())
    }

    /// Deletes old content that no worker has reported.
    pub(super) async fn sweep_unreported(&self) -> Result<(), DatabaseError> {
        for kind in ContentKind::ALL {
            let names = match self.unreported_hashes(kind).await {
                Ok(names) => names,
                Err(error) => {
                    tracing::warn!(%error, ?kind, "could not list a folder");
                    continue;
                }
            };
            self.sweep_in_pieces(kind, &names).await?;
        }
        Ok(())
    }

    async fn sweep(&self, kind: ContentKind, hashes: &[String]) -> Result<(), DatabaseError> {
        let queue = &self.queue;
        let (count, young) = match kind {
            ContentKind::Blob => {
                self.content.sweep(kind, hashes, async |names| queue.orphan_blobs(&names).await).await?
            }
            ContentKind::Picture => {
                self.content.sweep(kind, hashes, async |names| queue.orphan_pictures(&names).await).await?
            }
        };
        self.try_later(kind, young);
        if count > 0 {
            tracing::debug!(count, ?kind, "removed orphaned content");
        }
        Ok(())
    }

    /// Has young files checked again. Young objects of a bucket are not remembered for that long: the next cleanup lists
    /// them again.
    fn try_later(&self, kind: ContentKind, young: Vec<String>) {
        if let (false, Some(delay)) = (young.is_empty(), self.content.sweep_retry_delay()) {
            self.orphans.sweep_after(delay, kind, young);
        }
    }

    async fn unreported_hashes(&self, kind: ContentKind) -> object_store::Result<Vec<String>> {
        let (now_seconds, min_age_seconds) = (self.queue.wall_seconds(), self.content.orphan_age().as_secs());
        self.content
            .list(kind)
            .try_filter_map(async |meta| {
                let age_seconds = now_seconds - meta.last_modified.timestamp();
                let is_old = age_seconds > min_age_seconds.cast_signed();
                Ok(meta.location.filename().filter(|_| is_old).map(ToOwned::to_owned))
            })
            .try_collect()
            .await
    }
}
