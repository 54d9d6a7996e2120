//! Records every change in the audit log, counts rejections there, and serves its pages to administrators.
//!
//! The table of routes says what is recorded. Of workers, only registrations and rejections are.

use std::sync::Arc;

use axum::Json;
use axum::extract::rejection::RawPathParamsRejection;
use axum::extract::{MatchedPath, RawPathParams, Request, State};
use axum::http::{Method, StatusCode, Uri, header};
use axum::middleware::Next;
use axum::response::Response;
use proto::audit::AuditPage;
use proto::{JobId, Problem};
use serde::Deserialize;

use crate::audit_log::{AuditLog, AuditRecord};
use crate::http::auth::Caller;
use crate::http::body;
use crate::http::error::ApiError;
use crate::http::request_id::RequestId;
use crate::http::routes::{self, Audit};
use crate::listen::Peer;

/// Default number of entries on a page.
const DEFAULT_PAGE_SIZE: u32 = 100;
/// Entries on a page, at most.
const MAX_PAGE: u32 = 1000;
/// Route of a request that matches none.
const NO_ROUTE: &str = "-";

/// Records the outcome of a request in the audit log, before its response is sent.
///
/// A change is recorded with the write that makes it, also if its client has left.
pub(in crate::http) async fn record_request(
    State(audit): State<Arc<AuditLog>>,
    parameters: Result<RawPathParams, RawPathParamsRejection>,
    request: Request,
    next: Next,
) -> Response {
    let recorded = routes::policy_of(&request).audit;
    let expected = expected_record(&request, recorded, parameters.ok().as_ref());
    if recorded == Audit::Nothing {
        let response = next.run(request).await;
        if is_rejection(response.status()) {
            audit.reject(None, outcome(expected, &response)).await;
        }
        return response;
    }
    let (response, entry) = audit.handle(expected.clone(), next.run(request)).await;
    let outcome = outcome(expected, &response);
    match effect_of(response.status(), entry.is_written(), recorded) {
        Effect::Change => audit.finish(entry, outcome).await,
        Effect::Refusal => audit.reject(Some(entry), outcome).await,
        Effect::None => {}
    }
    response
}

/// Effect of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Effect {
    /// It changed something.
    Change,
    /// It was rejected.
    Refusal,
    /// It was accepted and changed nothing.
    None,
}

/// Effect of a request that was allowed to change something; `is_written` is true if it wrote to the database.
fn effect_of(status: StatusCode, is_written: bool, recorded: Audit) -> Effect {
    // If the key was revoked while its request was handled, a written change stays.
    let is_kept = is_written && (!status.is_client_error() || status == StatusCode::UNAUTHORIZED);
    if is_kept {
        Effect::Change
    } else if status.is_client_error() || status.is_server_error() {
        Effect::Refusal
    } else if recorded == Audit::NewJob {
        // A dry run.
        Effect::None
    } else {
        // A change outside the database, such as the pool's size.
        Effect::Change
    }
}

/// Record of a request that will succeed.
fn expected_record(request: &Request, recorded: Audit, parameters: Option<&RawPathParams>) -> AuditRecord {
    let extensions = request.extensions();
    let route = extensions.get::<MatchedPath>().map_or(NO_ROUTE, MatchedPath::as_str);
    let status = if recorded.creates() { StatusCode::CREATED } else { StatusCode::OK };
    let id = parameters.and_then(|parameters| parameters.iter().find(|(name, _)| *name == "id"));
    AuditRecord {
        kind: recorded.entry_kind(),
        actor: Caller::Anonymous.name().to_owned(),
        key: None,
        address: extensions.get::<Peer>().map_or_else(|| "-".to_owned(), |peer| peer.0.to_string()),
        method: standard_method(request.method()).to_owned(),
        route: route.to_owned(),
        job: id.and_then(|(_, id)| id.parse::<JobId>().ok()),
        status: status.as_u16(),
        code: None,
        request_id: extensions.get::<RequestId>().map_or_else(String::new, |id| id.0.clone()),
    }
}

/// Record of a request with this response.
fn outcome(expected: AuditRecord, response: &Response) -> AuditRecord {
    let caller = response.extensions().get::<Caller>().unwrap_or(&Caller::Anonymous);
    let status = response.status();
    let code = response.extensions().get::<Problem>().map(|problem| problem.code.clone());
    AuditRecord {
        actor: caller.name().to_owned(),
        key: caller.key().map(|key| key.id().to_owned()),
        job: expected.job.or_else(|| created_job(response)),
        status: status.as_u16(),
        code,
        ..expected
    }
}

/// A method of HTTP, or `other`: clients can invent any number of others.
fn standard_method(method: &Method) -> &str {
    let standard = [
        Method::GET,
        Method::HEAD,
        Method::POST,
        Method::PUT,
        Method::PATCH,
        Method::DELETE,
        Method::OPTIONS,
        Method::TRACE,
        Method::CONNECT,
    ];
    if standard.contains(method) { method.as_str() } else { "other" }
}

fn is_rejection(status: StatusCode) -> bool {
    [StatusCode::UNAUTHORIZED, StatusCode::FORBIDDEN, StatusCode::TOO_MANY_REQUESTS].contains(&status)
}

/// Id of the job that a response reports as created.
fn created_job(response: &Response) -> Option<JobId> {
    response.headers().get(header::LOCATION)?.to_str().ok()?.strip_prefix("/v1/jobs/")?.parse().ok()
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct PageQuery {
    limit: Option<u32>,
    cursor: Option<i64>,
}

/// List the audit log.
///
/// Contains every change, and rejections counted by source in periods of 10 minutes, newest first. The newest 100,000
/// changes to keys, the pool and the farm are kept, as many changes to jobs, and 20,000 entries of rejections.
#[utoipa::path(
    get, path = "", tag = "keys", operation_id = "audit",
    params(
        ("limit" = Option<u32>, Query, description = "Maximum number of entries, 1 to 1000"),
        ("cursor" = Option<String>, Query, description = "The `next_cursor` of the page before"),
    ),
    responses((status = 200, description = "A page", body = ref("#/components/schemas/AuditPage")))
)]
pub(in crate::http) async fn list(State(audit): State<Arc<AuditLog>>, uri: Uri) -> Result<Json<AuditPage>, ApiError> {
    let query: PageQuery = body::read_query(&uri)?;
    let limit = body::page_length(query.limit, DEFAULT_PAGE_SIZE, MAX_PAGE)?;
    Ok(Json(audit.page(query.cursor, limit).await?))
}
