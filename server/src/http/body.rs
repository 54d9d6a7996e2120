//! Reading request bodies: bounded, one by one and together, with an error message for each way to fail.

use std::convert::Infallible;
use std::ops::Deref;
use std::sync::Arc;

use axum::body::{Body, BodyDataStream};
use axum::extract::rejection::QueryRejection;
use axum::extract::{FromRef, FromRequest, Query, Request};
use axum::http::{HeaderMap, Uri, header};
use bytes::{Bytes, BytesMut};
use futures_util::StreamExt;
use proto::problem::ValidationErrorView;
use serde::de::DeserializeOwned;

use crate::admission::{CallerClass, Holder, Shares, UNCOUNTED_BYTES};
use crate::budget::Share;
use crate::http::content_encoding::ContentEncoding;
use crate::http::error::ApiError;
use crate::job_reader::JobReader;

/// Of a body that is too large, this many bytes are read and discarded, so that the client reads the response.
const MAX_DISCARDED_BYTES: usize = 64 << 20;

/// Rejects a body whose content type is not JSON; a body without a content type is taken as JSON.
pub(in crate::http) fn expect_json(headers: &HeaderMap) -> Result<(), ApiError> {
    let Some(value) = headers.get(header::CONTENT_TYPE) else { return Ok(()) };
    let found = value.to_str().unwrap_or("?");
    let media_type = found.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    let is_json =
        media_type == "application/json" || (media_type.starts_with("application/") && media_type.ends_with("+json"));
    if is_json { Ok(()) } else { Err(ApiError::WrongType { found: found.to_owned() }) }
}

/// Body of a request that is not read yet, and its sender's part of the memory for bodies.
#[derive(Debug)]
pub(in crate::http) struct RequestBody {
    body: Body,
    shares: Arc<Shares>,
    jobs: Arc<JobReader>,
    holder: Holder,
    share: Share,
}

/// Body in memory.
#[derive(Debug)]
pub(in crate::http) struct BodyBytes {
    bytes: Bytes,
    room: Room,
}

/// Memory of a body, returned when this is dropped.
#[derive(Debug)]
pub(in crate::http) struct Room {
    holder: Holder,
    share: Share,
    size_bytes: usize,
}

impl Room {
    /// Room for a body that is empty so far.
    fn new(holder: Holder, shares: &Shares) -> Self {
        let share = shares.body(&holder);
        Self { holder, share, size_bytes: 0 }
    }

    /// Takes room for this many more bytes; the first few of each body are not counted.
    pub(in crate::http) fn grow(&mut self, more_bytes: usize) -> Result<(), ApiError> {
        let counted = |size_bytes: usize| size_bytes.saturating_sub(UNCOUNTED_BYTES);
        let grown_bytes = self.size_bytes + more_bytes;
        self.share
            .grow(counted(grown_bytes) - counted(self.size_bytes))
            .map_err(|exhausted| ApiError::exhausted(&self.holder, "bytes of request bodies", exhausted))?;
        self.size_bytes = grown_bytes;
        Ok(())
    }

    /// Returns everything.
    fn clear(&mut self) {
        self.share.clear();
        self.size_bytes = 0;
    }
}

impl RequestBody {
    /// Its sender.
    pub(in crate::http) fn holder(&self) -> &Holder {
        &self.holder
    }

    /// The body as a stream, with room for `buffer_bytes` of it.
    pub(in crate::http) fn into_stream(self, buffer_bytes: usize) -> Result<(BodyDataStream, Room), ApiError> {
        let mut room = Room { holder: self.holder, share: self.share, size_bytes: 0 };
        room.grow(buffer_bytes)?;
        Ok((self.body.into_data_stream(), room))
    }
}

impl BodyBytes {
    /// The bytes, and their room for as long as they are needed.
    pub(in crate::http) fn into_parts(self) -> (Bytes, Room) {
        (self.bytes, self.room)
    }
}

impl Deref for BodyBytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.bytes
    }
}

impl<S: Sync> FromRequest<S> for RequestBody
where
    Arc<Shares>: FromRef<S>,
    Arc<JobReader>: FromRef<S>,
{
    type Rejection = Infallible;

    async fn from_request(request: Request, state: &S) -> Result<Self, Infallible> {
        let holder = request
            .extensions()
            .get::<Holder>()
            .cloned()
            .unwrap_or_else(|| Holder::of_address(CallerClass::User, None));
        let (shares, jobs) = (Arc::<Shares>::from_ref(state), Arc::from_ref(state));
        let share = shares.body(&holder);
        Ok(Self { body: request.into_body(), shares, jobs, holder, share })
    }
}

/// Reads a body of at most `limit_bytes`. Of a rejected body, the rest is discarded as it arrives.
pub(in crate::http) async fn read(request: RequestBody, limit_bytes: usize) -> Result<BodyBytes, ApiError> {
    let (mut stream, mut room) = request.into_stream(0)?;
    let mut bytes = BytesMut::new();
    let mut size_bytes = 0;
    let mut rejection = None;
    while let Some(chunk) = stream.next().await {
        let chunk = chunk.map_err(|error| ApiError::broken_body(&error))?;
        size_bytes += chunk.len();
        if rejection.is_none() {
            let grown = if size_bytes > limit_bytes {
                Err(ApiError::TooLarge { limit_bytes: limit_bytes as u64 })
            } else {
                room.grow(chunk.len())
            };
            match grown {
                Ok(()) => bytes.extend_from_slice(&chunk),
                Err(error) => {
                    bytes = BytesMut::new();
                    room.clear();
                    rejection = Some(error);
                }
            }
        }
        if size_bytes > limit_bytes + MAX_DISCARDED_BYTES {
            break;
        }
    }
    match rejection {
        Some(error) => Err(error),
        None => Ok(BodyBytes { bytes: bytes.freeze(), room }),
    }
}

/// Reads a body that is at most `limit_bytes` as sent, and when it is unpacked. It is unpacked when it is its sender's
/// turn, and counted as it grows.
pub(in crate::http) async fn read_encoded(
    request: RequestBody,
    encoding: Option<ContentEncoding>,
    limit_bytes: usize,
) -> Result<BodyBytes, ApiError> {
    let (shares, jobs) = (Arc::clone(&request.shares), Arc::clone(&request.jobs));
    let holder = request.holder.clone();
    let packed = read(request, limit_bytes).await?;
    let Some(encoding) = encoding else { return Ok(packed) };
    let (name, room) = (holder.name.clone(), Room::new(holder, &shares));
    jobs.run(&name, move || unpack(encoding, &packed, limit_bytes, room)).await?
}

/// Unpacks a body into a room of its own.
fn unpack(encoding: ContentEncoding, packed: &[u8], limit_bytes: usize, mut room: Room) -> Result<BodyBytes, ApiError> {
    let bytes = encoding.unpack(packed, limit_bytes, |size_bytes| room.grow(size_bytes))?;
    Ok(BodyBytes { bytes: bytes.into(), room })
}

/// Reads a JSON body of at most `limit_bytes`, which has no content encoding.
pub(in crate::http) async fn read_json<T: DeserializeOwned>(
    headers: &HeaderMap,
    body: RequestBody,
    limit_bytes: usize,
) -> Result<T, ApiError> {
    expect_json(headers)?;
    ContentEncoding::expect_none(headers)?;
    let bytes = read(body, limit_bytes).await?;
    if let Some(at) = escaped_nul(&bytes) {
        let lines: Vec<&[u8]> = bytes[..at].split(|byte| *byte == b'\n').collect();
        let (line, column) = (lines.len() as u32, lines.last().map_or(0, |last| last.len()) as u32 + 1);
        let message = "has the character \\u0000, which cannot be stored: leave it out".to_owned();
        return Err(ApiError::WrongBody(vec![ValidationErrorView { pointer: String::new(), message, line, column }]));
    }
    let mut reader = serde_json::Deserializer::from_slice(&bytes);
    let value = serde_path_to_error::deserialize(&mut reader).map_err(|error| reject(&error))?;
    reader.end().map_err(|error| not_json(&error))?;
    // serde would also accept a list of values in order, which no client intends.
    if bytes.trim_ascii_start().first() == Some(&b'[') {
        return Err(invalid_body("", "the body is a list: send an object".to_owned()));
    }
    Ok(value)
}

/// Offset of the first escape of NUL in a JSON text, which cannot have it otherwise.
fn escaped_nul(text: &[u8]) -> Option<usize> {
    let mut from = 0;
    while let Some(at) = text[from..].iter().position(|byte| *byte == b'\\').map(|at| from + at) {
        if text[at..].starts_with(br"\u0000") {
            return Some(at);
        }
        // The escaped character may be a backslash.
        from = (at + 2).min(text.len());
    }
    None
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
pub(in crate::http) fn not_json(error: &serde_json::Error) -> ApiError {
    ApiError::NotJson(vec![fault(String::new(), error)])
}

/// Error for an invalid value in a JSON body.
pub(in crate::http) fn invalid_body(pointer: &str, message: String) -> ApiError {
    ApiError::WrongBody(vec![ValidationErrorView { pointer: pointer.to_owned(), message, line: 1, column: 1 }])
}

/// Reads a request's query, in which a line may end but no other control character stand.
pub(in crate::http) fn read_query<T: DeserializeOwned>(uri: &Uri) -> Result<T, ApiError> {
    let is_wrong = |letter: char| letter.is_control() && !matches!(letter, '\t' | '\n' | '\r');
    let wrong = |error: QueryRejection| ApiError::WrongQuery(error.body_text());
    let Query(pairs) = Query::<Vec<(String, String)>>::try_from_uri(uri).map_err(wrong)?;
    if let Some((name, _)) = pairs.iter().find(|(name, value)| name.contains(is_wrong) || value.contains(is_wrong)) {
        let name = proto::plain_text::escape_line(name);
        return Err(ApiError::WrongQuery(format!("{name} has a control character: leave it out")));
    }
    Query::try_from_uri(uri).map(|Query(query)| query).map_err(wrong)
}

/// Length of a page: `asked`, or the default.
pub(in crate::http) fn page_length(asked: Option<u32>, default: u32, max: u32) -> Result<u32, ApiError> {
    let limit = asked.unwrap_or(default);
    if (1..=max).contains(&limit) {
        return Ok(limit);
    }
    Err(ApiError::WrongQuery(format!("limit is {limit}, but must be from 1 to {max}")))
}

/// Error for a cursor that no page has.
pub(in crate::http) fn wrong_cursor(cursor: &str) -> ApiError {
    ApiError::WrongQuery(format!("{cursor:?} is not a cursor: pass the next_cursor of the page before"))
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use flate2::Compression;
    use flate2::write::GzEncoder;

    use super::*;

    #[test]
    fn unpacked_bytes_count_as_those_of_their_sender() {
        const LIMIT_BYTES: usize = 32 << 20;
        let mut writer = GzEncoder::new(Vec::new(), Compression::fast());
        let packed = writer.write_all(&vec![b' '; LIMIT_BYTES]).and_then(|()| writer.finish()).expect("in memory");
        let shares = Shares::new(100, 100);
        let anna = Holder { class: CallerClass::User, name: "anna".to_owned() };
        let unpack = |room| unpack(ContentEncoding::Gzip, &packed, LIMIT_BYTES, room);
        let first = unpack(Room::new(anna.clone(), &shares)).expect("half of a user's part");
        assert_eq!(shares.body_bytes(), LIMIT_BYTES - UNCOUNTED_BYTES);
        let second = unpack(Room::new(anna.clone(), &shares)).expect("the other half");
        let third = unpack(Room::new(anna, &shares));
        assert!(matches!(third, Err(ApiError::TooManyAtOnce { .. })), "{third:?}");
        drop((first, second));
        assert_eq!(shares.body_bytes(), 0);
    }
}
