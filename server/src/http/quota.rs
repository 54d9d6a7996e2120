//! Quotas: maximum unfinished jobs and rays, for the farm and for each submitter.
//!
//! The transaction that accepts a job decides (`queue/backlog.rs`). The check at the head of a request only saves
//! reading a body that would be rejected.

use super::auth::Caller;
use super::error::ApiError;
use crate::farm::Farm;
use crate::queue::{BacklogLimits, ExceededLimit};

/// Limits of the unfinished work of this caller and of the farm.
pub(super) fn limits(farm: &Farm, caller: &Caller) -> BacklogLimits {
    BacklogLimits {
        farm_jobs: Some(farm.config.max_queued_jobs.into()),
        jobs: caller.key().and_then(|key| key.max_jobs()),
        rays: caller.key().and_then(|key| key.max_rays()),
    }
}

/// Rejects another job of this caller if no job, however small, is within the limits now.
pub(super) async fn check_jobs(farm: &Farm, caller: &Caller) -> Result<(), ApiError> {
    match farm.queue.exceeded_limit(limits(farm, caller), caller.name(), 0).await? {
        None => Ok(()),
        Some(limit) => Err(exceeded(caller, limit)),
    }
}

/// Error for a job of this caller that exceeds a limit.
pub(super) fn exceeded(caller: &Caller, limit: ExceededLimit) -> ApiError {
    let quota = |what, limit| ApiError::Quota { name: caller.name().to_owned(), what, limit };
    match limit {
        ExceededLimit::FarmJobs(limit) => ApiError::QueueFull { limit },
        ExceededLimit::Jobs(limit) => quota("unfinished jobs", limit),
        ExceededLimit::Rays(limit) => quota("rays of unfinished jobs", limit),
    }
}
