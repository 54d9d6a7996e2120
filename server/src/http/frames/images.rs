//! Serves the stored pictures of frames.

use std::sync::Arc;

use axum::Json;
use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use proto::JobId;
use proto::frame::ForgottenPicture;

use crate::blobs::{BlobStore, ContentHash, ContentKind};
use crate::http::error::ApiError;
use crate::http::frames::range::{self, ByteRange};
use crate::http::jobs::job_id;
use crate::http::state::handle_group;
use crate::pictures::{PictureError, PictureState, Pictures};
use crate::queue::{Queue, StoredImage};

/// Cache lifetime: a frame's picture never changes.
pub(in crate::http) const IMMUTABLE: &str = "public, max-age=31536000, immutable";

handle_group! {
    /// Handles of the pictures of frames.
    StoredPictures {
        /// Has the frames.
        queue: Queue,
        /// Has the pictures.
        content: Arc<BlobStore>,
        /// Checks them.
        pictures: Arc<Pictures>,
    }
}

/// Get the picture of a job's first frame.
#[utoipa::path(
    get, path = "", tag = "pictures", operation_id = "get_image",
    params(("id" = String, Path, description = "The job")),
    responses(
        (status = 200, description = "The picture: image/png or image/x-exr, depending on the job", body = Vec<u8>, content_type = "image/*"),
        (status = 206, description = "The requested range"),
        (status = 304, description = "The client has the current version"),
        (status = 307, description = "The picture is at this address for five minutes; only with --redirect-pictures"),
    )
)]
pub(in crate::http) async fn first_frame(
    State(stored): State<StoredPictures>,
    Path(id): Path<String>,
    method: Method,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    stored.answer(job_id(&id)?, 0, &method, &headers).await
}

/// Get the picture of one of a job's frames.
#[utoipa::path(
    get, path = "", tag = "pictures", operation_id = "get_frame_image",
    params(
        ("id" = String, Path, description = "The job"),
        ("frame" = u32, Path, description = "The frame, from 0"),
    ),
    responses(
        (status = 200, description = "The picture: image/png or image/x-exr, depending on the job", body = Vec<u8>, content_type = "image/*"),
        (status = 206, description = "The requested range"),
        (status = 304, description = "The client has the current version"),
        (status = 307, description = "The picture is at this address for five minutes; only with --redirect-pictures"),
    )
)]
pub(in crate::http) async fn frame(
    State(stored): State<StoredPictures>,
    Path((id, frame)): Path<(String, String)>,
    method: Method,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let (job, frame) = frame_of(&stored.queue, &id, &frame).await?;
    stored.answer(job, frame, &method, &headers).await
}

/// Parses a job id and a frame number from a path.
pub(in crate::http) async fn frame_of(queue: &Queue, id: &str, frame: &str) -> Result<(JobId, u32), ApiError> {
    let job = job_id(id)?;
    match frame.parse() {
        Ok(number) => Ok((job, number)),
        Err(_) => match queue.job(job).await? {
            Some(view) => {
                Err(ApiError::UnknownFrame { job, frame: frame.to_owned(), frames: view.frames.total as u32 })
            }
            None => Err(ApiError::UnknownJob(id.to_owned())),
        },
    }
}

impl StoredPictures {
    /// Response with a frame's stored picture.
    pub(in crate::http) async fn answer(
        &self,
        job: JobId,
        frame: u32,
        method: &Method,
        headers: &HeaderMap,
    ) -> Result<Response, ApiError> {
        let (hash, size_bytes, media_type) = match self.queue.image(job, frame).await? {
            StoredImage::Stored { hash, size_bytes, media_type } => (hash, size_bytes, media_type),
            StoredImage::NotYet(state) => return Err(ApiError::NotStored { job, frame, state }),
            StoredImage::NoFrame(frames) => {
                return Err(ApiError::UnknownFrame { job, frame: frame.to_string(), frames });
            }
            StoredImage::NoJob => return Err(ApiError::UnknownJob(job.to_string())),
        };
        let tag = format!("\"{hash}\"");
        if headers
            .get(header::IF_NONE_MATCH)
            .and_then(|value| value.to_str().ok())
            .is_some_and(|named| range::matches_etag(named, &tag))
        {
            return Ok(set_cache_headers(StatusCode::NOT_MODIFIED.into_response(), &tag));
        }
        let asked = match headers.get(header::IF_RANGE) {
            Some(condition) if condition.as_bytes() != tag.as_bytes() => ByteRange::Full,
            Some(_) | None => {
                range::parse_range(headers.get(header::RANGE).and_then(|value| value.to_str().ok()), size_bytes)
            }
        };
        let (status, part) = match asked {
            ByteRange::Full => (StatusCode::OK, None),
            ByteRange::Part(part) => (StatusCode::PARTIAL_CONTENT, Some(part)),
            ByteRange::Unsatisfiable => return Err(ApiError::WrongRange { size_bytes }),
        };
        let name = intact(&self.pictures, &hash, size_bytes).await?;
        // The address in the store is for GET only.
        if *method == Method::GET
            && let Some(address) = self.pictures.redirect(&name, size_bytes, &media_type).await?
        {
            return Ok(redirect(&address));
        }
        let found = self.content.get(ContentKind::Picture, &name, part.clone()).await?;
        let Some((length_bytes, bytes)) = found else { return Err(ApiError::LostPicture) };
        let mut response = set_cache_headers((status, Body::from_stream(bytes)).into_response(), &tag);
        set(&mut response, header::CONTENT_TYPE, &media_type);
        set(&mut response, header::CONTENT_LENGTH, &length_bytes.to_string());
        if let Some(part) = part {
            set(&mut response, header::CONTENT_RANGE, &format!("bytes {}-{}/{size_bytes}", part.start, part.end - 1));
        }
        Ok(response)
    }
}

/// Response that sends the client to the store; the address soon expires, so it must not be cached.
fn redirect(address: &str) -> Response {
    let mut response = StatusCode::TEMPORARY_REDIRECT.into_response();
    set(&mut response, header::LOCATION, address);
    set(&mut response, header::CACHE_CONTROL, "no-store");
    response
}

/// Name of a picture whose file is intact; otherwise its frames are rendered again.
pub(in crate::http) async fn intact(pictures: &Pictures, hash: &str, size_bytes: u64) -> Result<ContentHash, ApiError> {
    match pictures.check(hash, size_bytes).await? {
        PictureState::Intact(name) => Ok(name),
        PictureState::Missing => Err(ApiError::LostPicture),
        PictureState::Damaged => Err(ApiError::DamagedPicture),
    }
}

/// Forget a picture everywhere.
///
/// Deletes the picture's file, removes it from the cache, and renders the frames that showed it again, in every job;
/// the jobs run meanwhile. Frames of failed and cancelled jobs have no picture afterwards.
#[utoipa::path(
    delete, path = "", tag = "pictures", operation_id = "forget_picture",
    params(("hash" = String, Path, description = "BLAKE3 of the picture's bytes, in hex: `picture` of a frame, and the image's ETag")),
    responses((status = 200, description = "The picture is forgotten", body = ref("#/components/schemas/ForgottenPicture")))
)]
pub(in crate::http) async fn forget(
    State(pictures): State<Arc<Pictures>>,
    Path(hash): Path<String>,
) -> Result<Json<ForgottenPicture>, ApiError> {
    let name = ContentHash::parse(&hash).ok_or_else(|| ApiError::WrongHash(hash.clone()))?;
    pictures.forget(&name).await?.map(Json).ok_or(ApiError::UnknownPicture(hash))
}

fn set_cache_headers(mut response: Response, tag: &str) -> Response {
    set(&mut response, header::ETAG, tag);
    set(&mut response, header::CACHE_CONTROL, IMMUTABLE);
    set(&mut response, header::ACCEPT_RANGES, "bytes");
    response
}

pub(in crate::http) fn set(response: &mut Response, name: HeaderName, value: &str) {
    if let Ok(value) = HeaderValue::from_str(value) {
        response.headers_mut().insert(name, value);
    }
}

impl From<PictureError> for ApiError {
    fn from(error: PictureError) -> Self {
        match error {
            PictureError::Store(error) => error.into(),
            PictureError::Content(error) => error.into(),
        }
    }
}
