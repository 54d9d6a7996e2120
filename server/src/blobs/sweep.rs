//! Deletion of content: of one name that is not used, or of many that a sweep has found.
//!
//! The lock keeps a server's own reports apart from its deletions; where several servers share a store, the queue does
//! (`queue/servers/doomed.rs`).

use std::time::Duration;

use futures_util::future::join_all;
use object_store::ObjectStoreExt;
use proto::fail_point::{self, FailPoint};

use super::{Backend, BlobStore, ContentError, ContentHash, ContentKind, age, unless_missing};
use crate::clock::monotonic_now;

/// Number of objects deleted at a time.
const MAX_CONCURRENT_DELETIONS: usize = 16;
/// Number of files deleted while no report is counted.
const FILES_OF_A_LOCK: usize = 256;
/// Time in which names are deleted that were found to be unused; the rest waits for the next sweep.
const MAX_SWEEP_TIME: Duration = Duration::from_secs(30);

/// Result of sweeping one name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Swept {
    /// It was deleted.
    Deleted,
    /// It is too recent.
    TooNew,
    /// It was missing.
    Missing,
    /// It could not be deleted, or perhaps will be.
    Failed,
}

impl BlobStore {
    /// Deletes content if it is not used, however new it is: a result that was about to be reported for the same bytes
    /// is found missing, and rendered again. Returns whether there was any.
    pub(crate) async fn delete_if<E: From<ContentError>, F: Future<Output = Result<bool, E>>>(
        &self,
        kind: ContentKind,
        name: &ContentHash,
        is_unused: impl FnOnce(String) -> F,
    ) -> Result<bool, E> {
        let shut = self.sweep_lock.write().await;
        if !is_unused(name.as_str().to_owned()).await? {
            return Ok(false);
        }
        let deleted = self.delete(kind, name).await;
        drop(shut);
        Ok(deleted?)
    }

    /// Deletes content, used or not. Returns whether there was any.
    pub(crate) async fn delete(&self, kind: ContentKind, name: &ContentHash) -> Result<bool, ContentError> {
        let failed = self.failed_on("remove", kind, name);
        // S3 does not say whether it deleted an object.
        let is_there = match &self.backend {
            Backend::Folder(_) => true,
            Backend::Objects(_) => self.age(kind, name).await.map_err(&failed)?.is_some(),
        };
        Ok(is_there && self.remove(kind, name).await.map_err(failed)?)
    }

    /// Deletes content; returns whether there was any, or true if the store does not say.
    async fn remove(&self, kind: ContentKind, name: &ContentHash) -> object_store::Result<bool> {
        let path = self.path(kind, name);
        let deleted = match &self.backend {
            Backend::Folder(folder) => folder.store(kind).delete(&path).await,
            Backend::Objects(objects) => objects.delete(&path).await,
        };
        Ok(unless_missing(deleted)?.is_some())
    }

    /// Whether a file is too recent to delete; asking a bucket for each object takes longer than a sweep.
    pub(crate) async fn is_too_recent(&self, kind: ContentKind, name: &str) -> bool {
        let Some(name) = ContentHash::parse(name).filter(|_| self.folder().is_some()) else { return false };
        matches!(self.age(kind, &name).await, Ok(Some(age)) if age < self.ages.unused)
    }

    /// Age of content; `None` if it is missing.
    async fn age(&self, kind: ContentKind, name: &ContentHash) -> object_store::Result<Option<Duration>> {
        let found = unless_missing(self.store(kind).head(&self.path(kind, name)).await)?;
        Ok(found.map(|meta| age(&meta)))
    }

    /// Deletes the `names` that `unneeded` still lists while no report can arrive, so few at a time that a report never waits
    /// for more than one deletion of a slow bucket. Returns the number deleted, and the names that are too recent to
    /// delete: the same bytes may have been stored again without a report yet.
    pub(crate) async fn sweep<E, F>(
        &self,
        kind: ContentKind,
        names: &[String],
        unneeded: impl Fn(Vec<String>) -> F,
    ) -> Result<(u64, Vec<String>), E>
    where
        F: Future<Output = Result<Vec<String>, E>>,
    {
        let begun = monotonic_now();
        let at_a_time = match &self.backend {
            Backend::Folder(_) => FILES_OF_A_LOCK,
            Backend::Objects(_) => MAX_CONCURRENT_DELETIONS,
        };
        let (mut count, mut young) = (0, Vec::new());
        for names in names.chunks(at_a_time) {
            if begun.elapsed() > MAX_SWEEP_TIME {
                break;
            }
            // Reports wait for this lock, and it for them, in turn.
            let shut = self.sweep_lock.write().await;
            let names = unneeded(names.to_vec()).await?;
            for (name, swept) in self.delete_old(kind, &names).await {
                match swept {
                    Swept::Deleted => count += 1,
                    Swept::TooNew => young.push(name),
                    Swept::Missing | Swept::Failed => {}
                }
            }
            drop(shut);
        }
        Ok((count, young))
    }

    /// Deletes the `names` that are not too recent, for at most [`MAX_SWEEP_TIME`].
    pub(crate) async fn delete_old(&self, kind: ContentKind, names: &[String]) -> Vec<(String, Swept)> {
        let begun = monotonic_now();
        let at_a_time = match &self.backend {
            Backend::Folder(_) => 1,
            Backend::Objects(_) => MAX_CONCURRENT_DELETIONS,
        };
        let mut all = Vec::with_capacity(names.len());
        for names in names.chunks(at_a_time) {
            let is_late = begun.elapsed() > MAX_SWEEP_TIME;
            let swept = names.iter().map(async |name| match ContentHash::parse(name) {
                // Names that are no hashes are not the farm's.
                None => Swept::Missing,
                Some(_) if is_late => Swept::Failed,
                Some(name) => self.sweep_one(kind, &name).await,
            });
            all.extend(names.iter().cloned().zip(join_all(swept).await));
        }
        all
    }

    async fn sweep_one(&self, kind: ContentKind, name: &ContentHash) -> Swept {
        match self.age(kind, name).await {
            Ok(Some(age)) if age < self.ages.unused => return Swept::TooNew,
            // S3 does not say whether it deleted an object.
            Ok(None) => return Swept::Missing,
            Ok(Some(_)) | Err(_) => {}
        }
        fail_point::trigger_infallible(FailPoint::Sweeping);
        match self.remove(kind, name).await {
            Ok(true) => Swept::Deleted,
            Ok(false) => Swept::Missing,
            Err(error) => {
                tracing::warn!(%error, name = name.as_str(), "could not remove orphaned content");
                Swept::Failed
            }
        }
    }
}
