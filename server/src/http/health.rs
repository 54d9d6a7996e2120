//! Health of the server: liveness, readiness and metrics.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde_json::{Value, json};

use crate::admission::Shares;
use crate::blobs::BlobStore;
use crate::http::error::ApiError;
use crate::pool::Pool;
use crate::queue::Queue;
use crate::telemetry::Telemetry;

/// Content type of `/metrics`.
const OPENMETRICS_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Check that the process responds.
#[utoipa::path(
    get, path = "", tag = "health", operation_id = "livez",
    responses((status = 200, description = "It is", body = String))
)]
pub(in crate::http) async fn livez() -> &'static str {
    "ok\n"
}

/// Check that the database and the content store can be used.
#[utoipa::path(
    get, path = "", tag = "health", operation_id = "readyz",
    responses((status = 200, description = "Both can be used; without a worker the status is `degraded`"))
)]
pub(in crate::http) async fn readyz(
    State(queue): State<Queue>,
    State(content): State<Arc<BlobStore>>,
) -> Result<Json<Value>, ApiError> {
    /// Anybody may ask, so that the response is short.
    const MAX_NAMES: usize = 100;
    queue.check().await?;
    content.check_usable().await?;
    let workers = queue.workers().await?.workers;
    let status = if workers.is_empty() { "degraded" } else { "ready" };
    let names: Vec<String> = workers.into_iter().take(MAX_NAMES).map(|worker| worker.name).collect();
    let store_kind = content.location().kind();
    Ok(Json(json!({
        "status": status, "database": "ok", "store": "ok", "store_kind": store_kind, "workers": names
    })))
}

/// Metrics in the `OpenMetrics` text format.
#[utoipa::path(
    get, path = "", tag = "health", operation_id = "metrics",
    responses(
        (status = 200, description = "Every metric, in the OpenMetrics text format", body = String, content_type = "application/openmetrics-text"),
    )
)]
pub(in crate::http) async fn metrics(
    State(telemetry): State<Arc<Telemetry>>,
    State(pool): State<Arc<Pool>>,
    State(shares): State<Arc<Shares>>,
) -> Result<Response, ApiError> {
    let text = telemetry.text(pool.target_size(), &shares).await?;
    Ok(([(header::CONTENT_TYPE, OPENMETRICS_TYPE)], text).into_response())
}
