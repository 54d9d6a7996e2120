//! Trace context of jobs: from a submission through the job's leases to the workers.
//!
//! No decision depends on a trace; without traces, the farm works the same.

use axum::http::HeaderMap;
use proto::worker_protocol::{Batch, BatchWork};
use proto::{JobId, WorkerId, trace_context};
use tracing::Span;

use crate::db::DatabaseError;
use crate::queue::Queue;
use crate::telemetry::Telemetry;

/// Makes a request's span a child of the trace in the request's header, if there is one.
pub(in crate::http) fn set_parent(span: &Span, headers: &HeaderMap) {
    if let Some(traceparent) = client_traceparent(headers) {
        trace_context::set_parent(span, traceparent);
    }
}

/// Stores the current trace context with a job about to be accepted; or the context of its request, for
/// workers that export traces if this server does not.
pub(in crate::http) async fn store_trace(queue: &Queue, job: JobId, headers: &HeaderMap) -> Result<(), DatabaseError> {
    let named = || {
        client_traceparent(headers).filter(|traceparent| trace_context::is_valid(traceparent)).map(ToOwned::to_owned)
    };
    match trace_context::current_traceparent().or_else(named) {
        Some(traceparent) => queue.keep_trace(job, traceparent).await,
        None => Ok(()),
    }
}

/// Trace context of a worker's batch: its own span, a child of the submission's.
pub(in crate::http) async fn batch_traceparent(telemetry: &Telemetry, worker: WorkerId, run: &Batch) -> Option<String> {
    let kept = match telemetry.trace_of(run.job).await {
        Ok(kept) => kept?,
        Err(error) => {
            tracing::warn!(%error, job = %run.job, "could not read a job's trace context");
            return None;
        }
    };
    let tiles = match &run.work {
        BatchWork::Render { tiles, .. } => tiles.len(),
        BatchWork::Stitch { inputs: parts, .. } => parts.len(),
    };
    let span = tracing::info_span!("lease", job = %run.job, frame = run.frame, %worker, tiles);
    trace_context::set_parent(&span, &kept);
    Some(trace_context::traceparent_of(&span).unwrap_or(kept))
}

fn client_traceparent(headers: &HeaderMap) -> Option<&str> {
    headers.get(trace_context::TRACEPARENT)?.to_str().ok()
}
