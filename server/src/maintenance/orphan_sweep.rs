//! Deletes stored bytes that no row refers to: those that were announced, and those that no worker has reported.

use std::future::ready;
use std::sync::Arc;
use std::time::Duration;

use futures_util::stream::{BoxStream, StreamExt, TryChunksError, TryStreamExt};
use tokio_util::sync::CancellationToken;

use crate::blobs::{BlobStore, ContentKind, Swept};
use crate::db::DatabaseError;
use crate::orphans::Orphans;
use crate::queue::Queue;

/// Number of hashes that are checked, and deleted if they are orphans, while no result is taken.
const SWEEP_BATCH: usize = 32;
/// Number of listed names that are in memory.
const SWEEP_PAGE: usize = 1024;

/// Number of marked names that are taken at a time.
const MARKED_BATCH: u32 = 256;
/// Bounds of the interval at which marked names are deleted.
const MIN_INTERVAL: Duration = Duration::from_secs(1);
const MAX_INTERVAL: Duration = Duration::from_mins(1);

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

    /// Deletes content of at least this age that no worker has reported, until `end`.
    pub(super) async fn sweep_unreported(
        &self,
        min_age: Duration,
        end: &CancellationToken,
    ) -> Result<(), DatabaseError> {
        for kind in ContentKind::ALL {
            // By pages, because a store may list more than there is room for, and fail after any number of names.
            let mut pages = self.unreported_hashes(kind, min_age).try_chunks(SWEEP_PAGE);
            while let Some(Some(page)) = end.run_until_cancelled(pages.next()).await {
                let (names, failure) = match page {
                    Ok(names) => (names, None),
                    Err(TryChunksError(names, error)) => (names, Some(error)),
                };
                self.sweep_in_pieces(kind, &names).await?;
                if let Some(error) = failure {
                    let error = self.content.list_error(kind, error);
                    tracing::warn!(%error, cause = ?std::error::Error::source(&error), "could not list the store");
                    break;
                }
            }
        }
        Ok(())
    }

    /// Deletes marked names until the farm is closed.
    pub(super) async fn delete_marked_periodically(&self, end: &CancellationToken) {
        if !self.has_others() {
            return;
        }
        let interval = (self.content.grace() / 4).clamp(MIN_INTERVAL, MAX_INTERVAL);
        while end.run_until_cancelled(tokio::time::sleep(interval)).await.is_some() {
            if let Err(error) = self.delete_marked().await {
                tracing::error!(%error, cause = ?std::error::Error::source(&error), "could not delete orphans");
            }
        }
    }

    /// Deletes the names that have been marked for the grace.
    async fn delete_marked(&self) -> Result<(), DatabaseError> {
        for kind in ContentKind::ALL {
            loop {
                let names = self.queue.take_doomed(kind, self.content.grace(), MARKED_BATCH).await?;
                let taken = names.len();
                self.delete_taken(kind, &names).await?;
                if taken < MARKED_BATCH as usize {
                    break;
                }
            }
        }
        Ok(())
    }

    async fn delete_taken(&self, kind: ContentKind, names: &[String]) -> Result<(), DatabaseError> {
        let (mut deleted, mut young) = (Vec::new(), Vec::new());
        for (name, swept) in self.content.delete_old(kind, names).await {
            match swept {
                Swept::Deleted | Swept::Missing => deleted.push(name),
                Swept::TooNew => young.push(name),
                // It may still be deleted: nothing may refer to it until a later sweep has deleted it.
                Swept::Failed => {}
            }
        }
        if !deleted.is_empty() {
            tracing::debug!(count = deleted.len(), ?kind, "removed orphaned content");
        }
        self.queue.record_deleted(kind, deleted).await?;
        self.queue.mark_again(kind, young).await
    }

    /// Whether other servers may report what this one sweeps; otherwise a lock in memory keeps the two apart, and the space
    /// is free at once.
    fn has_others(&self) -> bool {
        self.queue.may_have_others() && self.content.is_shared()
    }

    async fn sweep(&self, kind: ContentKind, hashes: &[String]) -> Result<(), DatabaseError> {
        let queue = &self.queue;
        if self.has_others() {
            let orphans = queue.orphans(kind, hashes).await?;
            return if orphans.is_empty() { Ok(()) } else { queue.mark_doomed(kind, orphans).await };
        }
        let (count, young) = self.content.sweep(kind, hashes, async |names| queue.orphans(kind, &names).await).await?;
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

    fn unreported_hashes(
        &self,
        kind: ContentKind,
        min_age: Duration,
    ) -> BoxStream<'static, object_store::Result<String>> {
        let (now_seconds, min_age_seconds) = (self.queue.wall_seconds(), min_age.as_secs());
        let old = self.content.list(kind).try_filter_map(move |(name, meta)| {
            let age_seconds = now_seconds.saturating_sub(meta.last_modified.timestamp());
            let is_old = age_seconds > min_age_seconds.cast_signed();
            ready(Ok(is_old.then(|| name.as_str().to_owned())))
        });
        old.boxed()
    }
}
