//! The tiles of a job: who rendered which, when, and for how long.

use axum::Json;
use axum::extract::{Path, State};
use axum::http::Uri;
use proto::tile_history::TilePage;
use serde::Deserialize;

use crate::http::body;
use crate::http::error::ApiError;
use crate::http::jobs::job_id;
use crate::queue::{Queue, TileCursor};

/// Default number of tiles on a page.
const DEFAULT_PAGE_SIZE: u32 = 200;
/// Maximum number of tiles on a page.
const MAX_PAGE: u32 = 1000;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct TileQuery {
    frame: Option<u32>,
    limit: Option<u32>,
    cursor: Option<String>,
}

/// List a job's tiles, with the workers that rendered them.
///
/// Tiles of frames that no worker has reached yet, and of frames from the cache, are not listed. A lease is forgotten an
/// hour after it was granted, unless it lasts; the last one of each tile with a result is kept as long as the job, and `attempts`
/// counts all.
#[utoipa::path(
    get, path = "", tag = "jobs", operation_id = "list_tiles",
    params(
        ("id" = String, Path, description = "The job"),
        ("frame" = Option<u32>, Query, description = "Only tiles of this frame"),
        ("limit" = Option<u32>, Query, description = "Tiles on the page", minimum = 1, maximum = 1000),
        ("cursor" = Option<String>, Query, description = "`next_cursor` of the page before"),
    ),
    responses((status = 200, description = "A page", body = ref("#/components/schemas/TilePage")))
)]
pub(in crate::http) async fn list(
    State(queue): State<Queue>,
    Path(id): Path<String>,
    uri: Uri,
) -> Result<Json<TilePage>, ApiError> {
    let job = job_id(&id)?;
    let query: TileQuery = body::read_query(&uri)?;
    let limit = body::page_length(query.limit, DEFAULT_PAGE_SIZE, MAX_PAGE)?;
    let after = match query.cursor {
        None => None,
        Some(cursor) => Some(TileCursor::parse(&cursor).ok_or_else(|| body::wrong_cursor(&cursor))?),
    };
    queue.tiles(job, query.frame, after, limit).await?.map(Json).ok_or(ApiError::UnknownJob(id))
}
