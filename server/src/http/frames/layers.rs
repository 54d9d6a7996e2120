//! Layers and pixel values of stored pictures, read by a helper process.

use std::path::PathBuf;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use proto::JobId;
use proto::preview_helper::{HelperPicture, HelperRequest, LayersView, PixelView, StoredAnswer, StoredLayer};
use serde::Deserialize;

use crate::blobs::ContentKind;
use crate::http::auth::Caller;
use crate::http::body;
use crate::http::drawings;
use crate::http::error::ApiError;
use crate::http::frames::images::{self, IMMUTABLE};
use crate::http::frames::previews::{PREVIEW_PX, Previews, WidthQuery, describe, is_known};
use crate::preview_helper::HelperError;
use crate::queue::FrameContents;

/// Maximum exposure, in stops up or down.
const MAX_EXPOSURE: f32 = 20.0;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LayerQuery {
    width: Option<u32>,
    #[serde(default)]
    exposure: f32,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct PixelQuery {
    x: u32,
    y: u32,
}

/// Picture of a frame that is stored.
pub(in crate::http) struct StoredFrame {
    /// The job.
    pub(in crate::http) job: JobId,
    /// The frame.
    pub(in crate::http) frame: u32,
    /// BLAKE3 of the picture, in hex.
    pub(in crate::http) hash: String,
    /// Its size.
    pub(in crate::http) size_bytes: u64,
}

impl StoredFrame {
    /// The picture of a request's frame.
    pub(in crate::http) async fn find(previews: &Previews, id: &str, frame: &str) -> Result<Self, ApiError> {
        let (job, frame) = images::frame_of(&previews.queue, id, frame).await?;
        match previews.queue.frame_contents(job, frame).await? {
            FrameContents::Stored { hash, size_bytes } => Ok(Self { job, frame, hash, size_bytes }),
            FrameContents::Unfinished { state, .. } => Err(ApiError::NotStored { job, frame, state }),
            FrameContents::NoFrame(frames) => Err(ApiError::UnknownFrame { job, frame: frame.to_string(), frames }),
            FrameContents::NoJob => Err(ApiError::UnknownJob(job.to_string())),
        }
    }
}

/// List the layers of a stored picture.
#[utoipa::path(
    get, path = "", tag = "pictures", operation_id = "list_layers",
    params(
        ("id" = String, Path, description = "The job"),
        ("frame" = u32, Path, description = "The frame, from 0"),
    ),
    responses((status = 200, description = "The layers", body = ref("#/components/schemas/LayersView")))
)]
pub(in crate::http) async fn list(
    State(previews): State<Previews>,
    caller: Caller,
    Path((id, frame)): Path<(String, String)>,
) -> Result<Json<LayersView>, ApiError> {
    let stored = StoredFrame::find(&previews, &id, &frame).await?;
    let answer = previews.ask(&caller, &stored, |file| HelperRequest::ReadLayers { file }).await?;
    match answer {
        StoredAnswer::Layers(view) => Ok(Json(view)),
        other => Err(unexpected(&other)),
    }
}

/// Get a layer of a stored picture as PNG.
#[utoipa::path(
    get, path = "", tag = "pictures", operation_id = "get_layer",
    params(
        ("id" = String, Path, description = "The job"),
        ("frame" = u32, Path, description = "The frame, from 0"),
        ("layer" = String, Path, description = "The layer, by its name in the list of the picture's layers"),
        ("width" = Option<u32>, Query, description = "Maximum width, in pixels; 960 by default", minimum = 1, maximum = 2048),
        ("exposure" = Option<f32>, Query, description = "Exposure of colors, in stops; 0 by default", minimum = -20, maximum = 20),
    ),
    responses(
        (status = 200, description = "The layer", body = Vec<u8>, content_type = "image/png", headers(
            ("Layer-Minimum" = String, description = "Values of the layer's channels that the darkest colors show: of depth, position and steps"),
            ("Layer-Maximum" = String, description = "Values of the layer's channels that the brightest colors show: of depth, position and steps; near depths are bright"),
        )),
        (status = 304, description = "The client has the current version"),
    )
)]
pub(in crate::http) async fn layer(
    State(previews): State<Previews>,
    caller: Caller,
    Path((id, frame, name)): Path<(String, String, String)>,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let LayerQuery { width, exposure } = body::read_query(&uri)?;
    let width_px = WidthQuery { width }.checked()?.unwrap_or(PREVIEW_PX);
    if !exposure.is_finite() || exposure.abs() > MAX_EXPOSURE {
        return Err(ApiError::WrongQuery(format!(
            "exposure is {exposure}, but must be from -{MAX_EXPOSURE} to {MAX_EXPOSURE} stops"
        )));
    }
    let stored = StoredFrame::find(&previews, &id, &frame).await?;
    let Ok(layer) = StoredLayer::try_from(name.clone()) else {
        return Err(previews.unknown_layer(&caller, &stored, name).await);
    };
    let tag = format!("\"{}-{name}-{width_px}-{exposure}\"", stored.hash);
    if is_known(&headers, &tag) {
        return Ok(describe(StatusCode::NOT_MODIFIED.into_response(), &tag, IMMUTABLE));
    }
    images::intact(&previews.pictures, &stored.hash, stored.size_bytes).await?;
    let request = async {
        let copies = previews.copies(ContentKind::Picture, std::slice::from_ref(&stored.hash)).await?;
        let file = copies.files()[0].clone();
        Ok((HelperRequest::DrawLayer { file, layer, width_px, exposure }, copies))
    };
    let answer = previews.preview_helper.picture(caller.name(), &tag, request).await?;
    match HelperPicture::decode(answer.to_vec()) {
        Some(picture) => {
            let mut response = describe(drawings::picture(picture), &tag, IMMUTABLE);
            response.headers_mut().remove(drawings::PREVIEW_WIDTH);
            Ok(response)
        }
        None => match read(&answer)? {
            StoredAnswer::NoLayer(layers) => Err(no_layer(&stored, name, &layers)),
            other => Err(unexpected(&other)),
        },
    }
}

/// Get the values of a pixel of a stored picture.
#[utoipa::path(
    get, path = "", tag = "pictures", operation_id = "get_pixel",
    params(
        ("id" = String, Path, description = "The job"),
        ("frame" = u32, Path, description = "The frame, from 0"),
        ("x" = u32, Query, description = "Column, from 0"),
        ("y" = u32, Query, description = "Row from the top, from 0"),
    ),
    responses((status = 200, description = "The values of all channels of the file", body = ref("#/components/schemas/PixelView")))
)]
pub(in crate::http) async fn pixel(
    State(previews): State<Previews>,
    caller: Caller,
    Path((id, frame)): Path<(String, String)>,
    uri: Uri,
) -> Result<Response, ApiError> {
    let PixelQuery { x, y } = body::read_query(&uri)?;
    let stored = StoredFrame::find(&previews, &id, &frame).await?;
    let answer = previews.ask(&caller, &stored, |file| HelperRequest::ReadPixel { file, x, y }).await?;
    match answer {
        StoredAnswer::Pixel(view) => {
            Ok(([(header::CACHE_CONTROL, IMMUTABLE)], Json::<PixelView>(view)).into_response())
        }
        StoredAnswer::Outside { width, height } => Err(ApiError::WrongQuery(format!(
            "the pixel {x}, {y} is outside the picture, which has {width}×{height} pixels, counted from 0"
        ))),
        other => Err(unexpected(&other)),
    }
}

impl Previews {
    /// Asks a helper about a stored picture.
    async fn ask(
        &self,
        caller: &Caller,
        stored: &StoredFrame,
        request: impl FnOnce(PathBuf) -> HelperRequest,
    ) -> Result<StoredAnswer, ApiError> {
        let answer = self.ask_helper(caller, stored, request).await;
        if answer.is_err() && matches!(self.queue.frame_contents(stored.job, stored.frame).await?, FrameContents::NoJob)
        {
            // The job was deleted meanwhile, and its picture with it.
            return Err(ApiError::UnknownJob(stored.job.to_string()));
        }
        answer
    }

    async fn ask_helper(
        &self,
        caller: &Caller,
        stored: &StoredFrame,
        request: impl FnOnce(PathBuf) -> HelperRequest,
    ) -> Result<StoredAnswer, ApiError> {
        images::intact(&self.pictures, &stored.hash, stored.size_bytes).await?;
        let copies =
            self.copies(ContentKind::Picture, std::slice::from_ref(&stored.hash)).await.map_err(HelperError::from)?;
        let request = request(copies.files()[0].clone());
        let (answer, _) = self.preview_helper.live(caller.name(), &request).await?;
        drop(copies);
        read(&answer)
    }

    /// Error for a name that no layer has.
    async fn unknown_layer(&self, caller: &Caller, stored: &StoredFrame, name: String) -> ApiError {
        match self.ask(caller, stored, |file| HelperRequest::ReadLayers { file }).await {
            Ok(StoredAnswer::Layers(view)) => no_layer(stored, name, &view.layers),
            Ok(other) => unexpected(&other),
            Err(error) => error,
        }
    }
}

fn no_layer(stored: &StoredFrame, layer: String, layers: &[StoredLayer]) -> ApiError {
    let layers = layers.iter().map(StoredLayer::to_string).collect::<Vec<_>>().join(", ");
    ApiError::UnknownLayer { job: stored.job, frame: stored.frame, layer, layers }
}

fn read(answer: &[u8]) -> Result<StoredAnswer, ApiError> {
    Ok(serde_json::from_slice(answer).map_err(|error| HelperError::Failed(error.to_string()))?)
}

fn unexpected(answer: &StoredAnswer) -> ApiError {
    HelperError::Failed(format!("it answered another request: {answer:?}")).into()
}
