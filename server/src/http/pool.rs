//! Workers and the local pool, as users see and change them.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::HeaderMap;
use proto::pool::{PoolSize, PoolView, WorkerList};

use super::body::{self, RequestBody};
use super::error::ApiError;
use crate::pool::Pool;
use crate::queue::Queue;

/// Maximum size of a request body; valid ones are smaller.
const MAX_BYTES: usize = 4096;

/// List the workers.
#[utoipa::path(
    get, path = "/v1/workers", tag = "workers", operation_id = "list_workers",
    responses((status = 200, description = "Every worker that is not gone", body = ref("#/components/schemas/WorkerList")))
)]
pub(super) async fn workers(State(queue): State<Queue>) -> Result<Json<WorkerList>, ApiError> {
    Ok(Json(queue.workers().await?))
}

/// Get the local pool.
#[utoipa::path(
    get, path = "/v1/pool", tag = "workers", operation_id = "get_pool",
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
    put, path = "/v1/pool", tag = "workers", operation_id = "resize_pool",
    request_body(content = ref("#/components/schemas/PoolSize"), content_type = "application/json"),
    responses(
        (status = 200, description = "The resized pool", body = ref("#/components/schemas/PoolView")),
        (status = 422, description = "The number of workers is not from 0 to 256", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
    )
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
