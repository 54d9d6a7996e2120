//! Job files: returned as they were submitted, and submitted again, with or without changes.

use axum::extract::{Path, State};
use axum::http::{HeaderMap, Uri, header};
use axum::response::{IntoResponse, Response};
use proto::JobId;

use crate::http::auth::Caller;
use crate::http::body::{self, RequestBody};
use crate::http::content_encoding::ContentEncoding;
use crate::http::error::ApiError;
use crate::http::jobs::job_id;
use crate::http::jobs::merge_patch;
use crate::http::jobs::submission::{Intake, Submission};
use crate::queue::Queue;

/// Maximum size of changes; a larger change should be a new job file.
const MAX_CHANGES_BYTES: usize = 1 << 20;

/// Get a job's file.
///
/// Returns the submitted bytes, or the result of a resubmission's changes to them.
#[utoipa::path(
    get, path = "", tag = "jobs", operation_id = "get_job_file",
    params(("id" = String, Path, description = "The job")),
    responses((status = 200, description = "The job file", body = ref("#/components/schemas/Job")))
)]
pub(in crate::http) async fn file(State(queue): State<Queue>, Path(id): Path<String>) -> Result<Response, ApiError> {
    let text = text_of(&queue, job_id(&id)?).await?;
    Ok(([(header::CONTENT_TYPE, "application/json")], text).into_response())
}

/// Submit a job's file again.
///
/// Without a body, the same file is submitted, and pictures that are already stored are not rendered again,
/// unless the request has `Cache-Control: no-cache`. A body changes the file first: a JSON merge patch (RFC
/// 7396). The new job belongs to the caller. Headers, query and responses are as in `POST /v1/jobs`.
#[utoipa::path(
    post, path = "", tag = "jobs", operation_id = "resubmit_job",
    params(
        ("id" = String, Path, description = "The job whose file is submitted"),
        ("dry_run" = Option<bool>, Query, description = "Only validate the job and estimate its cost: 200 if it is valid"),
        ("set" = Option<Vec<String>>, Query, description = "Sets a value of the job, as in `numbers.r=0.3`; may be repeated"),
        ("keep" = Option<String>, Query, description = "Retention after the job finishes: 36h, 7d, forever; by default the server's setting"),
        ("tile_seconds" = Option<u32>, Query, description = "Time limit for rendering one tile, in seconds: above it the tile has failed; at most, and by default, the server's `--max-tile-seconds`", minimum = 1),
        ("record" = Option<bool>, Query, description = "Keep its tiles, so that another job can be based on it"),
        ("based_on" = Option<String>, Query, description = "A recorded job: only tiles that can differ from it are rendered"),
        ("webhook" = Option<Vec<String>>, Query, description = "Address to notify when the job has finished; up to four"),
        ("webhook_event" = Option<Vec<String>>, Query, description = "Events to send instead: job.running, job.succeeded, job.failed, job.cancelled, frame.stored"),
        ("Content-Encoding" = Option<String>, Header, description = "`gzip` or `zstd` if the body is compressed; unpacked it has at most 1 MiB"),
        ("Idempotency-Key" = Option<String>, Header, description = "Makes the request idempotent: repeating it with the same key returns the job created first"),
        ("Prefer" = Option<String>, Header, description = "`wait=N`: respond when the job has finished, or after N seconds, at most 60"),
    ),
    request_body(content = ref("#/components/schemas/JobChanges"), content_type = "application/json"),
    responses(
        (status = 201, description = "Accepted: the new job", body = ref("#/components/schemas/JobView"),
         headers(("Location" = String, description = "The new job"))),
        (status = 200, description = "The job is valid (dry run), or the job that was accepted before with the same Idempotency-Key", body = ref("#/components/schemas/SubmitAnswer")),
    )
)]
pub(in crate::http) async fn resubmit(
    State(intake): State<Intake>,
    caller: Caller,
    Path(id): Path<String>,
    uri: Uri,
    headers: HeaderMap,
    request: RequestBody,
) -> Result<Response, ApiError> {
    let text = text_of(&intake.gate.queue, job_id(&id)?).await?;
    body::expect_json(&headers)?;
    let encoding = ContentEncoding::of(&headers)?;
    let holder = request.holder().clone();
    let submission = Submission::begin(&intake.gate, caller, uri, headers, &holder).await?;
    let (changes, mut room) = body::read_encoded(request, encoding, MAX_CHANGES_BYTES).await?.into_parts();
    room.grow(text.len())?;
    let text = if changes.trim_ascii().is_empty() {
        text
    } else {
        let merge = move || merge_patch::apply(&scene::plain_json(&text), &changes);
        intake.jobs.run(&holder.name, merge).await??
    };
    if text.len() > scene::limits::MAX_BODY_BYTES {
        return Err(ApiError::TooLarge { limit_bytes: scene::limits::MAX_BODY_BYTES as u64 });
    }
    submission.finish(&intake, text.into(), room).await
}

async fn text_of(queue: &Queue, job: JobId) -> Result<String, ApiError> {
    queue.file(job).await?.ok_or_else(|| ApiError::UnknownJob(job.to_string()))
}
