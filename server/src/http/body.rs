//! Reading request bodies: bounded, with an error message for each way to fail.

use axum::body::Body;
use axum::extract::Query;
use axum::http::{HeaderMap, Uri, header};
use bytes::{Bytes, BytesMut};
use futures_util::StreamExt;
use proto::problem::ValidationErrorView;
use serde::de::DeserializeOwned;

use super::error::ApiError;

/// Of a body that is too large, this many bytes are read and discarded, so that the client reads the response.
const MAX_DISCARDED_BYTES: usize = 64 << 20;

/// Rejects a body whose content type is not JSON; a body without a content type is taken as JSON.
pub(super) fn expect_json(headers: &HeaderMap) -> Result<(), ApiError> {
    let Some(value) = headers.get(header::CONTENT_TYPE) else { return Ok(()) };
    let found = value.to_str().unwrap_or("?");
    let media_type = found.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    let is_json =
        media_type == "application/json" || (media_type.starts_with("application/") && media_type.ends_with("+json"));
    if is_json { Ok(()) } else { Err(ApiError::WrongType { found: found.to_owned() }) }
}

/// Reads a body of at most `limit_bytes`.
pub(super) async fn read(body: Body, limit_bytes: usize) -> Result<Bytes, ApiError> {
    let mut stream = body.into_data_stream();
    let mut bytes = BytesMut::new();
    let mut size_bytes = 0;
    while let Some(chunk) = stream.next().await {
        let chunk = chunk.map_err(|error| ApiError::broken_body(&error))?;
        size_bytes += chunk.len();
        if size_bytes <= limit_bytes {
            bytes.extend_from_slice(&chunk);
        } else {
            bytes = BytesMut::new();
            if size_bytes > limit_bytes + MAX_DISCARDED_BYTES {
                break;
            }
        }
    }
    if size_bytes > limit_bytes {
        return Err(ApiError::TooLarge { limit_bytes: limit_bytes as u64 });
    }
    Ok(bytes.freeze())
}

/// Reads a JSON body of at most `limit_bytes`.
pub(super) async fn read_json<T: DeserializeOwned>(
    headers: &HeaderMap,
    body: Body,
    limit_bytes: usize,
) -> Result<T, ApiError> {
    expect_json(headers)?;
    let bytes = read(body, limit_bytes).await?;
    let mut reader = serde_json::Deserializer::from_slice(&bytes);
    let value = serde_path_to_error::deserialize(&mut reader).map_err(|error| reject(&error))?;
    reader.end().map_err(|error| not_json(&error))?;
    // serde would also accept a list of values in order, which no client intends.
    if bytes.trim_ascii_start().first() == Some(&b'[') {
        return Err(invalid_body("", "the body is a list: send an object".to_owned()));
    }
    Ok(value)
}

fn reject(error: &serde_path_to_error::Error<serde_json::Error>) -> ApiError {
    let inner = error.inner();
    if inner.is_data() {
        let pointer = error.path().iter().fold(String::new(), |pointer, segment| format!("{pointer}/{segment}"));
        ApiError::WrongBody(vec![fault(pointer, inner)])
    } else {
        ApiError::NotJson(vec![fault(String::new(), inner)])
    }
}

fn fault(pointer: String, error: &serde_json::Error) -> ValidationErrorView {
    let text = error.to_string();
    let message = text.split(" at line ").next().unwrap_or(&text).to_owned();
    ValidationErrorView { pointer, message, line: error.line() as u32, column: error.column() as u32 }
}

/// Error for a body that is not JSON.
pub(super) fn not_json(error: &serde_json::Error) -> ApiError {
    ApiError::NotJson(vec![fault(String::new(), error)])
}

/// Error for an invalid value in a JSON body.
pub(super) fn invalid_body(pointer: &str, message: String) -> ApiError {
    ApiError::WrongBody(vec![ValidationErrorView { pointer: pointer.to_owned(), message, line: 1, column: 1 }])
}

/// Reads a request's query.
pub(super) fn read_query<T: DeserializeOwned>(uri: &Uri) -> Result<T, ApiError> {
    match Query::try_from_uri(uri) {
        Ok(Query(query)) => Ok(query),
        Err(error) => Err(ApiError::WrongQuery(error.body_text())),
    }
}
