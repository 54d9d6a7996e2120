//! Programs of approximate pictures: a scene as WGSL, made by a helper process. The server evaluates no scene.

use std::sync::Arc;

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, Uri, header};
use axum::response::{IntoResponse, Response};
use proto::preview_helper::HelperRequest;
use scene::limits::MAX_SAMPLES;
use serde::Deserialize;

use crate::http::body::{self, RequestBody};
use crate::http::error::ApiError;
use crate::http::jobs::job_body::{self, JobBody};
use crate::http::state::handle_group;
use crate::job_reader::JobReader;
use crate::preview_helper::PreviewHelper;

/// Maximum width of a picture.
const MAX_WIDTH_PX: u32 = 2048;

handle_group! {
    /// Handles of programs.
    Shaders {
        /// Checks job files.
        jobs: Arc<JobReader>,
        /// Makes programs.
        preview_helper: Arc<PreviewHelper>,
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ShaderQuery {
    #[serde(default)]
    frame: u32,
    width: Option<u32>,
    samples: Option<u32>,
    program: Option<String>,
}

fn check(name: &str, value: u32, max: u32) -> Result<u32, ApiError> {
    if (1..=max).contains(&value) {
        return Ok(value);
    }
    Err(ApiError::WrongQuery(format!("{name} is {value}, but must be from 1 to {max}")))
}

/// Get a job's frame as a program for WebGPU.
///
/// Pictures of the program are approximate: they are for a scene that is being edited. The text of the program depends on
/// the structure of the scene only, so that a client that has it, and says so by `program`, gets the numbers alone.
#[utoipa::path(
    post, path = "", tag = "pictures", operation_id = "get_shader",
    params(
        ("frame" = Option<u32>, Query, description = "The frame, from 0; 0 by default"),
        ("width" = Option<u32>, Query, description = "Width of the picture, in pixels; the job's by default", minimum = 1, maximum = 2048),
        ("samples" = Option<u32>, Query, description = "Samples a pixel; 1 by default", minimum = 1),
        ("program" = Option<String>, Query, description = "Hash of the program that the client has"),
        ("Content-Encoding" = Option<String>, Header, description = "`gzip` or `zstd` if the body is compressed; unpacked it has at most 32 MiB"),
    ),
    request_body(content = ref("#/components/schemas/Job"), content_type = "application/json"),
    responses((status = 200, description = "The program and its inputs", body = ref("#/components/schemas/ShaderView")))
)]
pub(in crate::http) async fn shader(
    State(shaders): State<Shaders>,
    uri: Uri,
    headers: HeaderMap,
    request: RequestBody,
) -> Result<Response, ApiError> {
    let ShaderQuery { frame, width, samples, program } = body::read_query(&uri)?;
    let width_px = width.map(|width| check("width", width, MAX_WIDTH_PX)).transpose()?;
    let samples = check("samples", samples.unwrap_or(1), MAX_SAMPLES)?;
    let submitter = request.holder().name.clone();
    let JobBody { text, _room } = job_body::read(&shaders.jobs, &headers, request, frame).await?;
    let request = HelperRequest::Shader { job: text, frame, width_px, samples, program };
    let json = shaders.preview_helper.shader(&submitter, &request).await?;
    let mut response = Body::from(json).into_response();
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("application/json"));
    Ok(response)
}
