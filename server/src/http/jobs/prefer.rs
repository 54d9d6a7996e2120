//! `Prefer: wait=N` (RFC 7240): the response is sent when the job has finished, or after N seconds.

use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use proto::JobId;
use proto::job::JobView;

use crate::clock::monotonic_now;
use crate::events::EventHub;
use crate::http::error::ApiError;
use crate::http::state::handle_group;
use crate::queue::Queue;
use crate::shutdown::Shutdown;

/// Maximum wait; a client that wants to wait longer repeats the request.
const MAX_WAIT: Duration = Duration::from_mins(1);
const PREFER: &str = "prefer";
const APPLIED: HeaderName = HeaderName::from_static("preference-applied");

handle_group! {
    /// Handles of a response that may wait for a job.
    JobWaiter {
        /// Has the job.
        queue: Queue,
        /// Signals its changes.
        events: Arc<EventHub>,
        /// Ends the wait.
        shutdown: Shutdown,
    }
}

impl JobWaiter {
    /// Responds with a job when it has finished or the wait has expired.
    pub(in crate::http) async fn answer(
        &self,
        id: JobId,
        headers: &HeaderMap,
        status: StatusCode,
    ) -> Result<Response, ApiError> {
        let wait = wait(headers);
        if let Some(wait) = wait {
            self.wait_until_finished(id, wait).await?;
        }
        let view: JobView = self.queue.job(id).await?.ok_or_else(|| ApiError::UnknownJob(id.to_string()))?;
        let mut response = (status, Json(view)).into_response();
        if let Some(wait) = wait
            && let Ok(value) = HeaderValue::from_str(&format!("wait={}", wait.as_secs()))
        {
            response.headers_mut().insert(APPLIED, value);
        }
        Ok(response)
    }

    async fn wait_until_finished(&self, id: JobId, wait: Duration) -> Result<(), ApiError> {
        let deadline = monotonic_now() + wait;
        let Some(followed) = self.queue.event_position(id, 0).await? else { return Ok(()) };
        let topic = self.events.topic(followed.job).await?;
        let mut changes = topic.changes();
        while self.queue.has_ended(followed.job).await? == Some(false) {
            tokio::select! {
                changed = changes.changed() => if changed.is_err() { break },
                () = tokio::time::sleep_until(deadline) => break,
                () = self.shutdown.begun().cancelled() => break,
            }
        }
        Ok(())
    }
}

/// Requested wait; an unreadable header is ignored, as RFC 7240 requires.
fn wait(headers: &HeaderMap) -> Option<Duration> {
    headers
        .get_all(PREFER)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(','))
        .filter_map(|preference| preference.split(';').next()?.split_once('='))
        .find(|(name, _)| name.trim().eq_ignore_ascii_case("wait"))
        .and_then(|(_, seconds)| seconds.trim().trim_matches('"').parse().ok())
        .map(|seconds| Duration::from_secs(seconds).min(MAX_WAIT))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn preferences_are_parsed_according_to_rfc_7240() {
        for (value, seconds) in [
            ("wait=10", Some(10)),
            ("respond-async, wait=5", Some(5)),
            ("Wait = \"7\"; foo", Some(7)),
            ("wait=100000", Some(60)),
            ("wait=0", Some(0)),
            ("wait", None),
            ("wait=soon", None),
            ("wait=-1", None),
            ("return=minimal", None),
        ] {
            let mut headers = HeaderMap::new();
            headers.insert(PREFER, HeaderValue::from_static(value));
            assert_eq!(wait(&headers), seconds.map(Duration::from_secs), "{value}");
        }
        assert_eq!(wait(&HeaderMap::new()), None);
    }
}
