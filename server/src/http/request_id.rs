//! Request ids: each request has one in its log lines, in its response's header, and in its problem.

use std::sync::Arc;

use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::{HeaderName, HeaderValue, header};
use axum::middleware::Next;
use axum::response::Response;
use proto::problem::PROBLEM_JSON;
use proto::{JobId, Problem};
use tracing::field::Empty;
use tracing::{Instrument, Span};

use crate::clock::monotonic_now;
use crate::http::routes;
use crate::http::workers::trace_context;
use crate::telemetry::Telemetry;

const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
/// Maximum length of request ids sent by clients.
const MAX_ID_CHARACTERS: usize = 64;

/// Id of a request, as an extension for handlers that record it.
#[derive(Clone, Debug)]
pub(in crate::http) struct RequestId(pub(in crate::http) String);

/// Assigns a request its id, logs it, and writes the body of a problem.
pub(in crate::http) async fn trace(
    State(telemetry): State<Arc<Telemetry>>,
    mut request: Request,
    next: Next,
) -> Response {
    let id = client_request_id(&request).unwrap_or_else(|| uuid::Uuid::now_v7().to_string());
    request.extensions_mut().insert(RequestId(id.clone()));
    let method = request.method().clone();
    let route = routes::path_of(&request).to_owned();
    let span = span_of(&request, &id);
    trace_context::set_parent(&span, request.headers());
    let start = monotonic_now();
    async move {
        let mut response = next.run(request).await;
        let elapsed_ms = start.elapsed().as_secs_f64() * 1e3;
        telemetry.metrics.record_response(&route, method.as_str(), response.status().as_u16(), start.elapsed());
        if response.status().is_server_error() {
            tracing::warn!(status = response.status().as_u16(), elapsed_ms, %route, "answered");
        } else {
            tracing::debug!(status = response.status().as_u16(), elapsed_ms, %route, "answered");
        }
        if let Some(problem) = response.extensions_mut().remove::<Problem>() {
            write_problem(&mut response, &Problem { request_id: Some(id.clone()), ..problem });
        }
        if let Ok(value) = HeaderValue::from_str(&id) {
            response.headers_mut().insert(REQUEST_ID, value);
        }
        response
    }
    .instrument(span)
    .await
}

/// Polling routes have a span with another name, which is not exported.
fn span_of(request: &Request, id: &str) -> Span {
    let (method, path) = (request.method(), request.uri().path());
    let span = if routes::policy_of(request).is_polled {
        tracing::info_span!("poll", request_id = %id, %method, %path, job = Empty)
    } else {
        tracing::info_span!("request", request_id = %id, %method, %path, job = Empty)
    };
    if let Some(job) = path.strip_prefix("/v1/jobs/").and_then(|rest| rest.split('/').next()?.parse::<JobId>().ok()) {
        span.record("job", tracing::field::display(job));
    }
    span
}

fn client_request_id(request: &Request) -> Option<String> {
    let id = request.headers().get(REQUEST_ID)?.to_str().ok()?;
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.:".contains(&byte);
    (!id.is_empty() && id.len() <= MAX_ID_CHARACTERS && id.bytes().all(is_plain)).then(|| id.to_owned())
}

fn write_problem(response: &mut Response, problem: &Problem) {
    let text = serde_json::to_vec(problem).expect("a problem is plain text and numbers");
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(PROBLEM_JSON));
    headers.insert(header::CONTENT_LENGTH, HeaderValue::from(text.len()));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    *response.body_mut() = Body::from(text);
}
