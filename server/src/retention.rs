//! Retention: jobs are deleted by age, their own or the server's, and by the size of the store, those that
//! finished first. Unfinished jobs and pictures that a remaining job uses are never deleted.
//!
//! This module chooses the jobs; the queue deletes rows, and bytes are swept as after any deletion.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use proto::retention::{GcReport, RemovalReason, RemovedJob};
use tokio_util::sync::CancellationToken;

use crate::blobs::{BlobStore, ContentError, ContentKind};
use crate::clock::rfc3339;
use crate::db::DatabaseError;
use crate::orphans::Orphans;
use crate::queue::{FinishedJob, Queue};
use crate::space_reserve::SpaceReserve;

/// Maximum number of jobs deleted by one call.
const MAX_JOBS: usize = 1000;
/// Jobs per database query.
const JOBS_PER_PAGE: u32 = 200;

/// Error when deleting jobs.
#[derive(Debug, thiserror::Error)]
pub(crate) enum RetentionError {
    /// The database failed.
    #[error(transparent)]
    Database(#[from] DatabaseError),
    /// The size of the store could not be determined.
    #[error(transparent)]
    Size(#[from] ContentError),
}

/// Job to delete, and the reason.
struct Removal {
    job: FinishedJob,
    reason: RemovalReason,
    freed_bytes: u64,
}

/// How long and how much is kept.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RetentionLimits {
    /// Retention of finished jobs that do not set their own; `None` means forever.
    pub(crate) job_retention: Option<Duration>,
    /// Maximum size of the store; `None` means no limit.
    pub(crate) max_store_bytes: Option<u64>,
}

/// Deletion of jobs past their retention.
#[derive(Debug)]
pub(crate) struct Retention {
    queue: Queue,
    content: Arc<BlobStore>,
    reserve: Arc<SpaceReserve>,
    orphans: Orphans,
    limits: RetentionLimits,
}

impl Retention {
    /// Keeps these limits.
    pub(crate) fn new(
        queue: Queue,
        content: Arc<BlobStore>,
        reserve: Arc<SpaceReserve>,
        orphans: Orphans,
        limits: RetentionLimits,
    ) -> Self {
        Self { queue, content, reserve, orphans, limits }
    }

    /// Deletes the jobs past their retention, or only lists them with `dry_run`.
    pub(crate) async fn collect(&self, dry_run: bool) -> Result<GcReport, RetentionError> {
        self.remove(dry_run, self.store_bytes().await?).await
    }

    async fn remove(&self, dry_run: bool, store_bytes: u64) -> Result<GcReport, RetentionError> {
        let going = self.select_jobs(store_bytes).await?;
        let more = going.len() == MAX_JOBS;
        let mut jobs = Vec::with_capacity(going.len());
        for Removal { job, reason, freed_bytes } in going {
            if !dry_run {
                let removed = match self.queue.remove(&job).await {
                    Err(error) if self.reserve.has_made_room(&error) => self.queue.remove(&job).await,
                    done => done,
                };
                let Some(removed) = removed? else { continue };
                tracing::info!(job = %job.id, reason = reason.name(), freed_bytes, "deleted a job past its retention");
                self.orphans.sweep_removed(removed);
            }
            let finished_at = rfc3339(job.finished_at_ms);
            jobs.push(RemovedJob { id: job.id, name: job.name, finished_at, reason, freed_bytes });
        }
        let freed_bytes = jobs.iter().map(|job| job.freed_bytes).sum();
        Ok(GcReport { dry_run, store_bytes, max_store_bytes: self.limits.max_store_bytes, freed_bytes, jobs, more })
    }

    /// Deletes all jobs past their retention, until `end`.
    pub(crate) async fn collect_until_done(&self, end: &CancellationToken) -> Result<(), RetentionError> {
        while !end.is_cancelled() {
            // The store is listed only if its size matters.
            let store_bytes = if self.limits.max_store_bytes.is_some() { self.store_bytes().await? } else { 0 };
            if !self.remove(false, store_bytes).await?.more {
                break;
            }
        }
        Ok(())
    }

    async fn store_bytes(&self) -> Result<u64, ContentError> {
        let mut sum_bytes = 0;
        for kind in ContentKind::ALL {
            sum_bytes += self.content.size_bytes(kind).await?;
        }
        Ok(sum_bytes)
    }

    async fn select_jobs(&self, store_bytes: u64) -> Result<Vec<Removal>, DatabaseError> {
        let kept_ms = self.limits.job_retention.map(|time| i64::try_from(time.as_millis()).unwrap_or(i64::MAX));
        let mut going = Vec::new();
        let mut numbers = Vec::new();
        let mut left_bytes = store_bytes;
        let mut outdated = self.queue.expired_jobs(kept_ms, MAX_JOBS as u32).await?;
        outdated.truncate(MAX_JOBS);
        for job in outdated {
            let freed_bytes = self.queue.freed_bytes(&job, &numbers).await?;
            left_bytes = left_bytes.saturating_sub(freed_bytes);
            numbers.push(job.number);
            going.push(Removal { job, reason: RemovalReason::Age, freed_bytes });
        }
        let Some(max_bytes) = self.limits.max_store_bytes else { return Ok(going) };
        let mut after: Option<FinishedJob> = None;
        while left_bytes > max_bytes && going.len() < MAX_JOBS {
            let page = self.queue.oldest_jobs(after.as_ref(), JOBS_PER_PAGE).await?;
            let Some(last) = page.last() else { break };
            after = Some(last.clone());
            for job in page {
                if left_bytes <= max_bytes || going.len() == MAX_JOBS {
                    break;
                }
                if numbers.contains(&job.number) {
                    continue;
                }
                let freed_bytes = self.queue.freed_bytes(&job, &numbers).await?;
                left_bytes = left_bytes.saturating_sub(freed_bytes);
                numbers.push(job.number);
                going.push(Removal { job, reason: RemovalReason::Size, freed_bytes });
            }
        }
        self.keep_shared_pictures(going, &numbers).await
    }

    /// Of the jobs to delete for the store's size, spares those whose pictures other jobs use anyway.
    async fn keep_shared_pictures(&self, going: Vec<Removal>, numbers: &[i64]) -> Result<Vec<Removal>, DatabaseError> {
        let mut spared = BTreeSet::new();
        for one in going.iter().filter(|one| one.reason == RemovalReason::Size && one.freed_bytes == 0) {
            if self.queue.freed_bytes(&one.job, numbers).await? == 0 {
                spared.insert(one.job.number);
            }
        }
        Ok(going.into_iter().filter(|one| !spared.contains(&one.job.number)).collect())
    }
}
