//! Workers and the local pool, as users see and change them.

pub(super) mod protocol;
pub(super) mod trace_context;

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::HeaderMap;
use proto::WorkerId;
use proto::pool::{PoolSize, PoolView, WorkerList, WorkerView};

use crate::http::body::{self, RequestBody};
use crate::http::error::ApiError;
use crate::pool::Pool;
use crate::queue::{Queue, WorkerChange, WorkerChangeOutcome};

/// Maximum size of a request body; valid ones are smaller.
const MAX_BYTES: usize = 4096;

/// List the workers.
#[utoipa::path(
    get, path = "", tag = "workers", operation_id = "list_workers",
    responses((status = 200, description = "Every worker that is not gone", body = ref("#/components/schemas/WorkerList")))
)]
pub(super) async fn workers(State(queue): State<Queue>) -> Result<Json<WorkerList>, ApiError> {
    Ok(Json(queue.workers().await?))
}

/// Drain a worker: it gets no more work, and exits when it has finished what it holds.
///
/// The server starts another one in the place of a pool worker.
#[utoipa::path(
    post, path = "", tag = "workers", operation_id = "drain_worker",
    params(("id" = String, Path, description = "The worker")),
    responses((status = 200, description = "The worker drains", body = ref("#/components/schemas/WorkerView")))
)]
pub(super) async fn drain_worker(queue: State<Queue>, id: Path<String>) -> Result<Json<WorkerView>, ApiError> {
    change_worker(&queue, id.0, WorkerChange::Drain).await
}

/// Quarantine a worker: it finishes what it holds, and gets no more work until it is released.
#[utoipa::path(
    post, path = "", tag = "workers", operation_id = "quarantine_worker",
    params(("id" = String, Path, description = "The worker")),
    responses((status = 200, description = "The worker is in quarantine", body = ref("#/components/schemas/WorkerView")))
)]
pub(super) async fn quarantine_worker(queue: State<Queue>, id: Path<String>) -> Result<Json<WorkerView>, ApiError> {
    change_worker(&queue, id.0, WorkerChange::Quarantine).await
}

/// Release a worker from quarantine: it gets work again, also of jobs from which its errors excluded it.
#[utoipa::path(
    post, path = "", tag = "workers", operation_id = "release_worker",
    params(("id" = String, Path, description = "The worker")),
    responses((status = 200, description = "The worker is not in quarantine", body = ref("#/components/schemas/WorkerView")))
)]
pub(super) async fn release_worker(queue: State<Queue>, id: Path<String>) -> Result<Json<WorkerView>, ApiError> {
    change_worker(&queue, id.0, WorkerChange::Release).await
}

async fn change_worker(queue: &Queue, id: String, change: WorkerChange) -> Result<Json<WorkerView>, ApiError> {
    let Ok(worker) = id.parse::<WorkerId>() else { return Err(ApiError::NoWorker(id)) };
    match queue.change_worker(worker, change).await? {
        WorkerChangeOutcome::Done => queue.worker(worker).await?.map(Json).ok_or(ApiError::NoWorker(id)),
        WorkerChangeOutcome::Draining => Err(ApiError::WorkerDraining(id)),
        WorkerChangeOutcome::Unknown => Err(ApiError::NoWorker(id)),
    }
}

/// Get the local pool.
#[utoipa::path(
    get, path = "", tag = "workers", operation_id = "get_pool",
    responses((status = 200, description = "The pool", body = ref("#/components/schemas/PoolView")))
)]
pub(super) async fn get(State(queue): State<Queue>, State(pool): State<Arc<Pool>>) -> Result<Json<PoolView>, ApiError> {
    let ready = queue.pool_ready().await?;
    Ok(Json(PoolView { workers: pool.target_size(), ready }))
}

/// Change the number of local workers.
///
/// Surplus workers finish their leased tiles first.
#[utoipa::path(
    put, path = "", tag = "workers", operation_id = "resize_pool",
    request_body(content = ref("#/components/schemas/PoolSize"), content_type = "application/json"),
    responses((status = 200, description = "The resized pool", body = ref("#/components/schemas/PoolView")))
)]
pub(super) async fn put(
    queue: State<Queue>,
    pool: State<Arc<Pool>>,
    headers: HeaderMap,
    request: RequestBody,
) -> Result<Json<PoolView>, ApiError> {
    let size: PoolSize = body::read_json(&headers, request, MAX_BYTES).await?;
    pool.resize(size.workers);
    get(queue, pool).await
}
