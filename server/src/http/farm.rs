//! The farm: its state, and pausing and resuming it, or one job of it.

pub(super) mod alerts;
pub(super) mod history;
pub(super) mod retention;
pub(super) mod scaling;

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use proto::farm::FarmView;
use proto::job::JobView;

use crate::config::Config;
use crate::http::auth::Caller;
use crate::http::error::ApiError;
use crate::http::jobs::quota;
use crate::http::jobs::{job_id, view};
use crate::queue::{PauseOutcome, Queue};
use crate::telemetry::Telemetry;

/// Pause a job: no new tiles are leased; leased tiles finish and count.
#[utoipa::path(
    post, path = "", tag = "jobs", operation_id = "pause_job",
    params(("id" = String, Path, description = "The job")),
    responses((status = 200, description = "The job is paused", body = ref("#/components/schemas/JobView")))
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
    post, path = "", tag = "jobs", operation_id = "resume_job",
    params(("id" = String, Path, description = "The job")),
    responses((status = 200, description = "The job is resumed", body = ref("#/components/schemas/JobView")))
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
    get, path = "", tag = "farm", operation_id = "get_farm",
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
    post, path = "", tag = "farm", operation_id = "pause_farm",
    responses((status = 200, description = "The farm is paused", body = ref("#/components/schemas/FarmView")))
)]
pub(super) async fn pause(queue: State<Queue>, telemetry: State<Arc<Telemetry>>) -> Result<Json<FarmView>, ApiError> {
    queue.pause_all(true).await?;
    get(queue, telemetry).await
}

/// Resume a paused farm.
#[utoipa::path(
    post, path = "", tag = "farm", operation_id = "resume_farm",
    responses((status = 200, description = "The farm is resumed", body = ref("#/components/schemas/FarmView")))
)]
pub(super) async fn resume(queue: State<Queue>, telemetry: State<Arc<Telemetry>>) -> Result<Json<FarmView>, ApiError> {
    queue.pause_all(false).await?;
    get(queue, telemetry).await
}
