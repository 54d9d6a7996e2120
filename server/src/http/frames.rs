//! Frames of a job: a list, and all pictures as one archive.

pub(super) mod images;
pub(super) mod layers;
pub(super) mod links;
pub(super) mod previews;
pub(super) mod range;
pub(super) mod verify;

use std::sync::Arc;

use axum::Extension;
use axum::Json;
use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::{HeaderValue, Uri, header};
use axum::response::{IntoResponse, Response};
use futures_util::stream;
use proto::frame::FramePage;
use serde::Deserialize;

use crate::admission::{Holder, Shares};
use crate::archive::Archive;
use crate::blobs::BlobStore;
use crate::http::body;
use crate::http::error::ApiError;
use crate::http::jobs::job_id;
use crate::http::state::handle_group;
use crate::pictures::Pictures;
use crate::queue::Queue;

/// Default number of frames on a page.
const DEFAULT_PAGE_SIZE: u32 = 100;
/// Approximate memory of a picture's entry in an archive's directory, which is sent last.
const DIRECTORY_ENTRY_BYTES: u64 = 256;
/// Maximum number of frames on a page.
const MAX_PAGE: u32 = 1000;

handle_group! {
    /// Handles of an archive.
    ArchiveHandles {
        /// Has the frames.
        queue: Queue,
        /// Has the pictures.
        content: Arc<BlobStore>,
        /// Checks them.
        pictures: Arc<Pictures>,
        /// Has room for the archive's directory.
        shares: Arc<Shares>,
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ListQuery {
    limit: Option<u32>,
    cursor: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ArchiveQuery {
    #[serde(default)]
    partial: bool,
}

/// List a job's frames, by number.
#[utoipa::path(
    get, path = "", tag = "pictures", operation_id = "list_frames",
    params(
        ("id" = String, Path, description = "The job"),
        ("limit" = Option<u32>, Query, description = "Frames on the page", minimum = 1, maximum = 1000),
        ("cursor" = Option<String>, Query, description = "`next_cursor` of the page before"),
    ),
    responses((status = 200, description = "A page", body = ref("#/components/schemas/FramePage")))
)]
pub(super) async fn list(
    State(queue): State<Queue>,
    Path(id): Path<String>,
    uri: Uri,
) -> Result<Json<FramePage>, ApiError> {
    let job = job_id(&id)?;
    let query: ListQuery = body::read_query(&uri)?;
    let limit = body::page_length(query.limit, DEFAULT_PAGE_SIZE, MAX_PAGE)?;
    let from = match query.cursor {
        None => 0,
        Some(cursor) => cursor.parse().map_err(|_| body::wrong_cursor(&cursor))?,
    };
    let found = queue.frames(job).await?.ok_or(ApiError::UnknownJob(id))?;
    let frames = queue.frame_page(job, &found, from, limit).await?;
    let next = frames.last().map(|frame| frame.number + 1).filter(|next| *next < found.total);
    Ok(Json(FramePage { frames, next_cursor: next.map(|next| next.to_string()) }))
}

/// Get all pictures of a job as one ZIP archive.
///
/// The pictures are stored unchanged, in frame order, as `NAME.0000.png` and so on. The archive of the same job
/// always has the same bytes.
#[utoipa::path(
    get, path = "", tag = "pictures", operation_id = "get_archive",
    params(
        ("id" = String, Path, description = "The job"),
        ("partial" = Option<bool>, Query, description = "Return the stored pictures even if some are missing"),
    ),
    responses((status = 200, description = "The archive", body = Vec<u8>, content_type = "application/zip"))
)]
pub(super) async fn archive(
    State(archives): State<ArchiveHandles>,
    Extension(holder): Extension<Holder>,
    Path(id): Path<String>,
    uri: Uri,
) -> Result<Response, ApiError> {
    let job = job_id(&id)?;
    let query: ArchiveQuery = body::read_query(&uri)?;
    let ArchiveHandles { queue, content, pictures, shares } = archives;
    let frames = queue.frames(job).await?.ok_or(ApiError::UnknownJob(id))?;
    if frames.stored < frames.total && !query.partial {
        return Err(ApiError::FramesMissing { job, stored: frames.stored, total: frames.total });
    }
    let disposition = format!("attachment; filename=\"{}.zip\"", frames.file_stem());
    let directory_bytes = u64::from(frames.stored).saturating_mul(DIRECTORY_ENTRY_BYTES) as usize;
    let room = shares.response(&holder, directory_bytes);
    let room = room
        .map_err(|exhausted| ApiError::exhausted(&holder, "bytes of responses that are not received yet", exhausted))?;
    let pieces = stream::unfold(Some((Archive::new(queue, content, pictures, frames), room)), async |archive| {
        let (mut archive, room) = archive?;
        match archive.next().await {
            Ok(Some(piece)) => Some((Ok(piece), Some((archive, room)))),
            Ok(None) => None,
            Err(error) => {
                tracing::error!(%error, "an archive was interrupted");
                Some((Err(error), None))
            }
        }
    });
    let mut response = Body::from_stream(pieces).into_response();
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/zip"));
    if let Ok(disposition) = HeaderValue::from_str(&disposition) {
        headers.insert(header::CONTENT_DISPOSITION, disposition);
    }
    Ok(response)
}
