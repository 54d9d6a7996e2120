//! Quotas: maximum unfinished jobs, rays and paused jobs, for the farm and for each submitter; highest priorities.
//!
//! The transaction that accepts a job decides (`queue/jobs/backlog.rs`). The check at the head of a request only saves
//! reading a body that would be rejected.

use proto::api_key::Scope;

use crate::config::Config;
use crate::http::auth::Caller;
use crate::http::error::ApiError;
use crate::queue::{BacklogLimits, ExceededLimit, Queue};

/// Limits of the unfinished work of this caller and of the farm.
pub(in crate::http) fn limits(config: &Config, caller: &Caller) -> BacklogLimits {
    let farm_jobs = Some(config.max_queued_jobs.into());
    // A farm without keys has one submitter.
    let Some(key) = caller.key() else { return BacklogLimits { farm_jobs, ..BacklogLimits::default() } };
    BacklogLimits {
        farm_jobs,
        jobs: Some(key.max_jobs().unwrap_or(config.max_jobs_per_name.into())),
        rays: Some(key.max_rays().unwrap_or(i64::try_from(config.max_rays_per_name).unwrap_or(i64::MAX))),
        leaves_half: key.max_jobs().is_none(),
    }
}

/// Rejects another job of this caller if no job, however small, is within the limits now.
pub(in crate::http) async fn check_jobs(queue: &Queue, config: &Config, caller: &Caller) -> Result<(), ApiError> {
    match queue.exceeded_limit(limits(config, caller), caller.name(), 0).await? {
        None => Ok(()),
        Some(limit) => Err(exceeded(caller, limit)),
    }
}

/// Maximum number of paused jobs of a job's submitter, if this caller pauses it; administrators may pause any number.
pub(in crate::http) fn max_paused(config: &Config, caller: &Caller) -> Option<u32> {
    let key = caller.key().filter(|key| !key.scopes().is_allowed(Scope::Admin));
    key.map(|_| config.max_paused_per_name)
}

/// Error for a job that this caller cannot pause.
pub(in crate::http) fn too_many_paused(caller: &Caller, limit: u32) -> ApiError {
    ApiError::Quota { name: caller.name().to_owned(), what: "paused jobs", limit: limit.into() }
}

/// Rejects a priority above the highest that the caller's key permits.
pub(in crate::http) fn check_priority(caller: &Caller, priority: i32) -> Result<(), ApiError> {
    match caller.key() {
        Some(key) if priority > key.max_priority() => {
            Err(ApiError::PriorityTooHigh { name: key.name().to_owned(), found: priority, max: key.max_priority() })
        }
        Some(_) | None => Ok(()),
    }
}

/// Error for a job of this caller that exceeds a limit.
pub(in crate::http) fn exceeded(caller: &Caller, limit: ExceededLimit) -> ApiError {
    let quota = |what, limit| ApiError::Quota { name: caller.name().to_owned(), what, limit };
    match limit {
        ExceededLimit::FarmJobs(limit) => ApiError::QueueFull { limit },
        ExceededLimit::Jobs(limit) => quota("unfinished jobs", limit),
        ExceededLimit::Rays(limit) => quota("rays of unfinished jobs", limit),
    }
}
