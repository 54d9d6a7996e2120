//! Every error response of the API, and the only place that knows status codes.

mod causes;
mod table;

use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use proto::api_key::Scope;
use proto::job::JobState;
use proto::problem::ValidationErrorView;
use proto::{JobId, Problem};

use crate::admission::{CallerClass, Holder};
use crate::api_keys::ApiKeyError;
use crate::budget::Exhausted;
use crate::http::content_encoding::encoding_cure;
use crate::listen::SlowBody;
use crate::preview_helper::HelperError;
use table::ErrorResponse;

// Each error with its fix, and the response to it: status, stable code, title, and a header of some.
table::errors! {
    /// Reason for an error response, with its fix.
    #[derive(Debug, thiserror::Error)]
    pub(crate) enum ApiError;

    #[error("the body is not JSON: {}", first(.0))]
    NotJson(Vec<ValidationErrorView>) => BAD_REQUEST "not_json" "The body is not JSON";
    #[error("the job has {} (see errors): {}", faults(.0), first(.0))]
    WrongJob(Vec<ValidationErrorView>) => UNPROCESSABLE_ENTITY "wrong_job" "The job is invalid";
    #[error("the body is invalid for this route: {}", first(.0))]
    WrongBody(Vec<ValidationErrorView>) => UNPROCESSABLE_ENTITY "wrong_body" "The body is invalid";
    #[error("invalid query: {0}")]
    WrongQuery(String) => UNPROCESSABLE_ENTITY "wrong_query" "The query is invalid";
    #[error("invalid header: {0}")]
    WrongHeader(String) => BAD_REQUEST "wrong_header" "A header is invalid";
    #[error("{0}")]
    WrongWebhook(String) => UNPROCESSABLE_ENTITY "wrong_webhook" "The webhook is not allowed";
    #[error("this Idempotency-Key was used for another job: use a new key for a new job")]
    IdempotencyKeyReused => UNPROCESSABLE_ENTITY "key_reused" "The idempotency key was used before";
    #[error(
        "{stored} of the {total} pictures of job {job} are stored: wait for the rest, or get the stored ones with ?partial=true"
    )]
    FramesMissing { job: JobId, stored: u32, total: u32 } => CONFLICT "frames_missing" "Some pictures are not stored";
    #[error("the body has more than {limit_bytes} bytes, the limit of this route: send a smaller body")]
    TooLarge { limit_bytes: u64 } => PAYLOAD_TOO_LARGE "too_large" "The body is too large";
    #[error(
        "the content type is {found:?}: send JSON as application/json (with curl: --json @FILE, or \
         -H 'content-type: application/json' --data-binary @FILE)"
    )]
    WrongType { found: String } => UNSUPPORTED_MEDIA_TYPE "wrong_content_type" "The content type is not supported";
    #[error("the content encoding is {found:?}: {}", encoding_cure(.accepted))]
    WrongEncoding { found: String, accepted: &'static str }
        => UNSUPPORTED_MEDIA_TYPE "wrong_content_encoding" "The content encoding is not supported",
        ACCEPT_ENCODING = accepted;
    #[error(
        "the {encoding} body {cause} (after {unpacked_bytes} unpacked bytes): compress it again, or send it as it is, \
         without Content-Encoding"
    )]
    DamagedEncoding { encoding: &'static str, unpacked_bytes: usize, cause: String }
        => BAD_REQUEST "damaged_body" "The body cannot be unpacked";
    #[error(
        "the {encoding} body unpacks to more than {limit_bytes} bytes, the limit of this route: send a smaller body"
    )]
    UnpacksTooLarge { encoding: &'static str, limit_bytes: u64 }
        => PAYLOAD_TOO_LARGE "too_large" "The body is too large";
    #[error("the body is incomplete: {0}")]
    BrokenBody(String) => BAD_REQUEST "broken_body" "The body is incomplete";
    #[error("invalid request: {0}")]
    WrongRequest(&'static str) => BAD_REQUEST "wrong_request" "The request is invalid";
    #[error("there is no job {0}: GET /v1/jobs (`sdfarm jobs`) lists all jobs")]
    UnknownJob(String) => NOT_FOUND "unknown_job" "There is no such job";
    #[error("job {job} has no frame {frame}: {}", numbered(*.frames))]
    UnknownFrame { job: JobId, frame: String, frames: u32 } => NOT_FOUND "unknown_frame" "There is no such frame";
    #[error("{}", not_stored(.job, *.frame, *.state))]
    NotStored { job: JobId, frame: u32, state: JobState } => NOT_FOUND "picture_not_stored" "The picture is not stored";
    #[error("there is no {method} {path}: /docs lists the routes")]
    UnknownRoute { method: String, path: String } => NOT_FOUND "unknown_route" "There is no such route";
    #[error("{path} does not support {method}: see the Allow header, and /docs")]
    WrongMethod { method: String, path: String } => METHOD_NOT_ALLOWED "wrong_method" "The method is not allowed";
    #[error("job {job} is {}, which is final: the job cannot be changed any more", .state.name())]
    Finished { job: JobId, state: JobState } => CONFLICT "job_finished" "The job has finished";
    #[error("job {job} is {} and has no dead tiles: only failed jobs can be retried", .state.name())]
    NoDeadTiles { job: JobId, state: JobState } => CONFLICT "nothing_dead" "There is nothing to retry";
    #[error("job {0} is running: cancel it first, then delete it")]
    Running(JobId) => CONFLICT "job_running" "The job is running";
    #[error("the range is outside the picture, which has {size_bytes} bytes")]
    WrongRange { size_bytes: u64 } => RANGE_NOT_SATISFIABLE "wrong_range" "The range is not satisfiable",
        CONTENT_RANGE = format!("bytes */{size_bytes}");
    #[error(
        "unknown host {0:?}: use localhost or the server's IP address, \
         or start the server with --host and this name"
    )]
    ForeignHost(String) => FORBIDDEN "foreign_host" "The host is not this server";
    #[error("cross-origin request from {0:?} rejected: send it from this server's own pages or from a program")]
    ForeignOrigin(String) => FORBIDDEN "foreign_origin" "The origin is not this server";
    #[error(
        "the page of this server is read-only: use a command or a program, or start the server without --read-only-page"
    )]
    ReadOnlyPage => FORBIDDEN "read_only_page" "The page is read-only";
    #[error("this route is for pool workers, which send the pool's token")]
    WrongToken => UNAUTHORIZED "wrong_token" "The token is invalid", WWW_AUTHENTICATE = "Bearer";
    #[error(
        "this farm requires a key: send it as Authorization: Bearer KEY, or give it to sdfarm by SDFARM_KEY; \
         `sdfarm key new NAME --scope …` creates one on the server's machine"
    )]
    MissingKey => UNAUTHORIZED "missing_key" "A key is required", WWW_AUTHENTICATE = "Bearer";
    #[error("unknown key: send it as `sdfarm key new` printed it, to the server that it was created for")]
    UnknownKey => UNAUTHORIZED "unknown_key" "The key is unknown", WWW_AUTHENTICATE = "Bearer error=\"invalid_token\"";
    #[error("this key has expired: ask the farm's administrator for a new one")]
    ExpiredKey => UNAUTHORIZED "expired_key" "The key has expired", WWW_AUTHENTICATE = "Bearer error=\"invalid_token\"";
    #[error("this key was revoked, or has just expired: ask the farm's administrator for a new one")]
    RevokedKey => UNAUTHORIZED "revoked_key" "The key was revoked", WWW_AUTHENTICATE = "Bearer error=\"invalid_token\"";
    #[error("the key of {name} lacks scope {}: use a key that has it, or ask an administrator for one", .scope.name())]
    MissingScope { scope: Scope, name: String } => FORBIDDEN "missing_scope" "The key lacks a scope",
        WWW_AUTHENTICATE = format!("Bearer error=\"insufficient_scope\", scope=\"{}\"", scope.name());
    #[error("more than {per_second} requests per second: retry in {retry_seconds} s")]
    TooManyRequests { per_second: u32, retry_seconds: u64 }
        => TOO_MANY_REQUESTS "too_many_requests" "Too many requests", RETRY_AFTER = retry_seconds;
    #[error("the farm has its maximum of {limit} unfinished jobs: retry when some have finished")]
    QueueFull { limit: i64 } => TOO_MANY_REQUESTS "queue_full" "The queue is full", RETRY_AFTER = 10;
    #[error("{name} may have at most {limit} {what}: retry when some have finished, or cancel some")]
    Quota { name: String, what: &'static str, limit: i64 }
        => TOO_MANY_REQUESTS "quota" "The submitter's quota is used up", RETRY_AFTER = 10;
    #[error(
        "the key of {name} gives jobs priorities up to {max}, not {found}: use a lower priority, or ask an administrator \
         for a key with a higher one (`sdfarm key new NAME --max-priority {found}`)"
    )]
    PriorityTooHigh { name: String, found: i32, max: i32 } => FORBIDDEN "priority_too_high" "The priority is too high";
    #[error("{name} has at most {limit} {what} at a time: wait until some have finished, or close some")]
    TooManyAtOnce { name: String, what: &'static str, limit: usize }
        => TOO_MANY_REQUESTS "too_many_at_once" "The caller has too much in progress", RETRY_AFTER = 5;
    #[error("the server has its maximum of {limit} {what}: retry in a few seconds")]
    Busy { what: &'static str, limit: usize } => SERVICE_UNAVAILABLE "busy" "The server is busy", RETRY_AFTER = 5;
    #[error("the body arrived too slowly, or not at all: send it without pauses")]
    SlowBody => REQUEST_TIMEOUT "slow_body" "The body arrived too slowly";
    #[error("the server could not respond within {limit_seconds} s: retry")]
    ResponseTimeout { limit_seconds: u64 } => SERVICE_UNAVAILABLE "too_long" "The response timed out", RETRY_AFTER = 5;
    #[error(transparent)]
    InvalidNewKey(ApiKeyError) => UNPROCESSABLE_ENTITY "wrong_key" "The new key is invalid";
    #[error(transparent)]
    TooManyKeys(ApiKeyError) => CONFLICT "too_many_keys" "There are too many keys";
    #[error(transparent)]
    KeyNotFound(ApiKeyError) => NOT_FOUND "no_such_key" "There is no such key";
    #[error("unknown worker {0}: it did not sync for too long; register again")]
    UnknownWorker(String) => NOT_FOUND "unknown_worker" "There is no such worker";
    #[error("there is no worker {0}, or it has exited: GET /v1/workers (`sdfarm status`) lists those that run")]
    NoWorker(String) => NOT_FOUND "unknown_worker" "There is no such worker";
    #[error("worker {0} drains: it gets no more work, and exits when it has finished what it holds")]
    WorkerDraining(String) => CONFLICT "worker_draining" "The worker drains";
    #[error("worker {0} was registered with another key: use that key, or register again with this one")]
    ForeignWorker(String) => FORBIDDEN "foreign_worker" "The worker belongs to another key";
    #[error("no worker of this key has a lease that needs this: register a worker with this key, and claim work first")]
    NoLease => FORBIDDEN "no_lease" "The key has no lease that needs this";
    #[error(
        "the leases of this key need {limit_bytes} bytes, and its workers have sent twice as many without reporting them: report \
         results, and send only what a lease asks for"
    )]
    UnneededBytes { limit_bytes: u64 } => PAYLOAD_TOO_LARGE "unneeded_bytes" "The key's leases need fewer bytes";
    #[error("the worker renders picture version {found}, the server requires {wanted}: run the same release of both")]
    WrongPictureVersion { found: u32, wanted: u32 }
        => UNPROCESSABLE_ENTITY "wrong_picture_version" "The worker has another picture version";
    #[error("{0:?} is not a BLAKE3 hash: send 64 lower-case hexadecimal digits")]
    WrongHash(String) => UNPROCESSABLE_ENTITY "wrong_hash" "The name is not a hash";
    #[error("{0}")]
    WrongBytes(String) => UNPROCESSABLE_ENTITY "wrong_bytes" "The bytes do not match their hash";
    #[error("there is no blob {0}")]
    UnknownBlob(String) => NOT_FOUND "unknown_blob" "There is no such blob";
    #[error("the picture's file is missing: it is rendered again, retry when its job has succeeded")]
    LostPicture => INTERNAL_SERVER_ERROR "lost_picture" "The picture's file is gone";
    #[error("the picture's file is damaged: it is rendered again, retry when its job has succeeded")]
    DamagedPicture => INTERNAL_SERVER_ERROR "damaged_picture" "The picture's file is damaged";
    #[error("there is no picture {0}: `picture` of a frame (GET /v1/jobs/{{id}}/frames) is its hash")]
    UnknownPicture(String) => NOT_FOUND "unknown_picture" "There is no such picture";
    #[error(
        "the picture of frame {frame} of job {job} has no layer {layer:?}: it has {layers}; an EXR stores more with image.layers"
    )]
    UnknownLayer { job: JobId, frame: u32, layer: String, layers: String }
        => NOT_FOUND "unknown_layer" "There is no such layer";
    #[error("there is no shipped scene {0:?}: GET /v1/scenes lists them")]
    UnknownScene(String) => NOT_FOUND "unknown_scene" "There is no such scene";
    #[error("the link has expired ({0}): request a new one")]
    LinkExpired(String) => GONE "link_expired" "The link has expired";
    #[error("the signature does not match the link: use the link unchanged, or request a new one")]
    WrongSignature => FORBIDDEN "wrong_signature" "The signature is invalid";
    #[error(transparent)]
    PreviewDelayed(HelperError) => SERVICE_UNAVAILABLE "no_preview" "The preview failed", RETRY_AFTER = 5;
    #[error(
        "the preview could not be drawn: retry in a few seconds; the server's log has the cause under this request id"
    )]
    PreviewFailed => SERVICE_UNAVAILABLE "no_preview" "The preview failed", RETRY_AFTER = 5;
    #[error(transparent)]
    TooManyPreviews(HelperError) => TOO_MANY_REQUESTS "too_many_previews" "Too many previews are waiting",
        RETRY_AFTER = 5;
    #[error("the server is shutting down: retry in a few seconds")]
    ShuttingDown => SERVICE_UNAVAILABLE "closing" "The server is shutting down", RETRY_AFTER = 5;
    #[error("a disk is full: free space for the data folder, or for the database of a farm on PostgreSQL, then retry")]
    DiskFull => INSUFFICIENT_STORAGE "disk_full" "The disk is full";
    #[error("the database cannot be reached: retry in a few seconds; the server's log has the cause")]
    DatabaseUnreachable => SERVICE_UNAVAILABLE "database_unreachable" "The database cannot be reached", RETRY_AFTER = 5;
    #[error(
        "{attempt}, because it cannot be reached or fails: retry in a few seconds; the server's log has the cause and its fix"
    )]
    StoreUnreachable { attempt: String } => SERVICE_UNAVAILABLE "store_unreachable" "The store cannot be reached",
        RETRY_AFTER = 5;
    #[error("the database is damaged: stop the server, and restore the data folder from a backup")]
    DamagedDatabase => SERVICE_UNAVAILABLE "damaged_database" "The database is damaged";
    #[error("internal error: the server's log has the cause under this request id")]
    Internal(#[source] Box<dyn std::error::Error + Send + Sync>)
        => INTERNAL_SERVER_ERROR "internal" "The server failed";
}

fn first(faults: &[ValidationErrorView]) -> String {
    faults.first().map_or_else(String::new, |fault| {
        let place = if fault.pointer.is_empty() { String::new() } else { format!("{}: ", fault.pointer) };
        format!("{place}{} (line {}, column {})", fault.message, fault.line, fault.column)
    })
}

fn faults(faults: &[ValidationErrorView]) -> String {
    if faults.len() == 1 { "an error".to_owned() } else { format!("{} errors", faults.len()) }
}

fn numbered(frames: u32) -> String {
    match frames {
        0 | 1 => "its only frame is 0".to_owned(),
        _ => format!("its frames are 0 to {}", frames - 1),
    }
}

fn not_stored(job: &JobId, frame: u32, state: JobState) -> String {
    if state.is_final() {
        format!("frame {frame} of job {job} was never stored: the job is {}", state.name())
    } else {
        format!(
            "frame {frame} of job {job} is not stored yet: GET /v1/jobs/{job} (`sdfarm watch {job}`) shows its progress"
        )
    }
}

impl ApiError {
    /// Message for a body that did not arrive completely.
    pub(in crate::http) fn broken_body(error: &(dyn std::error::Error + 'static)) -> Self {
        let mut cause = Some(error);
        while let Some(error) = cause {
            if error.is::<SlowBody>() {
                return Self::SlowBody;
            }
            // The `source` of an I/O error skips the error it wraps.
            let wrapped = error.downcast_ref::<std::io::Error>().and_then(std::io::Error::get_ref);
            cause = wrapped.map(|error| error as &(dyn std::error::Error + 'static)).or_else(|| error.source());
        }
        Self::BrokenBody(error.to_string())
    }

    /// Error for a caller that has its part of a budget, or for a server whose budget is used up. A worker
    /// shares its key with others, so it retries in either case.
    pub(in crate::http) fn exhausted(holder: &Holder, what: &'static str, exhausted: Exhausted) -> Self {
        match exhausted {
            Exhausted::Holder(limit) if holder.class != CallerClass::Worker => {
                Self::TooManyAtOnce { name: holder.name.clone(), what, limit }
            }
            Exhausted::Holder(limit) | Exhausted::Total(limit) => Self::Busy { what, limit },
        }
    }

    fn problem(&self) -> Problem {
        let ErrorResponse { status, code, title, .. } = self.kind().response();
        let errors = match self {
            Self::NotJson(faults) | Self::WrongJob(faults) | Self::WrongBody(faults) => faults.clone(),
            _ => Vec::new(),
        };
        Problem {
            kind: format!("/docs#{code}"),
            title: title.to_owned(),
            status: status.as_u16(),
            code: code.to_owned(),
            detail: self.to_string(),
            errors,
            request_id: None,
        }
    }
}

impl IntoResponse for ApiError {
    /// Puts the problem into an extension of the response; `request_id` writes the body, with the request's id.
    fn into_response(self) -> Response {
        if let Self::Internal(error) = &self {
            tracing::error!(error = %chain(error.as_ref()), "request failed");
        }
        let problem = self.problem();
        let ErrorResponse { status, header, .. } = self.kind().response();
        let mut response = status.into_response();
        let value = self.header_value().and_then(|value| HeaderValue::from_str(&value).ok());
        if let (Some(header), Some(value)) = (header, value) {
            response.headers_mut().insert(header, value);
        }
        response.extensions_mut().insert(problem);
        response
    }
}

/// Joins an error and its causes in one line.
fn chain(error: &(dyn std::error::Error + 'static)) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_one_code_have_one_status_and_title() {
        for one in ErrorKind::ALL.iter().map(|kind| kind.response()) {
            for other in ErrorKind::ALL.iter().map(|kind| kind.response()).filter(|other| other.code == one.code) {
                assert_eq!((one.status, one.title), (other.status, other.title), "{}", one.code);
            }
        }
    }
}
