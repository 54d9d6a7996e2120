//! Records every change and every rejection in the audit log, and serves its pages to administrators.
//!
//! Of workers, only registrations and rejections are recorded.

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

use super::auth::{Caller, Peer};
use super::body;
use super::error::ApiError;
use super::request_id::RequestId;
use crate::audit_log::AuditRecord;
use crate::farm::Farm;

/// Default number of entries on a page.
const DEFAULT_PAGE_SIZE: u32 = 100;
/// Entries on a page, at most.
const MAX_PAGE: u32 = 1000;
/// Maximum length of a recorded path that matches no route, in characters.
const MAX_PATH_CHARACTERS: usize = 200;

/// Records the outcome of a request in the audit log.
pub(super) async fn record_request(
    State(farm): State<Arc<Farm>>,
    parameters: Result<RawPathParams, RawPathParamsRejection>,
    request: Request,
    next: Next,
) -> Response {
    let extensions = request.extensions();
    let route = extensions.get::<MatchedPath>().map(|route| route.as_str().to_owned());
    let address = extensions.get::<Peer>().map_or_else(|| "-".to_owned(), |peer| peer.0.to_string());
    let request_id = extensions.get::<RequestId>().map_or_else(String::new, |id| id.0.clone());
    let method = request.method().clone();
    let path = request.uri().path().chars().take(MAX_PATH_CHARACTERS).collect();
    let named = parameters.ok().and_then(|parameters| {
        parameters.iter().find(|(name, _)| *name == "id").and_then(|(_, id)| id.parse::<JobId>().ok())
    });
    let response = next.run(request).await;
    let changes = ![Method::GET, Method::HEAD, Method::OPTIONS].contains(&method) && is_recorded(route.as_deref());
    if changes || is_rejection(response.status()) {
        let caller = response.extensions().get::<Caller>().cloned().unwrap_or(Caller::Anonymous);
        farm.admission.audit.record(AuditRecord {
            actor: caller.name().to_owned(),
            key: caller.key().map(|key| key.id().to_owned()),
            address,
            method: method.to_string(),
            route: route.unwrap_or(path),
            job: named.or_else(|| created_job(&response)),
            status: response.status().as_u16(),
            code: response.extensions().get::<Problem>().map(|problem| problem.code.clone()),
            request_id,
        });
    }
    response
}

/// Whether changes by this route are recorded; a request without a route changes nothing.
fn is_recorded(route: Option<&str>) -> bool {
    route.is_some_and(|route| !route.starts_with("/v1/worker/") || route == proto::worker_protocol::REGISTER_PATH)
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
/// Contains every change and every rejection, newest first; the newest 100,000 entries are kept.
#[utoipa::path(
    get, path = "/v1/audit", tag = "keys", operation_id = "audit",
    params(
        ("limit" = Option<u32>, Query, description = "Maximum number of entries, 1 to 1000"),
        ("cursor" = Option<String>, Query, description = "The `next_cursor` of the page before"),
    ),
    responses(
        (status = 200, description = "A page", body = ref("#/components/schemas/AuditPage")),
        (status = 422, description = "Invalid query parameters", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
    )
)]
pub(super) async fn list(State(farm): State<Arc<Farm>>, uri: Uri) -> Result<Json<AuditPage>, ApiError> {
    let query: PageQuery = body::read_query(&uri)?;
    let limit = query.limit.unwrap_or(DEFAULT_PAGE_SIZE);
    if !(1..=MAX_PAGE).contains(&limit) {
        return Err(ApiError::WrongQuery(format!("limit is {limit}, but must be from 1 to {MAX_PAGE}")));
    }
    Ok(Json(farm.admission.audit.page(query.cursor, limit).await?))
}
