//! Quotas: maximum unfinished jobs and rays, for the farm and for each submitter.
//!
//! Concurrent submissions may exceed a limit together, by at most their number.

use super::auth::Caller;
use super::error::ApiError;
use crate::farm::Farm;

/// Rejects a job before its body is read, if its submitter or the farm has too many unfinished jobs.
pub(super) async fn check_jobs(farm: &Farm, caller: &Caller) -> Result<(), ApiError> {
    let limit = i64::from(farm.config.max_queued_jobs);
    if farm.queue.backlog().await?.jobs >= limit {
        return Err(ApiError::QueueFull { limit });
    }
    if let Some(limit) = caller.key().and_then(|key| key.max_jobs())
        && farm.queue.backlog_of(caller.name()).await?.jobs >= limit
    {
        return Err(ApiError::Quota { name: caller.name().to_owned(), what: "unfinished jobs", limit });
    }
    Ok(())
}

/// Rejects a job with this many rays, if its submitter would have too many.
pub(super) async fn check_rays(farm: &Farm, caller: &Caller, rays: u64) -> Result<(), ApiError> {
    let Some(limit) = caller.key().and_then(|key| key.max_rays()) else { return Ok(()) };
    let waiting = farm.queue.backlog_of(caller.name()).await?.rays;
    if waiting.saturating_add_unsigned(rays) > limit {
        return Err(ApiError::Quota { name: caller.name().to_owned(), what: "rays of unfinished jobs", limit });
    }
    Ok(())
}
