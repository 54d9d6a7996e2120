//! Help for writing job files: the table of everything that one is written with, the shipped scenes, and formatting.

use std::sync::{Arc, LazyLock};

use axum::Json;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use proto::shipped_scenes::SceneList;

use crate::http::body::RequestBody;
use crate::http::error::ApiError;
use crate::http::frames::{images, range};
use crate::http::jobs::job_body;
use crate::job_reader::JobReader;
use crate::shipped_scenes;

/// The table of nodes, as it is served, and its entity tag.
static NODE_TABLE: LazyLock<(Bytes, String)> = LazyLock::new(|| {
    let table = serde_json::to_vec(&scene::schema::node_table()).expect("a table is plain JSON");
    let tag = format!("\"{}\"", blake3::hash(&table).to_hex());
    (table.into(), tag)
});

/// Get everything that a job file is written with: nodes, materials, lights and so on, with their keys.
///
/// For completion and help in editors: flat, with the descriptions, ranges and defaults of the JSON Schema.
#[utoipa::path(
    get, path = "", tag = "schemas", operation_id = "node_table",
    responses(
        (status = 200, description = "The table", body = ref("#/components/schemas/NodeTable")),
        (status = 304, description = "The client has the current version"),
    )
)]
pub(in crate::http) async fn node_table(headers: HeaderMap) -> Response {
    let (table, tag) = &*NODE_TABLE;
    let known = headers.get(header::IF_NONE_MATCH).and_then(|value| value.to_str().ok());
    let mut response = if known.is_some_and(|named| range::matches_etag(named, tag)) {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        ([(header::CONTENT_TYPE, "application/json")], table.clone()).into_response()
    };
    images::set(&mut response, header::ETAG, tag);
    images::set(&mut response, header::CACHE_CONTROL, "no-cache");
    response
}

/// List the shipped scenes.
#[utoipa::path(
    get, path = "", tag = "schemas", operation_id = "list_scenes",
    responses((status = 200, description = "The scenes, by name", body = ref("#/components/schemas/SceneList")))
)]
pub(in crate::http) async fn scenes() -> Json<SceneList> {
    Json(shipped_scenes::list())
}

/// Get the job file of a shipped scene.
#[utoipa::path(
    get, path = "", tag = "schemas", operation_id = "get_scene",
    params(("name" = String, Path, description = "Name of the scene: csg, or paper%2Fcsg")),
    responses((status = 200, description = "The job file", body = ref("#/components/schemas/Job")))
)]
pub(in crate::http) async fn scene(Path(name): Path<String>) -> Result<Response, ApiError> {
    let file = shipped_scenes::job_file(&name).ok_or(ApiError::UnknownScene(name))?;
    Ok(([(header::CONTENT_TYPE, "application/json")], file).into_response())
}

/// Format a job file.
///
/// Only line breaks, indentation and spaces change, as by `sdfarm fmt`: comments, the text of numbers and the order of keys
/// stay. The job need not be valid, but must be JSON with comments and trailing commas.
#[utoipa::path(
    post, path = "", tag = "schemas", operation_id = "format_job",
    params(
        ("Content-Encoding" = Option<String>, Header, description = "`gzip` or `zstd` if the body is compressed; unpacked it has at most 32 MiB"),
    ),
    request_body(content = ref("#/components/schemas/Job"), content_type = "application/json"),
    responses((status = 200, description = "The text, formatted", body = ref("#/components/schemas/Job")))
)]
pub(in crate::http) async fn format(
    State(jobs): State<Arc<JobReader>>,
    headers: HeaderMap,
    request: RequestBody,
) -> Result<Response, ApiError> {
    let submitter = request.holder().name.clone();
    let (text, room) = job_body::text(&headers, request).await?;
    let formatted = jobs.format(&submitter, text).await?;
    drop(room);
    let mut response = ([(header::CONTENT_TYPE, "application/json")], formatted).into_response();
    images::set(&mut response, header::CACHE_CONTROL, "no-store");
    Ok(response)
}
