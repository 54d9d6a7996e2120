//! Garbage collection on demand: deletes jobs past their retention, or lists them.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::Uri;
use proto::retention::GcReport;
use serde::Deserialize;

use crate::http::body;
use crate::http::error::ApiError;
use crate::retention::Retention;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct CollectQuery {
    #[serde(default)]
    dry_run: bool,
}

/// Delete jobs past their retention.
///
/// The server does this automatically every 10 minutes. One request deletes at most 1,000 jobs; `more` says
/// whether others may remain.
#[utoipa::path(
    post, path = "", tag = "jobs", operation_id = "collect_garbage",
    params(("dry_run" = Option<bool>, Query, description = "Only list what would be deleted")),
    responses((status = 200, description = "What was deleted, or would be", body = ref("#/components/schemas/GcReport")))
)]
pub(in crate::http) async fn collect(
    State(retention): State<Arc<Retention>>,
    uri: Uri,
) -> Result<Json<GcReport>, ApiError> {
    let query: CollectQuery = body::read_query(&uri)?;
    Ok(Json(retention.collect(query.dry_run).await?))
}
