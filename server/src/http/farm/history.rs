//! The farm's throughput over the last week.

use axum::Json;
use axum::extract::State;
use axum::http::Uri;
use proto::history::HistoryView;
use serde::Deserialize;

use crate::http::body;
use crate::http::error::ApiError;
use crate::queue::Queue;

/// Default length of the history.
const DEFAULT_SECONDS: u32 = 3600;
/// Length for which it is kept.
const MAX_SECONDS: u32 = 604_800;
/// Shortest length: one row.
const MIN_SECONDS: u32 = 60;
/// Default number of steps.
const DEFAULT_POINTS: u32 = 120;
/// Maximum number of steps.
const MAX_POINTS: u32 = 1000;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct HistoryQuery {
    seconds: Option<u32>,
    points: Option<u32>,
}

/// Get the farm's throughput over time, up to a week back.
///
/// It is kept by minutes: a step is a whole number of minutes, so that there may be fewer steps than wanted.
#[utoipa::path(
    get, path = "", tag = "farm", operation_id = "get_history",
    params(
        ("seconds" = Option<u32>, Query, description = "How far back", minimum = 60, maximum = 604_800),
        ("points" = Option<u32>, Query, description = "Maximum number of steps", minimum = 1, maximum = 1000),
    ),
    responses((status = 200, description = "The steps", body = ref("#/components/schemas/HistoryView")))
)]
pub(in crate::http) async fn get(State(queue): State<Queue>, uri: Uri) -> Result<Json<HistoryView>, ApiError> {
    let query: HistoryQuery = body::read_query(&uri)?;
    let seconds = within("seconds", query.seconds.unwrap_or(DEFAULT_SECONDS), MIN_SECONDS, MAX_SECONDS)?;
    let points = within("points", query.points.unwrap_or(DEFAULT_POINTS), 1, MAX_POINTS)?;
    Ok(Json(queue.history(seconds, points).await?))
}

fn within(name: &str, value: u32, min: u32, max: u32) -> Result<u32, ApiError> {
    if (min..=max).contains(&value) {
        return Ok(value);
    }
    Err(ApiError::WrongQuery(format!("{name} is {value}, but must be from {min} to {max}")))
}
