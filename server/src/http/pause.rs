//! Pausing and resuming a job or the whole farm.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use proto::farm::FarmView;
use proto::job::JobView;

use super::auth::Caller;
use super::error::ApiError;
use super::jobs::{job_id, view};
use super::quota;
use crate::config::Config;
use crate::queue::{PauseOutcome, Queue};
use crate::telemetry::Telemetry;

/// Pause a job: no new tiles are leased; leased tiles finish and count.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/pause", tag = "jobs", operation_id = "pause_job",
    params(("id" = String, Path, description = "The job")),
    responses(
        (status = 200, description = "The job is paused", body = ref("#/components/schemas/JobView")),
        (status = 404, description = "No such job", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 409, description = "The job has finished", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 429, description = "The submitter has too many paused jobs: see Retry-After", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
    )
)]
pub(super) async fn pause_job(
    State(queue): State<Queue>,
    State(config): State<Arc<Config>>,
    caller: Caller,
    id: Path<String>,
) -> Result<Json<JobView>, ApiError> {
    set_job(&queue, &config, &caller, &id, true).await
}

/// Resume a paused job.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/resume", tag = "jobs", operation_id = "resume_job",
    params(("id" = String, Path, description = "The job")),
    responses(
        (status = 200, description = "The job is resumed", body = ref("#/components/schemas/JobView")),
        (status = 404, description = "No such job", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 409, description = "The job has finished", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
    )
)]
pub(super) async fn resume_job(
    State(queue): State<Queue>,
    State(config): State<Arc<Config>>,
    caller: Caller,
    id: Path<String>,
) -> Result<Json<JobView>, ApiError> {
    set_job(&queue, &config, &caller, &id, false).await
}

async fn set_job(
    queue: &Queue,
    config: &Config,
    caller: &Caller,
    id: &str,
    paused: bool,
) -> Result<Json<JobView>, ApiError> {
    let job = job_id(id)?;
    match queue.pause(job, paused, quota::max_paused(config, caller)).await? {
        PauseOutcome::Done => view(queue, job).await,
        PauseOutcome::AlreadyFinished(state) => Err(ApiError::Finished { job, state }),
        PauseOutcome::TooMany(limit) => Err(quota::too_many_paused(caller, limit)),
        PauseOutcome::Unknown => Err(ApiError::UnknownJob(id.to_owned())),
    }
}

/// Get the state of the farm.
#[utoipa::path(
    get, path = "/v1/farm", tag = "farm", operation_id = "get_farm",
    responses((status = 200, description = "The farm", body = ref("#/components/schemas/FarmView")))
)]
pub(super) async fn get(
    State(queue): State<Queue>,
    State(telemetry): State<Arc<Telemetry>>,
) -> Result<Json<FarmView>, ApiError> {
    Ok(Json(FarmView { paused: queue.is_paused().await?, disk: telemetry.disk_view().await }))
}

/// Pause the farm: no new tiles are leased; leased tiles finish and count.
#[utoipa::path(
    post, path = "/v1/farm/pause", tag = "farm", operation_id = "pause_farm",
    responses((status = 200, description = "The farm is paused", body = ref("#/components/schemas/FarmView")))
)]
pub(super) async fn pause(queue: State<Queue>, telemetry: State<Arc<Telemetry>>) -> Result<Json<FarmView>, ApiError> {
    queue.pause_all(true).await?;
    get(queue, telemetry).await
}

/// Resume a paused farm.
#[utoipa::path(
    post, path = "/v1/farm/resume", tag = "farm", operation_id = "resume_farm",
    responses((status = 200, description = "The farm is resumed", body = ref("#/components/schemas/FarmView")))
)]
pub(super) async fn resume(queue: State<Queue>, telemetry: State<Arc<Telemetry>>) -> Result<Json<FarmView>, ApiError> {
    queue.pause_all(false).await?;
    get(queue, telemetry).await
}
