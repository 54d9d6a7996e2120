//! Jobs: submission, reading, cancelling.

pub(super) mod changes;
pub(super) mod files;
pub(super) mod job_body;
pub(super) mod merge_patch;
pub(super) mod prefer;
pub(super) mod quota;
pub(super) mod submission;
pub(super) mod submit_options;
pub(super) mod tiles;
pub(super) mod webhooks;

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, Uri};
use axum::response::Response;
use proto::JobId;
use proto::job::{JobPage, JobState, JobView};
use serde::Deserialize;

use crate::blobs::ContentHash;
use crate::http::auth::Caller;
use crate::http::body::{self, RequestBody};
use crate::http::content_encoding::ContentEncoding;
use crate::http::error::ApiError;
use crate::http::jobs::prefer::JobWaiter;
use crate::http::jobs::submission::{Intake, Submission};
use crate::orphans::Orphans;
use crate::queue::{CancelOutcome, PictureMark, Queue};
use crate::space_reserve::SpaceReserve;

/// Default number of jobs on a page.
const DEFAULT_PAGE_SIZE: u32 = 100;
/// Maximum number of jobs on a page.
const MAX_PAGE: u32 = 1000;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ListQuery {
    state: Option<JobState>,
    r#match: Option<String>,
    picture: Option<String>,
    scene: Option<String>,
    limit: Option<u32>,
    cursor: Option<String>,
}

/// Reads a job's id from a path.
pub(super) fn job_id(text: &str) -> Result<JobId, ApiError> {
    text.parse().map_err(|_| ApiError::UnknownJob(text.to_owned()))
}

/// Submit a job.
///
/// Responds with 201 once the job is on disk. Pictures that are already stored are not rendered again, unless
/// the request has `Cache-Control: no-cache`.
#[utoipa::path(
    post, path = "", tag = "jobs", operation_id = "submit_job",
    params(
        ("dry_run" = Option<bool>, Query, description = "Only validate the job and estimate its cost: 200 if it is valid"),
        ("set" = Option<Vec<String>>, Query, description = "Sets a value of the job, as in `numbers.r=0.3`; may be repeated"),
        ("keep" = Option<String>, Query, description = "Retention after the job finishes: 36h, 7d, forever; by default the server's setting"),
        ("tile_seconds" = Option<u32>, Query, description = "Time limit for rendering one tile, in seconds: above it the tile has failed; at most, and by default, the server's `--max-tile-seconds`", minimum = 1),
        ("record" = Option<bool>, Query, description = "Keep its tiles, so that another job can be based on it"),
        ("based_on" = Option<String>, Query, description = "A recorded job: only tiles that can differ from it are rendered"),
        ("webhook" = Option<Vec<String>>, Query, description = "Address to notify when the job has finished; up to four"),
        ("webhook_event" = Option<Vec<String>>, Query, description = "Events to send instead: job.running, job.succeeded, job.failed, job.cancelled, frame.stored"),
        ("Content-Encoding" = Option<String>, Header, description = "`gzip` or `zstd` if the body is compressed; unpacked it has at most 32 MiB"),
        ("Idempotency-Key" = Option<String>, Header, description = "Makes the request idempotent: repeating it with the same key returns the job created first"),
        ("Prefer" = Option<String>, Header, description = "`wait=N`: respond when the job has finished, or after N seconds, at most 60"),
    ),
    request_body(content = ref("#/components/schemas/Job"), content_type = "application/json"),
    responses(
        (status = 201, description = "Accepted", body = ref("#/components/schemas/JobView"),
         headers(("Location" = String, description = "The job"))),
        (status = 200, description = "The job is valid (dry run), or the job that was accepted before with the same Idempotency-Key", body = ref("#/components/schemas/SubmitAnswer")),
    )
)]
pub(super) async fn submit(
    State(intake): State<Intake>,
    caller: Caller,
    uri: Uri,
    headers: HeaderMap,
    request: RequestBody,
) -> Result<Response, ApiError> {
    let submission = Submission::begin(&intake.gate, caller, uri, headers, request.holder()).await?;
    body::expect_json(submission.headers())?;
    let encoding = ContentEncoding::of(submission.headers())?;
    let (text, room) = body::read_encoded(request, encoding, scene::limits::MAX_BODY_BYTES).await?.into_parts();
    submission.finish(&intake, text, room).await
}

/// A job that the caller may see; another one is unknown to it.
pub(super) async fn visible(queue: &Queue, caller: &Caller, id: JobId) -> Result<JobView, ApiError> {
    let job = queue.job(id).await?;
    job.filter(|job| caller.visible_submitter().is_none_or(|submitter| submitter == job.submitter))
        .ok_or_else(|| ApiError::UnknownJob(id.to_string()))
}

/// List jobs, newest first.
///
/// With `match`, lists only jobs with that name or that part of an id; with `picture` or `scene`, those that have this
/// picture, or one of this scene, as the provenance in a picture's file names it. A key with scope submit but not read lists only
/// jobs of its own name.
#[utoipa::path(
    get, path = "", tag = "jobs", operation_id = "list_jobs",
    params(
        ("state" = Option<String>, Query, description = "Only jobs in this state: queued, running, succeeded, failed, cancelled"),
        ("match" = Option<String>, Query, description = "Only jobs with this id, with an id that starts or ends with this text (4 characters or more), or with this name; `latest` is the newest job. Can be combined with `limit` only"),
        ("picture" = Option<String>, Query, description = "Only jobs with a picture whose bytes have this BLAKE3, in hex. Can be combined with `limit` only"),
        ("scene" = Option<String>, Query, description = "Only jobs with a picture of the scene with this BLAKE3, in hex. Can be combined with `limit` only"),
        ("limit" = Option<u32>, Query, description = "Jobs on the page", minimum = 1, maximum = 1000),
        ("cursor" = Option<String>, Query, description = "`next_cursor` of the page before"),
    ),
    responses((status = 200, description = "A page", body = ref("#/components/schemas/JobPage")))
)]
pub(super) async fn list(State(queue): State<Queue>, caller: Caller, uri: Uri) -> Result<Json<JobPage>, ApiError> {
    let query: ListQuery = body::read_query(&uri)?;
    let limit = body::page_length(query.limit, DEFAULT_PAGE_SIZE, MAX_PAGE)?;
    let mark = match (&query.picture, &query.scene) {
        (None, None) => None,
        (Some(hash), None) => Some((hash, PictureMark::Bytes(hash))),
        (None, Some(hash)) => Some((hash, PictureMark::Scene(hash))),
        (Some(_), Some(_)) => {
            return Err(ApiError::WrongQuery("picture cannot be combined with scene: remove one".into()));
        }
    };
    if let Some((hash, mark)) = mark {
        if query.state.is_some() || query.cursor.is_some() || query.r#match.is_some() {
            return Err(ApiError::WrongQuery(
                "picture and scene can be combined with limit only: remove state, cursor and match".into(),
            ));
        }
        if ContentHash::parse(hash).is_none() {
            return Err(ApiError::WrongHash(hash.clone()));
        }
        return Ok(Json(queue.jobs_of_picture(caller.visible_submitter(), mark, limit).await?));
    }
    if let Some(text) = query.r#match {
        if query.state.is_some() || query.cursor.is_some() {
            return Err(ApiError::WrongQuery("match can be combined with limit only: remove state and cursor".into()));
        }
        return Ok(Json(queue.jobs_like(caller.visible_submitter(), &text, limit).await?));
    }
    let before = match query.cursor {
        None => None,
        Some(cursor) => Some(cursor.parse().map_err(|_| body::wrong_cursor(&cursor))?),
    };
    Ok(Json(queue.jobs(caller.visible_submitter(), query.state, limit, before).await?))
}

/// Get a job.
#[utoipa::path(
    get, path = "", tag = "jobs", operation_id = "get_job",
    params(
        ("id" = String, Path, description = "The job"),
        ("Prefer" = Option<String>, Header, description = "`wait=N`: respond when the job has finished, or after N seconds, at most 60"),
    ),
    responses((status = 200, description = "The job", body = ref("#/components/schemas/JobView")))
)]
pub(super) async fn get(
    State(waiter): State<JobWaiter>,
    Path(id): Path<String>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    waiter.answer(job_id(&id)?, &headers, StatusCode::OK).await
}

/// Current view of a job.
pub(super) async fn view(queue: &Queue, id: JobId) -> Result<Json<JobView>, ApiError> {
    queue.job(id).await?.map(Json).ok_or_else(|| ApiError::UnknownJob(id.to_string()))
}

/// Cancel a job.
#[utoipa::path(
    post, path = "", tag = "jobs", operation_id = "cancel_job",
    params(("id" = String, Path, description = "The job")),
    responses((status = 200, description = "The job is cancelled", body = ref("#/components/schemas/JobView")))
)]
pub(super) async fn cancel(
    State(queue): State<Queue>,
    State(reserve): State<Arc<SpaceReserve>>,
    State(orphans): State<Orphans>,
    Path(id): Path<String>,
) -> Result<Json<JobView>, ApiError> {
    let job = job_id(&id)?;
    let cancelled = match queue.cancel(job).await {
        Err(error) if reserve.has_made_room(&error) => queue.cancel(job).await,
        done => done,
    };
    match cancelled? {
        CancelOutcome::Done(removed) => orphans.sweep_removed(removed),
        CancelOutcome::AlreadyFinished(state) => return Err(ApiError::Finished { job, state }),
        CancelOutcome::Unknown => return Err(ApiError::UnknownJob(id)),
    }
    view(&queue, job).await
}
