//! Health of the server: liveness, readiness and metrics.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde_json::{Value, json};

use super::error::ApiError;
use crate::farm::Farm;

/// Content type of `/metrics`.
const OPENMETRICS_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Check that the process responds.
#[utoipa::path(
    get, path = "/livez", tag = "health", operation_id = "livez",
    responses((status = 200, description = "It is", body = String))
)]
pub(super) async fn livez() -> &'static str {
    "ok\n"
}

/// Check that the database and the content store can be used.
#[utoipa::path(
    get, path = "/readyz", tag = "health", operation_id = "readyz",
    responses(
        (status = 200, description = "Both can be used; without a worker the status is `degraded`"),
        (status = 503, description = "The database is damaged", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 507, description = "The disk is full", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
    )
)]
pub(super) async fn readyz(State(farm): State<Arc<Farm>>) -> Result<Json<Value>, ApiError> {
    farm.queue.check().await?;
    farm.content.check_usable().await?;
    let workers = farm.queue.workers().await?.workers;
    let status = if workers.is_empty() { "degraded" } else { "ready" };
    let names: Vec<String> = workers.into_iter().map(|worker| worker.name).collect();
    Ok(Json(
        json!({ "status": status, "database": "ok", "store": "ok", "store_kind": farm.content.location().kind(), "workers": names }),
    ))
}

/// Metrics in the `OpenMetrics` text format.
#[utoipa::path(
    get, path = "/metrics", tag = "health", operation_id = "metrics",
    responses(
        (status = 200, description = "Every metric, in the OpenMetrics text format", body = String, content_type = "application/openmetrics-text"),
        (status = 503, description = "The database is damaged", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
    )
)]
pub(super) async fn metrics(State(farm): State<Arc<Farm>>) -> Result<Response, ApiError> {
    Ok(([(header::CONTENT_TYPE, OPENMETRICS_TYPE)], farm.telemetry.text(&farm).await?).into_response())
}
