//! The object at a point of a picture of a job that is being edited.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, Uri};
use proto::preview_helper::{HelperRequest, PickView};
use serde::Deserialize;

use crate::http::auth::Caller;
use crate::http::body::{self, RequestBody};
use crate::http::drawings::Drawings;
use crate::http::error::ApiError;
use crate::http::jobs::job_body;
use crate::preview_helper::HelperError;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct PickQuery {
    x: f32,
    y: f32,
    #[serde(default)]
    frame: u32,
}

/// Find the object at a point of a frame of a job that is not submitted.
///
/// The pointers lead to the object and its material in the job file as sent, also if they are in groups, or in shapes that
/// are used by name. Clouds and other volumes are not found, because they have no surface.
#[utoipa::path(
    post, path = "", tag = "pictures", operation_id = "pick_object",
    params(
        ("x" = f32, Query, description = "From the left of the picture, 0, to its right, 1", minimum = 0, maximum = 1),
        ("y" = f32, Query, description = "From the top of the picture, 0, to its bottom, 1", minimum = 0, maximum = 1),
        ("frame" = Option<u32>, Query, description = "The frame, from 0; 0 by default"),
        ("Content-Encoding" = Option<String>, Header, description = "`gzip` or `zstd` if the body is compressed; unpacked it has at most 32 MiB"),
    ),
    request_body(content = ref("#/components/schemas/Job"), content_type = "application/json"),
    responses((status = 200, description = "The surface; all members are null where there is none", body = ref("#/components/schemas/PickView")))
)]
pub(in crate::http) async fn pick(
    State(drawings): State<Drawings>,
    caller: Caller,
    uri: Uri,
    headers: HeaderMap,
    request: RequestBody,
) -> Result<Json<PickView>, ApiError> {
    let PickQuery { x, y, frame } = body::read_query(&uri)?;
    for (name, value) in [("x", x), ("y", y)] {
        if !(0.0..=1.0).contains(&value) {
            return Err(ApiError::WrongQuery(format!("{name} is {value}, but must be from 0 to 1")));
        }
    }
    let job = job_body::read(&drawings.jobs, &headers, request, frame).await?;
    let request = HelperRequest::Pick { job: job.text, frame, at: [x, y] };
    let (answer, _) = drawings.preview_helper.live(caller.name(), &request).await?;
    let pick = serde_json::from_slice(&answer).map_err(|error| HelperError::Failed(error.to_string()))?;
    Ok(Json(pick))
}
