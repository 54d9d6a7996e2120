//! Jobs: submission, reading, cancelling.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use proto::fail_point::{self, FailPoint};
use proto::job::{DryRun, JobPage, JobState, JobView};
use proto::{JobId, Retention};
use serde::Deserialize;
use tracing::Instrument;

use super::auth::Caller;
use super::body::{self, RequestBody, Room};
use super::content_encoding::ContentEncoding;
use super::error::ApiError;
use super::{prefer, quota, submit_options, trace_context};
use crate::admission::Holder;
use crate::audit_log;
use crate::estimate;
use crate::farm::Farm;
use crate::job_cache::Reader;
use crate::queue::{CancelOutcome, NewJob, SubmitOutcome};
use crate::tile_plan::TilePlan;

/// Default number of jobs on a page.
const DEFAULT_PAGE_SIZE: u32 = 100;
/// Maximum number of jobs on a page.
const MAX_PAGE: u32 = 1000;

#[derive(Debug, Deserialize)]
struct SubmitQuery {
    #[serde(default)]
    dry_run: bool,
    keep: Option<String>,
    tile_seconds: Option<u32>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ListQuery {
    state: Option<JobState>,
    r#match: Option<String>,
    limit: Option<u32>,
    cursor: Option<String>,
}

/// Reads a job's id from a path.
pub(super) fn job_id(text: &str) -> Result<JobId, ApiError> {
    text.parse().map_err(|_| ApiError::UnknownJob(text.to_owned()))
}

/// The media type of a job's pictures.
fn media_type(image: &scene::Image) -> &'static str {
    match image.format {
        scene::Format::Png => "image/png",
        scene::Format::Exr => "image/x-exr",
    }
}

/// Whether the request bypasses the picture cache.
pub(super) fn has_no_cache(headers: &HeaderMap) -> bool {
    headers
        .get_all(header::CACHE_CONTROL)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .any(|value| value.split(',').any(|directive| directive.trim().eq_ignore_ascii_case("no-cache")))
}

/// Submit a job.
///
/// Responds with 201 once the job is on disk. Pictures that are already stored are not rendered again, unless
/// the request has `Cache-Control: no-cache`.
#[utoipa::path(
    post, path = "/v1/jobs", tag = "jobs", operation_id = "submit_job",
    params(
        ("dry_run" = Option<bool>, Query, description = "Only validate the job and estimate its cost: 200 if it is valid"),
        ("set" = Option<Vec<String>>, Query, description = "Sets a value of the job, as in `numbers.r=0.3`; may be repeated"),
        ("keep" = Option<String>, Query, description = "Retention after the job finishes: 36h, 7d, forever; by default the server's setting"),
        ("tile_seconds" = Option<u32>, Query, description = "Time limit for rendering one tile, in seconds: above it the tile has failed; at most, and by default, the server's `--max-tile-seconds`", minimum = 1),
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
        (status = 400, description = "Not JSON, or damaged in its content encoding", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 403, description = "The priority is above the highest of the key", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 413, description = "Too large, as sent or when it is unpacked", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 415, description = "The content type is not JSON, or the content encoding is not gzip or zstd", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 422, description = "The job is invalid: `errors` lists all errors", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 429, description = "The queue is full, the submitter's quota is used up, or there are too many requests: see Retry-After", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 507, description = "Disk full", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
    )
)]
pub(super) async fn submit(
    State(farm): State<Arc<Farm>>,
    caller: Caller,
    uri: Uri,
    headers: HeaderMap,
    request: RequestBody,
) -> Result<Response, ApiError> {
    let submission = Submission::begin(&farm, caller, uri, headers, request.holder()).await?;
    body::expect_json(&submission.headers)?;
    let encoding = ContentEncoding::of(&submission.headers)?;
    let (text, room) = body::read_encoded(request, encoding, scene::limits::MAX_BODY_BYTES).await?.into_parts();
    submission.finish(&farm, text, room).await
}

/// Submission request, validated as far as possible before its body is read.
pub(super) struct Submission {
    caller: Caller,
    uri: Uri,
    headers: HeaderMap,
    submitter: String,
    query: SubmitQuery,
    keep: Option<Retention>,
    /// Time limit for rendering a tile.
    tile_seconds: u32,
}

impl Submission {
    /// Rejects requests that no body could make valid: the server is shutting down, a quota is used up, the
    /// query is invalid.
    pub(super) async fn begin(
        farm: &Farm,
        caller: Caller,
        uri: Uri,
        headers: HeaderMap,
        holder: &Holder,
    ) -> Result<Self, ApiError> {
        let query: SubmitQuery = body::read_query(&uri)?;
        if farm.is_shutting_down.is_cancelled() && !query.dry_run {
            return Err(ApiError::ShuttingDown);
        }
        if farm.reserve.is_released() && !query.dry_run {
            return Err(ApiError::DiskFull);
        }
        let is_known = submit_options::is_replay(farm, &caller, &headers).await?;
        if !query.dry_run && !is_known {
            quota::check_jobs(farm, &caller).await?;
        }
        let max = farm.config.max_tile_seconds;
        let tile_seconds = query.tile_seconds.unwrap_or(max);
        if !(1..=max).contains(&tile_seconds) {
            return Err(ApiError::WrongQuery(format!(
                "tile_seconds is {tile_seconds}, but must be from 1 to {max}, the limit of this server's operator \
                 (sdfarm serve --max-tile-seconds)"
            )));
        }
        let keep: Option<Retention> = match query.keep.as_deref().map(str::parse).transpose() {
            Ok(keep) => keep,
            Err(error) => return Err(ApiError::WrongQuery(format!("keep: {error}"))),
        };
        Ok(Self { caller, uri, headers, submitter: holder.name.clone(), query, keep, tile_seconds })
    }

    /// Accepts or validates a job with this text; `room` is the text's, until the job is accepted.
    pub(super) async fn finish(self, farm: &Arc<Farm>, text: bytes::Bytes, room: Room) -> Result<Response, ApiError> {
        let Self { caller, uri, headers, submitter, query, keep, tile_seconds } = self;
        let reader = Reader::Submitter(&submitter);
        let values = submit_options::values(&uri)?;
        let text = if values.is_empty() {
            text
        } else {
            farm.jobs.run(reader, move || submit_options::with_values(&values, text)).await??
        };
        let limits = quota::limits(farm, &caller);
        let wish = submit_options::read(&uri, &headers, &text, &farm.webhooks.guard, limits)?;
        let (dry_run, edge_px) = (query.dry_run, farm.config.tile_edge_px);
        let read = move |job: scene::Job| {
            let (plan, priority, warnings) = (TilePlan::new(&job, edge_px), job.priority, job.warnings());
            // A large job takes hundreds of megabytes: a dry run drops it here, before another one is parsed.
            // Cutting it into leaves takes as long as parsing it.
            (plan, priority, warnings, (!dry_run).then(|| (job.compiled_nodes(), job)))
        };
        let parsed = farm.jobs.parse(reader, text.clone(), move |parsed| parsed.map(read)).await?;
        let (plan, priority, warnings, job) = parsed?;
        quota::check_priority(&caller, priority)?;
        let Some((nodes, job)) = job else {
            let (tiles, rays) = (plan.tiles_total(), plan.rays_total());
            let estimate = estimate::estimate(farm, &submitter, into_utf8(text)?, plan).await;
            let frames = plan.frames.into();
            return Ok(Json(DryRun { valid: true, tiles, frames, rays, estimate, warnings }).into_response());
        };
        let id = JobId::new();
        audit_log::describe(|record| record.job = Some(id));
        let new = NewJob {
            id,
            name: job.name.clone(),
            submitter: caller.name().to_owned(),
            priority: job.priority,
            nodes,
            plan,
            media_type: media_type(&job.image),
            warnings,
            no_cache: has_no_cache(&headers),
            retention: keep,
            tile_seconds,
            file_text: into_utf8(text)?,
        };
        trace_context::store_trace(farm, id, &headers).await?;
        let submitting = farm.submit(new, Arc::new(job), wish, reader);
        let (status, id) = match submitting.instrument(tracing::info_span!("submit", job = %id)).await? {
            SubmitOutcome::Created(_) => (StatusCode::CREATED, id),
            SubmitOutcome::Replayed(id) => (StatusCode::OK, id),
            SubmitOutcome::KeyReused => return Err(ApiError::IdempotencyKeyReused),
            SubmitOutcome::Rejected(limit) => return Err(quota::exceeded(&caller, limit)),
        };
        fail_point::trigger_infallible(FailPoint::SubmitCommitted);
        // The response may wait for the job's end.
        drop(room);
        let mut response = prefer::answer(farm, id, &headers, status).await?;
        if let Ok(location) = HeaderValue::from_str(&format!("/v1/jobs/{id}")) {
            response.headers_mut().insert(header::LOCATION, location);
        }
        Ok(response)
    }
}

/// Body of a submission.
fn into_utf8(text: bytes::Bytes) -> Result<String, ApiError> {
    String::from_utf8(text.into()).map_err(|error| ApiError::Internal(Box::new(error)))
}

/// List jobs, newest first.
///
/// With `match`, lists only jobs with that name or that part of an id. A key with scope submit but not read lists only
/// jobs of its own name.
#[utoipa::path(
    get, path = "/v1/jobs", tag = "jobs", operation_id = "list_jobs",
    params(
        ("state" = Option<String>, Query, description = "Only jobs in this state: queued, running, succeeded, failed, cancelled"),
        ("match" = Option<String>, Query, description = "Only jobs with this id, with an id that starts or ends with this text (4 characters or more), or with this name; `latest` is the newest job. Can be combined with `limit` only"),
        ("limit" = Option<u32>, Query, description = "Jobs on the page", minimum = 1, maximum = 1000),
        ("cursor" = Option<String>, Query, description = "`next_cursor` of the page before"),
    ),
    responses(
        (status = 200, description = "A page", body = ref("#/components/schemas/JobPage")),
        (status = 422, description = "Invalid query parameters", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
    )
)]
pub(super) async fn list(State(farm): State<Arc<Farm>>, caller: Caller, uri: Uri) -> Result<Json<JobPage>, ApiError> {
    let query: ListQuery = body::read_query(&uri)?;
    let limit = query.limit.unwrap_or(DEFAULT_PAGE_SIZE);
    if !(1..=MAX_PAGE).contains(&limit) {
        return Err(ApiError::WrongQuery(format!("limit is {limit}, but must be from 1 to {MAX_PAGE}")));
    }
    if let Some(text) = query.r#match {
        if query.state.is_some() || query.cursor.is_some() {
            return Err(ApiError::WrongQuery("match can be combined with limit only: remove state and cursor".into()));
        }
        return Ok(Json(farm.queue.jobs_like(caller.visible_submitter(), &text, limit).await?));
    }
    let before = match query.cursor {
        None => None,
        Some(cursor) => Some(cursor.parse().map_err(|_| {
            ApiError::WrongQuery(format!("{cursor:?} is not a cursor: pass the next_cursor of the page before"))
        })?),
    };
    Ok(Json(farm.queue.jobs(caller.visible_submitter(), query.state, limit, before).await?))
}

/// Get a job.
#[utoipa::path(
    get, path = "/v1/jobs/{id}", tag = "jobs", operation_id = "get_job",
    params(
        ("id" = String, Path, description = "The job"),
        ("Prefer" = Option<String>, Header, description = "`wait=N`: respond when the job has finished, or after N seconds, at most 60"),
    ),
    responses(
        (status = 200, description = "The job", body = ref("#/components/schemas/JobView")),
        (status = 404, description = "No such job", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
    )
)]
pub(super) async fn get(
    State(farm): State<Arc<Farm>>,
    Path(id): Path<String>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    prefer::answer(&farm, job_id(&id)?, &headers, StatusCode::OK).await
}

/// Current view of a job.
pub(super) async fn view(farm: &Farm, id: JobId) -> Result<Json<JobView>, ApiError> {
    farm.queue.job(id).await?.map(Json).ok_or_else(|| ApiError::UnknownJob(id.to_string()))
}

/// Cancel a job.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/cancel", tag = "jobs", operation_id = "cancel_job",
    params(("id" = String, Path, description = "The job")),
    responses(
        (status = 200, description = "The job is cancelled", body = ref("#/components/schemas/JobView")),
        (status = 404, description = "No such job", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 409, description = "The job has finished", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
    )
)]
pub(super) async fn cancel(State(farm): State<Arc<Farm>>, Path(id): Path<String>) -> Result<Json<JobView>, ApiError> {
    let job = job_id(&id)?;
    let cancelled = match farm.queue.cancel(job).await {
        Err(error) if farm.has_made_room(&error) => farm.queue.cancel(job).await,
        done => done,
    };
    match cancelled? {
        CancelOutcome::Done(removed) => farm.sweep_removed(removed),
        CancelOutcome::AlreadyFinished(state) => return Err(ApiError::Finished { job, state }),
        CancelOutcome::Unknown => return Err(ApiError::UnknownJob(id)),
    }
    view(&farm, job).await
}
