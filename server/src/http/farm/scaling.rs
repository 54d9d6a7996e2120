//! Number of wanted workers, for autoscalers.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::Uri;
use proto::scaling::{DEFAULT_TARGET_SECONDS, MAX_TARGET_SECONDS, ScalingView};
use serde::Deserialize;

use crate::http::body;
use crate::http::error::ApiError;
use crate::telemetry::Telemetry;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ScalingQuery {
    #[serde(default = "default_target_seconds")]
    target_seconds: u32,
}

fn default_target_seconds() -> u32 {
    DEFAULT_TARGET_SECONDS
}

/// Get the number of workers that the backlog needs, by kind of device.
///
/// It follows from the rays that are left and from the measured speeds. Workers on CPUs are wanted for what the ready GPUs
/// cannot finish in time, and for scenes too large for GPUs.
#[utoipa::path(
    get, path = "", tag = "workers", operation_id = "get_scaling",
    params(("target_seconds" = Option<u32>, Query, minimum = 1, maximum = 86400, description = "Time in which the backlog should be finished, 1 to 86400; 600 by default")),
    responses((status = 200, description = "The wanted workers, at most a few seconds old", body = ref("#/components/schemas/ScalingView")))
)]
pub(in crate::http) async fn get(
    State(telemetry): State<Arc<Telemetry>>,
    uri: Uri,
) -> Result<Json<ScalingView>, ApiError> {
    let ScalingQuery { target_seconds } = body::read_query(&uri)?;
    if !(1..=MAX_TARGET_SECONDS).contains(&target_seconds) {
        return Err(ApiError::WrongQuery(format!(
            "target_seconds is {target_seconds}: use a whole number from 1 to {MAX_TARGET_SECONDS}"
        )));
    }
    Ok(Json(telemetry.demand().await?.view(target_seconds)))
}
