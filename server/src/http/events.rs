//! Sends events of a job, or of all jobs, as a stream for a browser's `EventSource`, curl and `sdfarm watch`.

use std::convert::Infallible;
use std::sync::Arc;

use axum::BoxError;
use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures_util::{Stream, stream};
use serde::Deserialize;

use crate::events::{EventHub, EventSubscriber, SubscribeOutcome};
use crate::farm_events::{FarmEvents, FarmSubscriber};
use crate::http::auth::Caller;
use crate::http::body;
use crate::http::error::ApiError;
use crate::http::jobs::job_id;
use crate::shutdown::Shutdown;

/// Header that browsers send when they reconnect.
const LAST_EVENT_ID: &str = "last-event-id";

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct EventsQuery {
    last_event_id: Option<String>,
}

/// Follow a job.
///
/// Events `state`, `progress`, `tile` and `frame`, each with an increasing id. With `Last-Event-ID`, the
/// stream resumes after that event, without gaps or repeats. If later events have been pruned, it starts with
/// a `snapshot`. The stream ends after the job's final event.
#[utoipa::path(
    get, path = "", tag = "jobs", operation_id = "follow_job",
    params(
        ("id" = String, Path, description = "The job"),
        ("last_event_id" = Option<String>, Query, description = "Like the header, for clients that cannot send headers"),
        ("Last-Event-ID" = Option<String>, Header, description = "Id of the last event that was received"),
    ),
    responses(
        (status = 200, description = "Events, as they happen", body = serde_json::Value, content_type = "text/event-stream"),
        (status = 204, description = "The job has finished, and no events follow that one"),
    )
)]
pub(in crate::http) async fn follow(
    State(events): State<Arc<EventHub>>,
    State(shutdown): State<Shutdown>,
    Path(id): Path<String>,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let job = job_id(&id)?;
    let query: EventsQuery = body::read_query(&uri)?;
    let header = headers.get(LAST_EVENT_ID).map(|value| value.to_str().unwrap_or("?").to_owned());
    let after =
        header.or(query.last_event_id).filter(|text| !text.is_empty()).map(|text| event_id(&text)).transpose()?;
    match EventSubscriber::start(&events, job, after, shutdown.closing().clone()).await? {
        SubscribeOutcome::Subscribed(follower) => Ok(streamed(*follower)),
        SubscribeOutcome::Ended => Ok(StatusCode::NO_CONTENT.into_response()),
        SubscribeOutcome::UnknownJob => Err(ApiError::UnknownJob(id)),
    }
}

fn event_id(text: &str) -> Result<i64, ApiError> {
    text.trim().parse().ok().filter(|number| *number >= 0).ok_or_else(|| {
        ApiError::WrongQuery(format!("{text:?} is not an event id: send the last id that was received, or none"))
    })
}

fn streamed(follower: EventSubscriber) -> Response {
    response(stream::unfold(Some(follower), async |follower| {
        let mut follower = follower?;
        match follower.next().await {
            Ok(Some(bytes)) => Some((Ok(bytes), Some(follower))),
            Ok(None) => None,
            Err(error) => {
                tracing::error!(%error, "could not read further events of a job");
                Some((Err(error), None))
            }
        }
    }))
}

/// Follow the farm.
///
/// First `hello`, then every change: `job`, a job that is new or has changed, as it is now, at most once in
/// 250 ms; `deleted`, the id of a job that was deleted; and `farm`, the farm's numbers, at most once a second. After `resync`, and after
/// reconnecting, read the list of jobs again: changes in between are missing. A key with scope submit but not read receives
/// events of jobs of its own name only. The stream does not end.
#[utoipa::path(
    get, path = "", tag = "farm", operation_id = "follow_farm",
    responses((status = 200, description = "Events, as they happen", body = serde_json::Value, content_type = "text/event-stream"))
)]
pub(in crate::http) async fn follow_farm(
    State(events): State<Arc<FarmEvents>>,
    State(shutdown): State<Shutdown>,
    caller: Caller,
) -> Result<Response, ApiError> {
    let follower = FarmSubscriber::start(&events, caller.visible_submitter(), shutdown.closing().clone()).await?;
    Ok(response(stream::unfold(follower, async |mut follower| {
        follower.next().await.map(|bytes| (Ok::<_, Infallible>(bytes), follower))
    })))
}

/// Response with a stream of events.
fn response<E: Into<BoxError> + 'static>(events: impl Stream<Item = Result<Bytes, E>> + Send + 'static) -> Response {
    let mut response = Body::from_stream(events).into_response();
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("text/event-stream"));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    // Some proxies buffer responses, which would delay events.
    headers.insert("x-accel-buffering", HeaderValue::from_static("no"));
    response
}
