//! Pictures of jobs that are being edited: drawn at once by a helper process, and stored nowhere.

pub(super) mod pick;
pub(super) mod price;
pub(super) mod shaders;

use std::sync::Arc;
use std::time::Duration;

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, Uri, header};
use axum::response::{IntoResponse, Response};
use proto::preview_helper::{Drawing, HelperPicture, HelperRequest, PictureLayer};
use scene::limits::MAX_SAMPLES;
use serde::Deserialize;

use crate::http::auth::Caller;
use crate::http::body::{self, RequestBody};
use crate::http::error::ApiError;
use crate::http::frames::images;
use crate::http::jobs::job_body;
use crate::http::state::handle_group;
use crate::job_reader::JobReader;
use crate::preview_helper::{HelperError, PreviewHelper};

/// Default width of a picture.
const DEFAULT_WIDTH_PX: u32 = 480;
/// Maximum width of a picture.
const MAX_WIDTH_PX: u32 = 2048;
/// Default time for rendering, in milliseconds.
const DEFAULT_LIMIT_MS: u64 = 500;
/// Maximum time for rendering, in milliseconds.
const MAX_LIMIT_MS: u64 = 5000;
/// Header with the width of what was rendered.
pub(super) const PREVIEW_WIDTH: &str = "preview-width";
/// Header with the samples of what was rendered.
const PREVIEW_SAMPLES: &str = "preview-samples";
/// Header with the least values of a layer's channels.
const LAYER_MINIMUM: &str = "layer-minimum";
/// Header with the largest values of a layer's channels.
const LAYER_MAXIMUM: &str = "layer-maximum";
/// Header with the time of the helper.
const SERVER_TIMING: &str = "server-timing";

handle_group! {
    /// Handles of pictures of jobs that are being edited.
    Drawings {
        /// Validates jobs.
        jobs: Arc<JobReader>,
        /// Draws.
        preview_helper: Arc<PreviewHelper>,
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct DrawingQuery {
    #[serde(default = "default_width")]
    width: u32,
    #[serde(default)]
    frame: u32,
    #[serde(default = "default_samples")]
    samples: u32,
    #[serde(default)]
    layer: PictureLayer,
    #[serde(default = "default_limit_ms")]
    limit_ms: u64,
}

fn default_width() -> u32 {
    DEFAULT_WIDTH_PX
}

fn default_samples() -> u32 {
    1
}

fn default_limit_ms() -> u64 {
    DEFAULT_LIMIT_MS
}

impl DrawingQuery {
    fn read(uri: &Uri) -> Result<Self, ApiError> {
        let query: Self = body::read_query(uri)?;
        let in_range = |name: &str, value: u64, most: u64| match value {
            value if (1..=most).contains(&value) => Ok(()),
            value => Err(ApiError::WrongQuery(format!("{name} is {value}, but must be from 1 to {most}"))),
        };
        in_range("width", query.width.into(), MAX_WIDTH_PX.into())?;
        in_range("samples", query.samples.into(), MAX_SAMPLES.into())?;
        in_range("limit_ms", query.limit_ms, MAX_LIMIT_MS)?;
        Ok(query)
    }
}

/// Draw a frame of a job that is not submitted.
///
/// The picture has exactly the pixels that a job of this width and these samples has. If that takes longer than
/// `limit_ms`, fewer pixels are rendered and scaled up: `Preview-Width` tells how many there are in a row. Closing the
/// connection ends the render.
#[utoipa::path(
    post, path = "", tag = "pictures", operation_id = "draw_preview",
    params(
        ("width" = Option<u32>, Query, description = "Width, in pixels; 480 by default. The height follows from the job's", minimum = 1, maximum = 2048),
        ("frame" = Option<u32>, Query, description = "The frame, from 0; 0 by default"),
        ("samples" = Option<u32>, Query, description = "Samples of a pixel, instead of the job's; 1 by default", minimum = 1),
        ("layer" = Option<String>, Query, description = "Layer to show: color (default), depth, normal, position, albedo, object, steps"),
        ("limit_ms" = Option<u64>, Query, description = "Time after which fewer pixels are rendered, in milliseconds; 500 by default", minimum = 1, maximum = 5000),
        ("Content-Encoding" = Option<String>, Header, description = "`gzip` or `zstd` if the body is compressed; unpacked it has at most 32 MiB"),
    ),
    request_body(content = ref("#/components/schemas/Job"), content_type = "application/json"),
    responses(
        (status = 200, description = "The picture", body = Vec<u8>, content_type = "image/png", headers(
            ("Preview-Width" = u32, description = "Width of what was rendered, in pixels: less than the picture's if it took too long"),
            ("Preview-Samples" = u32, description = "Samples of each pixel that was rendered"),
            ("Layer-Minimum" = String, description = "Values of the layer's channels that the darkest colors show: of depth, position and steps"),
            ("Layer-Maximum" = String, description = "Values of the layer's channels that the brightest colors show: of depth, position and steps; near depths are bright"),
            ("Server-Timing" = String, description = "`helper;dur=N`: time of the process that drew it, in milliseconds"),
        )),
    )
)]
pub(super) async fn preview(
    State(drawings): State<Drawings>,
    caller: Caller,
    uri: Uri,
    headers: HeaderMap,
    request: RequestBody,
) -> Result<Response, ApiError> {
    let DrawingQuery { width, frame, samples, layer, limit_ms } = DrawingQuery::read(&uri)?;
    let job = job_body::read(&drawings.jobs, &headers, request, frame).await?;
    let drawing = Drawing { width_px: width, samples, layer, limit_ms };
    let request = HelperRequest::Draw { job: job.text, frame, drawing };
    let (answer, time) = drawings.preview_helper.live(caller.name(), &request).await?;
    let drawn = HelperPicture::decode(answer);
    let drawn = drawn.ok_or_else(|| HelperError::Failed("it returned no picture".to_owned()))?;
    let mut response = picture(drawn);
    images::set(&mut response, header::CACHE_CONTROL, "no-store");
    response.headers_mut().insert(SERVER_TIMING, timing(time));
    Ok(response)
}

/// Response with the picture of a helper.
pub(super) fn picture(drawn: HelperPicture) -> Response {
    let HelperPicture { about, png } = drawn;
    let mut response = Body::from(png).into_response();
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("image/png"));
    let mut set = |name, value: &str| {
        if let Ok(value) = HeaderValue::from_str(value) {
            response.headers_mut().insert(name, value);
        }
    };
    set(PREVIEW_WIDTH, &about.rendered_px.to_string());
    if about.samples > 0 {
        set(PREVIEW_SAMPLES, &about.samples.to_string());
    }
    for (name, values) in [LAYER_MINIMUM, LAYER_MAXIMUM].into_iter().zip(&about.range) {
        let values: Vec<String> = values.iter().map(f32::to_string).collect();
        if !values.is_empty() {
            set(name, &values.join(", "));
        }
    }
    response
}

/// Value of `Server-Timing` for a helper's time.
fn timing(time: Duration) -> HeaderValue {
    let text = format!("helper;dur={:.1}", time.as_secs_f64() * 1e3);
    HeaderValue::from_str(&text).unwrap_or_else(|_| HeaderValue::from_static("helper"))
}
