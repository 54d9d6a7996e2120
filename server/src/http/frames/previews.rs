//! Previews and thumbnails: the current state of a frame as a small PNG, drawn by a helper process.

use std::sync::Arc;

use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use proto::JobId;
use proto::job::JobState;
use proto::preview_helper::HelperRequest;
use serde::Deserialize;

use crate::blobs::{BlobStore, ContentError, ContentKind, LocalCopies};
use crate::http::auth::Caller;
use crate::http::body;
use crate::http::error::ApiError;
use crate::http::frames::layers::StoredFrame;
use crate::http::frames::{images, range};
use crate::http::state::handle_group;
use crate::pictures::Pictures;
use crate::preview_helper::PreviewHelper;
use crate::queue::{FrameContents, Queue};

/// Default width of a preview.
pub(in crate::http) const PREVIEW_PX: u32 = 960;
/// Default width of a thumbnail.
const THUMBNAIL_PX: u32 = 256;
/// Maximum width of a preview or thumbnail.
const MAX_WIDTH_PX: u32 = 2048;
/// Maximum time for the coarse pass under a preview, in milliseconds.
const COARSE_MS: u64 = 250;

handle_group! {
    /// Handles of previews.
    Previews {
        /// Has the frames.
        queue: Queue,
        /// Checks stored pictures.
        pictures: Arc<Pictures>,
        /// Draws.
        preview_helper: Arc<PreviewHelper>,
        /// Has the bytes that the helper reads.
        content: Arc<BlobStore>,
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::http) struct WidthQuery {
    pub(in crate::http) width: Option<u32>,
}

impl WidthQuery {
    fn read(uri: &Uri) -> Result<Option<u32>, ApiError> {
        body::read_query::<Self>(uri)?.checked()
    }

    /// The width, if it is in range.
    pub(in crate::http) fn checked(self) -> Result<Option<u32>, ApiError> {
        match self.width {
            Some(width) if !(1..=MAX_WIDTH_PX).contains(&width) => {
                Err(ApiError::WrongQuery(format!("width is {width}, but must be from 1 to {MAX_WIDTH_PX}")))
            }
            width => Ok(width),
        }
    }
}

/// Get the finished part of a frame as PNG.
///
/// Finished tiles cover a coarse pass, so that there is a picture within a second; for a stored frame it is
/// the picture, scaled down. Repeat the request with the `ETag`: the response is 304 until more is finished.
#[utoipa::path(
    get, path = "", tag = "pictures", operation_id = "get_preview",
    params(
        ("id" = String, Path, description = "The job"),
        ("frame" = u32, Path, description = "The frame, from 0"),
        ("width" = Option<u32>, Query, description = "Maximum width, in pixels; 960 by default", minimum = 1, maximum = 2048),
    ),
    responses(
        (status = 200, description = "The preview", body = Vec<u8>, content_type = "image/png"),
        (status = 304, description = "The client has the current version"),
    )
)]
pub(in crate::http) async fn preview(
    State(previews): State<Previews>,
    caller: Caller,
    Path((id, frame)): Path<(String, String)>,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let width = WidthQuery::read(&uri)?;
    let (job, frame) = images::frame_of(&previews.queue, &id, &frame).await?;
    previews.answer(PreviewClient { name: caller.name(), headers: &headers }, job, frame, width).await
}

/// Get a stored picture as a small PNG.
#[utoipa::path(
    get, path = "", tag = "pictures", operation_id = "get_thumbnail",
    params(
        ("id" = String, Path, description = "The job"),
        ("frame" = u32, Path, description = "The frame, from 0"),
        ("width" = Option<u32>, Query, description = "Maximum width, in pixels; 256 by default", minimum = 1, maximum = 2048),
    ),
    responses(
        (status = 200, description = "The thumbnail", body = Vec<u8>, content_type = "image/png"),
        (status = 304, description = "The client has the current version"),
    )
)]
pub(in crate::http) async fn thumbnail(
    State(previews): State<Previews>,
    caller: Caller,
    Path((id, frame)): Path<(String, String)>,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let width_px = WidthQuery::read(&uri)?.unwrap_or(THUMBNAIL_PX);
    let stored = StoredFrame::find(&previews, &id, &frame).await?;
    let reader = PreviewClient { name: caller.name(), headers: &headers };
    previews.scaled(reader, &stored.hash, stored.size_bytes, width_px, images::IMMUTABLE).await
}

/// Client that asks for a preview.
#[derive(Clone, Copy, Debug)]
pub(in crate::http) struct PreviewClient<'a> {
    /// Name under which it waits for a helper.
    pub(in crate::http) name: &'a str,
    /// Headers of its request.
    pub(in crate::http) headers: &'a HeaderMap,
}

impl Previews {
    /// Draws a preview of a frame.
    pub(in crate::http) async fn answer(
        &self,
        reader: PreviewClient<'_>,
        job: JobId,
        frame: u32,
        width_px: Option<u32>,
    ) -> Result<Response, ApiError> {
        let width_px = width_px.unwrap_or(PREVIEW_PX);
        match self.queue.frame_contents(job, frame).await? {
            FrameContents::Stored { hash, size_bytes } => {
                self.scaled(reader, &hash, size_bytes, width_px, "no-cache").await
            }
            FrameContents::Unfinished { state, blobs } => {
                self.unfinished(reader, job, frame, width_px, state, blobs).await
            }
            FrameContents::NoFrame(frames) => Err(ApiError::UnknownFrame { job, frame: frame.to_string(), frames }),
            FrameContents::NoJob => Err(ApiError::UnknownJob(job.to_string())),
        }
    }

    async fn scaled(
        &self,
        reader: PreviewClient<'_>,
        hash: &str,
        size_bytes: u64,
        width_px: u32,
        cache: &'static str,
    ) -> Result<Response, ApiError> {
        let tag = format!("\"{hash}-{width_px}\"");
        if is_known(reader.headers, &tag) {
            return Ok(describe(StatusCode::NOT_MODIFIED.into_response(), &tag, cache));
        }
        images::intact(&self.pictures, hash, size_bytes).await?;
        let request = async {
            let copies = self.copies(ContentKind::Picture, &[hash.to_owned()]).await?;
            Ok((HelperRequest::Thumbnail { file: copies.files()[0].clone(), width_px }, copies))
        };
        let picture = self.preview_helper.picture(reader.name, &tag, request).await?;
        Ok(png(picture, &tag, cache))
    }

    async fn unfinished(
        &self,
        reader: PreviewClient<'_>,
        job: JobId,
        frame: u32,
        width_px: u32,
        state: JobState,
        blobs: Vec<String>,
    ) -> Result<Response, ApiError> {
        let shown = format!("{job} {frame} {width_px} {} {}", state.name(), blobs.join(" "));
        let tag = format!("\"{}\"", blake3::hash(shown.as_bytes()).to_hex());
        if is_known(reader.headers, &tag) {
            return Ok(describe(StatusCode::NOT_MODIFIED.into_response(), &tag, "no-cache"));
        }
        let text = self.queue.file(job).await?.ok_or_else(|| ApiError::UnknownJob(job.to_string()))?;
        let request = async {
            let copies = self.copies(ContentKind::Blob, &blobs).await?;
            let request = HelperRequest::Preview {
                job: text,
                frame,
                width_px,
                tiles: copies.files().to_vec(),
                coarse: self.preview_helper.coarse(job, frame),
                coarse_ms: COARSE_MS,
            };
            Ok((request, copies))
        };
        let picture = self.preview_helper.picture(reader.name, &tag, request).await?;
        Ok(png(picture, &tag, "no-cache"))
    }

    /// Stored content as files that the helper can read.
    pub(in crate::http) async fn copies(
        &self,
        kind: ContentKind,
        names: &[String],
    ) -> Result<LocalCopies, ContentError> {
        LocalCopies::fetch(&self.content, self.preview_helper.folder(), kind, names).await
    }
}

/// Whether the client has the version with this tag.
pub(in crate::http) fn is_known(headers: &HeaderMap, tag: &str) -> bool {
    let known = headers.get(header::IF_NONE_MATCH).and_then(|value| value.to_str().ok());
    known.is_some_and(|named| range::matches_etag(named, tag))
}

fn png(picture: bytes::Bytes, tag: &str, cache: &'static str) -> Response {
    let mut response = describe(Body::from(picture).into_response(), tag, cache);
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("image/png"));
    response
}

/// Adds an entity tag and a cache lifetime to a response.
pub(in crate::http) fn describe(mut response: Response, tag: &str, cache: &'static str) -> Response {
    images::set(&mut response, header::ETAG, tag);
    images::set(&mut response, header::CACHE_CONTROL, cache);
    response
}
