//! Job file as the body of a request that only asks about it: read, unpacked and validated as a submission is, but not
//! accepted.

use axum::http::HeaderMap;
use bytes::Bytes;

use crate::http::body::{self, RequestBody, Room};
use crate::http::content_encoding::ContentEncoding;
use crate::http::error::ApiError;
use crate::job_reader::JobReader;

/// A valid job file.
#[derive(Debug)]
pub(in crate::http) struct JobBody {
    /// Its text.
    pub(in crate::http) text: String,
    /// Memory of the text, returned when this is dropped.
    pub(in crate::http) _room: Room,
}

/// Reads the text of a request's job file, and the memory that it takes.
pub(in crate::http) async fn text(headers: &HeaderMap, request: RequestBody) -> Result<(Bytes, Room), ApiError> {
    body::expect_json(headers)?;
    let encoding = ContentEncoding::of(headers)?;
    Ok(body::read_encoded(request, encoding, scene::limits::MAX_BODY_BYTES).await?.into_parts())
}

/// Reads the job file of a request for one of its frames.
pub(in crate::http) async fn read(
    jobs: &JobReader,
    headers: &HeaderMap,
    request: RequestBody,
    frame: u32,
) -> Result<JobBody, ApiError> {
    let submitter = request.holder().name.clone();
    let (text, room) = text(headers, request).await?;
    if let Err(count) = jobs.check_frame(&submitter, text.clone(), frame).await? {
        let frames =
            if count == 1 { "its only frame is 0".to_owned() } else { format!("its frames are 0 to {}", count - 1) };
        return Err(ApiError::WrongQuery(format!("the job has no frame {frame}: {frames}")));
    }
    let text = String::from_utf8(text.into()).map_err(|error| ApiError::Internal(Box::new(error)))?;
    Ok(JobBody { text, _room: room })
}
