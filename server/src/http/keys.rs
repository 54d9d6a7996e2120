//! API keys for administrators: creation, list, revocation. `sdfarm key` does the same on the data folder.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use proto::api_key::{ApiKeyList, NewApiKey};

use crate::api_keys::ApiKeys;
use crate::http::body::{self, RequestBody};
use crate::http::error::ApiError;

/// Maximum size of a request body; valid ones are smaller.
const MAX_BYTES: usize = 16 << 10;

/// List the keys.
#[utoipa::path(
    get, path = "", tag = "keys", operation_id = "list_keys",
    responses((status = 200, description = "Every key, newest first, without secrets", body = ref("#/components/schemas/ApiKeyList")))
)]
pub(in crate::http) async fn list(State(keys): State<Arc<ApiKeys>>) -> Json<ApiKeyList> {
    Json(ApiKeyList { keys: keys.list() })
}

/// Create a key.
///
/// The response has the key's secret, which cannot be shown again. Two keys of one name may be live, so that a
/// new one can replace the old one without a gap. After the first key has been created, the farm rejects
/// requests without a key; therefore the first key needs the scope `admin`.
#[utoipa::path(
    post, path = "", tag = "keys", operation_id = "create_key",
    request_body(content = ref("#/components/schemas/NewApiKey"), content_type = "application/json"),
    responses((status = 201, description = "Created", body = ref("#/components/schemas/IssuedApiKey")))
)]
pub(in crate::http) async fn make(
    State(keys): State<Arc<ApiKeys>>,
    headers: HeaderMap,
    request: RequestBody,
) -> Result<Response, ApiError> {
    let new: NewApiKey = body::read_json(&headers, request, MAX_BYTES).await?;
    let issued = keys.create(new).await?;
    let mut response = (StatusCode::CREATED, Json(issued)).into_response();
    response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    Ok(response)
}

/// Revoke a key.
///
/// Open requests that use the key end immediately with 401.
#[utoipa::path(
    delete, path = "", tag = "keys", operation_id = "revoke_key",
    params(("id" = String, Path, description = "Id of a key, or a name, which revokes all its keys")),
    responses((status = 200, description = "The revoked keys", body = ref("#/components/schemas/ApiKeyList")))
)]
pub(in crate::http) async fn revoke(
    State(keys): State<Arc<ApiKeys>>,
    Path(id): Path<String>,
) -> Result<Json<ApiKeyList>, ApiError> {
    Ok(Json(ApiKeyList { keys: keys.revoke(&id).await? }))
}
