//! Changes of an existing job: retry, priority, and deletion with its dry run.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, Uri};
use axum::response::{IntoResponse, Response};
use proto::job::{JobMove, JobPatch};
use proto::job::{JobState, JobView};
use serde::Deserialize;

use crate::config::Config;
use crate::http::auth::Caller;
use crate::http::body::RequestBody;
use crate::http::error::ApiError;
use crate::http::jobs::quota;
use crate::http::jobs::{job_id, view};
use crate::http::{body, jobs};
use crate::orphans::Orphans;
use crate::queue::{ChangeOutcome, DeleteOutcome, Queue, QueuePosition, ReorderOutcome, RetryOutcome};
use crate::space_reserve::SpaceReserve;

/// Maximum size of a request body; valid ones are smaller.
const MAX_BYTES: usize = 4096;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct DeleteQuery {
    #[serde(default)]
    dry_run: bool,
}

/// Retry a failed job.
///
/// Requeues the job's dead tiles with reset retry counters, and the tiles that were skipped when it failed.
#[utoipa::path(
    post, path = "", tag = "jobs", operation_id = "retry_job",
    params(("id" = String, Path, description = "The job")),
    responses((status = 200, description = "The job is running again", body = ref("#/components/schemas/JobView")))
)]
pub(in crate::http) async fn retry(
    State(queue): State<Queue>,
    State(config): State<Arc<Config>>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<Json<JobView>, ApiError> {
    let job = job_id(&id)?;
    match queue.retry(job, quota::limits(&config, &caller)).await? {
        RetryOutcome::Changed(ChangeOutcome::Done) => view(&queue, job).await,
        RetryOutcome::Changed(ChangeOutcome::WrongState(state)) => Err(ApiError::NoDeadTiles { job, state }),
        RetryOutcome::Changed(ChangeOutcome::Unknown) => Err(ApiError::UnknownJob(id)),
        RetryOutcome::Rejected(limit) => Err(quota::exceeded(&caller, limit)),
    }
}

/// Change a job's priority.
#[utoipa::path(
    patch, path = "", tag = "jobs", operation_id = "change_job",
    params(("id" = String, Path, description = "The job")),
    request_body(content = ref("#/components/schemas/JobPatch"), content_type = "application/json"),
    responses((status = 200, description = "The changed job", body = ref("#/components/schemas/JobView")))
)]
pub(in crate::http) async fn patch(
    State(queue): State<Queue>,
    caller: Caller,
    Path(id): Path<String>,
    headers: HeaderMap,
    request: RequestBody,
) -> Result<Json<JobView>, ApiError> {
    let job = job_id(&id)?;
    let patch: JobPatch = body::read_json(&headers, request, MAX_BYTES).await?;
    if let Some(priority) = patch.priority
        && !(-100..=100).contains(&priority)
    {
        return Err(body::invalid_body(
            "/priority",
            format!("{priority} is not a priority: use a number from -100 to 100"),
        ));
    }
    if let Some(priority) = patch.priority {
        quota::check_priority(&caller, priority)?;
    }
    match queue.patch(job, patch).await? {
        ChangeOutcome::Done => view(&queue, job).await,
        ChangeOutcome::WrongState(state) => Err(ApiError::Finished { job, state }),
        ChangeOutcome::Unknown => Err(ApiError::UnknownJob(id)),
    }
}

/// Move a job in the queue.
///
/// The job gets a place before or after another one, and takes its priority, or comes before all others, with the highest priority
/// among them. Jobs of one submitter and priority are rendered in this order; submitters of equal priority take turns.
#[utoipa::path(
    post, path = "", tag = "jobs", operation_id = "move_job",
    params(("id" = String, Path, description = "The job")),
    request_body(content = ref("#/components/schemas/JobMove"), content_type = "application/json"),
    responses((status = 200, description = "The moved job", body = ref("#/components/schemas/JobView")))
)]
pub(in crate::http) async fn reorder_job(
    State(queue): State<Queue>,
    caller: Caller,
    Path(id): Path<String>,
    headers: HeaderMap,
    request: RequestBody,
) -> Result<Json<JobView>, ApiError> {
    let job = job_id(&id)?;
    let (place, other) = match body::read_json(&headers, request, MAX_BYTES).await? {
        JobMove { before: Some(other), after: None, first: false } => (QueuePosition::Before(other), Some(other)),
        JobMove { before: None, after: Some(other), first: false } => (QueuePosition::After(other), Some(other)),
        JobMove { before: None, after: None, first: true } => (QueuePosition::First, None),
        JobMove { .. } => {
            let message = "say where: one of {\"before\": ID}, {\"after\": ID} and {\"first\": true}".to_owned();
            return Err(body::invalid_body("", message));
        }
    };
    let own = queue.job(job).await?.ok_or_else(|| ApiError::UnknownJob(id))?.priority;
    let priority = match other {
        None => queue.highest_priority().await?.unwrap_or(own).max(own),
        Some(other) => jobs::visible(&queue, &caller, other).await?.priority,
    };
    if priority != own {
        quota::check_priority(&caller, priority)?;
    }
    match queue.reorder_job(job, place, priority).await? {
        ReorderOutcome::Done => view(&queue, job).await,
        ReorderOutcome::Finished(job, state) => Err(ApiError::Finished { job, state }),
        ReorderOutcome::Unknown(job) => Err(ApiError::UnknownJob(job.to_string())),
    }
}

/// Delete a job and its pictures.
#[utoipa::path(
    delete, path = "", tag = "jobs", operation_id = "delete_job",
    params(
        ("id" = String, Path, description = "The job"),
        ("dry_run" = Option<bool>, Query, description = "Only report what would be deleted"),
    ),
    responses(
        (status = 200, description = "What would be deleted (dry run)", body = ref("#/components/schemas/DeleteDryRun")),
        (status = 204, description = "The job is deleted"),
    )
)]
pub(in crate::http) async fn delete(
    State(queue): State<Queue>,
    State(reserve): State<Arc<SpaceReserve>>,
    State(orphans): State<Orphans>,
    Path(id): Path<String>,
    uri: Uri,
) -> Result<Response, ApiError> {
    let job = job_id(&id)?;
    let query: DeleteQuery = body::read_query(&uri)?;
    if query.dry_run {
        return match queue.delete_preview(job).await? {
            Some((JobState::Running, _)) => Err(ApiError::Running(job)),
            Some((_, preview)) => Ok(Json(preview).into_response()),
            None => Err(ApiError::UnknownJob(id)),
        };
    }
    let deleted = match queue.delete(job).await {
        Err(error) if reserve.has_made_room(&error) => queue.delete(job).await,
        done => done,
    };
    match deleted? {
        DeleteOutcome::Done(removed) => {
            orphans.sweep_removed(removed);
            Ok(StatusCode::NO_CONTENT.into_response())
        }
        DeleteOutcome::Running => Err(ApiError::Running(job)),
        DeleteOutcome::Unknown => Err(ApiError::UnknownJob(id)),
    }
}
