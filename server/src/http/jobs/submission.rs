//! Submissions: what is checked before the body is read, and how a job is accepted or only estimated.
//!
//! Whether a job is accepted is up to the queue.

use std::sync::Arc;

use axum::Json;
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use proto::fail_point::{self, FailPoint};
use proto::job::DryRun;
use proto::{JobId, Retention};
use serde::Deserialize;
use tracing::Instrument;

use crate::admission::Holder;
use crate::audit_log;
use crate::config::Config;
use crate::estimate::Estimator;
use crate::http::auth::Caller;
use crate::http::body::{self, Room};
use crate::http::error::ApiError;
use crate::http::jobs;
use crate::http::jobs::prefer::JobWaiter;
use crate::http::jobs::{quota, submit_options};
use crate::http::state::handle_group;
use crate::http::workers::trace_context;
use crate::job_reader::{JobFacts, JobReader};
use crate::queue::{NewJob, Queue, SubmitOutcome};
use crate::shutdown::Shutdown;
use crate::space_reserve::SpaceReserve;
use crate::submissions::Submissions;
use crate::webhooks::AddressPolicy;

handle_group! {
    /// Handles that decide whether a body is worth reading.
    SubmissionGate {
        /// Has the quotas.
        config: Arc<Config>,
        /// Has what they are used for.
        queue: Queue,
        /// Says whether there is room.
        reserve: Arc<SpaceReserve>,
        /// Ends acceptance.
        shutdown: Shutdown,
    }
}

handle_group! {
    /// Handles of submissions.
    Intake {
        /// Handles that decide whether a body is worth reading.
        gate: SubmissionGate,
        /// Parses job files.
        jobs: Arc<JobReader>,
        /// Addresses that webhooks may have.
        webhook_addresses: Arc<AddressPolicy>,
        /// Estimates jobs that are only validated.
        estimator: Arc<Estimator>,
        /// Accepts the others.
        submissions: Submissions,
        /// Waits for their end, if the client prefers that.
        waiter: JobWaiter,
    }
}

#[derive(Debug, Deserialize)]
struct SubmitQuery {
    #[serde(default)]
    dry_run: bool,
    keep: Option<String>,
    tile_seconds: Option<u32>,
    #[serde(default)]
    record: bool,
    based_on: Option<String>,
}

/// Submission request, validated as far as possible before its body is read.
pub(in crate::http) struct Submission {
    caller: Caller,
    uri: Uri,
    headers: HeaderMap,
    submitter: String,
    query: SubmitQuery,
    keep: Option<Retention>,
    /// Time limit for rendering a tile.
    tile_seconds: u32,
    /// The recorded job that it is based on.
    based_on: Option<JobId>,
}

impl Submission {
    /// Rejects requests that no body could make valid: the server is shutting down, a quota is used up, the
    /// query is invalid.
    pub(in crate::http) async fn begin(
        gate: &SubmissionGate,
        caller: Caller,
        uri: Uri,
        headers: HeaderMap,
        holder: &Holder,
    ) -> Result<Self, ApiError> {
        let query: SubmitQuery = body::read_query(&uri)?;
        if gate.shutdown.begun().is_cancelled() && !query.dry_run {
            return Err(ApiError::ShuttingDown);
        }
        if gate.reserve.is_released() && !query.dry_run {
            return Err(ApiError::DiskFull);
        }
        let is_known = submit_options::is_replay(&gate.queue, &caller, &headers).await?;
        if !query.dry_run && !is_known {
            quota::check_jobs(&gate.queue, &gate.config, &caller).await?;
        }
        let max = gate.config.max_tile_seconds;
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
        let based_on = match &query.based_on {
            Some(id) => Some(recorded_job(&gate.queue, &caller, id).await?),
            None => None,
        };
        Ok(Self { caller, uri, headers, submitter: holder.name.clone(), query, keep, tile_seconds, based_on })
    }

    /// Headers of the request.
    pub(in crate::http) fn headers(&self) -> &HeaderMap {
        &self.headers
    }

    /// Accepts or validates a job with this text; `room` is the text's, until the job is accepted.
    pub(in crate::http) async fn finish(
        self,
        intake: &Intake,
        text: bytes::Bytes,
        room: Room,
    ) -> Result<Response, ApiError> {
        let Self { caller, uri, headers, submitter, query, keep, tile_seconds, based_on } = self;
        let values = submit_options::values(&uri)?;
        let text = if values.is_empty() {
            text
        } else {
            let changed = intake.jobs.set(&submitter, text, values).await?;
            changed.map_err(ApiError::WrongQuery)?.into()
        };
        let limits = quota::limits(&intake.gate.config, &caller);
        let options = submit_options::read(&uri, &headers, &text, &intake.webhook_addresses, limits)?;
        let (dry_run, edge_px) = (query.dry_run, intake.gate.config.tile_edge_px);
        let JobFacts { name, priority, plan, warnings, is_png, nodes, frames } =
            intake.jobs.job(&submitter, text.clone(), !dry_run, edge_px).await?;
        let recorded = query.record || based_on.is_some();
        let plan = if recorded { plan.recorded() } else { plan };
        quota::check_priority(&caller, priority)?;
        if dry_run {
            let (tiles, rays) = (plan.tiles_total(), plan.rays_total());
            let estimate = intake.estimator.estimate(&submitter, into_utf8(text)?, plan).await;
            let frames = plan.frames.into();
            return Ok(Json(DryRun { valid: true, tiles, frames, rays, estimate, warnings }).into_response());
        }
        let id = JobId::new();
        audit_log::describe(|record| record.job = Some(id));
        let new = NewJob {
            id,
            name,
            submitter: caller.name().to_owned(),
            priority,
            nodes,
            plan,
            media_type: if is_png { "image/png" } else { "image/x-exr" },
            warnings,
            no_cache: submit_options::has_no_cache(&headers),
            retention: keep,
            tile_seconds,
            recorded,
            based_on,
            file_text: into_utf8(text)?,
        };
        trace_context::store_trace(&intake.gate.queue, id, &headers).await?;
        let submitting = intake.submissions.accept(new, frames, options);
        let (status, id) = match submitting.instrument(tracing::info_span!("submit", job = %id)).await? {
            SubmitOutcome::Created(_) => (StatusCode::CREATED, id),
            SubmitOutcome::Replayed(id) => (StatusCode::OK, id),
            SubmitOutcome::KeyReused => return Err(ApiError::IdempotencyKeyReused),
            SubmitOutcome::Rejected(limit) => return Err(quota::exceeded(&caller, limit)),
        };
        fail_point::trigger_infallible(FailPoint::SubmitCommitted);
        // The response may wait for the job's end.
        drop(room);
        let mut response = intake.waiter.answer(id, &headers, status).await?;
        if let Ok(location) = HeaderValue::from_str(&format!("/v1/jobs/{id}")) {
            response.headers_mut().insert(header::LOCATION, location);
        }
        Ok(response)
    }
}

/// A job that another may be based on.
async fn recorded_job(queue: &Queue, caller: &Caller, id: &str) -> Result<JobId, ApiError> {
    if id.is_empty() {
        let fix = "based_on is empty: write the id of a recorded job, or leave based_on out";
        return Err(ApiError::WrongQuery(fix.to_owned()));
    }
    let id = jobs::job_id(id)?;
    if jobs::visible(queue, caller, id).await?.recorded {
        return Ok(id);
    }
    Err(ApiError::WrongQuery(format!(
        "based_on: the job {id} is not recorded, so that it isn't known which of its tiles can change: submit it again \
         with record=true, or leave based_on out"
    )))
}

/// Body of a submission.
fn into_utf8(text: bytes::Bytes) -> Result<String, ApiError> {
    String::from_utf8(text.into()).map_err(|error| ApiError::Internal(Box::new(error)))
}
