//! Authentication and authorization: no request passes without the permission that its route requires.
//!
//! `rules` has the permission of each route; `audit` records the outcome in the audit log.

use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Body;
use axum::extract::{FromRequestParts, MatchedPath, RawPathParams, Request, State};
use axum::http::{HeaderMap, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures_util::StreamExt;
use proto::JobId;
use proto::api_key::Scope;

use super::error::ApiError;
use super::permissions::{Need, need};
use crate::admission::{Pace, Refusal};
use crate::api_keys::{Found, Key, same};
use crate::farm::Farm;

/// An answer has to begin within this time, unless its route waits or takes in much.
const ANSWER: Duration = Duration::from_mins(1);

/// Submitter of all jobs while there are no keys.
const LOCAL: &str = "local";

/// Address of the client.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Peer(pub(crate) IpAddr);

/// Caller of a request; an extension of every request and response.
#[derive(Clone, Debug)]
pub(crate) enum Caller {
    /// Unknown, on a public route, or rejected.
    Nobody,
    /// Any client of a farm without keys.
    Local,
    /// One of the server's own workers.
    Pool,
    /// The bearer of a live key.
    Key(Arc<Key>),
}

impl Caller {
    /// Name under which jobs are submitted.
    pub(crate) fn name(&self) -> &str {
        match self {
            Self::Nobody => "-",
            Self::Local => LOCAL,
            Self::Pool => "pool",
            Self::Key(key) => key.name(),
        }
    }

    /// The name whose jobs are all that it sees; `None` if it sees every job.
    pub(crate) fn sees_only(&self) -> Option<&str> {
        self.key().filter(|key| !key.scopes().allow(Scope::Read)).map(|key| key.name())
    }

    /// The key, if it is one.
    pub(crate) fn key(&self) -> Option<&Arc<Key>> {
        match self {
            Self::Key(key) => Some(key),
            Self::Nobody | Self::Local | Self::Pool => None,
        }
    }
}

/// Authenticates and authorizes a request; one that waits under a key ends with the key.
pub(super) async fn identify(
    State(farm): State<Arc<Farm>>,
    parameters: Result<RawPathParams, axum::extract::rejection::RawPathParamsRejection>,
    mut request: Request,
    next: Next,
) -> Response {
    let route = request.extensions().get::<MatchedPath>().map_or("", MatchedPath::as_str);
    let need = need(request.method(), route);
    let peer = request.extensions().get::<Peer>().map(|peer| peer.0);
    let caller = match caller(&farm, need, peer, request.headers()) {
        Ok(caller) => caller,
        Err(error) => return refuse(&farm, peer, Caller::Nobody, error),
    };
    let job = parameters.ok().and_then(|parameters| {
        parameters.iter().find(|(name, _)| *name == "id").and_then(|(_, id)| id.parse::<JobId>().ok())
    });
    if let Err(error) = authorise(&farm, need, &caller, job).await {
        return refuse(&farm, peer, caller, error);
    }
    let pace = match farm.doors.admit(caller.key().map(|key| &**key), peer, matches!(caller, Caller::Local)) {
        Ok(pace) => pace,
        Err(refusal) => return with_caller(ApiError::from(refusal).into_response(), caller),
    };
    request.extensions_mut().insert(caller.clone());
    let route = request.extensions().get::<MatchedPath>().map_or("", MatchedPath::as_str);
    let limit = time_limit(route, &request);
    let Some(key) = caller.key() else { return with_caller(in_time(next.run(request), limit).await, caller) };
    let response = tokio::select! {
        response = in_time(next.run(request), limit) => response,
        () = key.ended().cancelled() => ApiError::EndedKey.into_response(),
    };
    let response = until_ended(with_pace(response, pace), key);
    with_caller(response, caller)
}

/// Time until a response must begin; request bodies have a minimum rate instead.
fn time_limit(route: &str, request: &Request) -> Option<Duration> {
    let takes_in = route.starts_with("/v1/worker/") || (route == "/v1/jobs" && request.method() == Method::POST);
    let waits = route.ends_with("/events") || request.headers().contains_key("prefer");
    (!takes_in && !waits).then_some(ANSWER)
}

async fn in_time(answer: impl Future<Output = Response>, limit: Option<Duration>) -> Response {
    let Some(limit) = limit else { return answer.await };
    match tokio::time::timeout(limit, answer).await {
        Ok(response) => response,
        Err(_) => ApiError::TooLong { limit_seconds: limit.as_secs() }.into_response(),
    }
}

fn with_caller(mut response: Response, caller: Caller) -> Response {
    response.extensions_mut().insert(caller);
    response
}

/// Rejects the request. After 20 rejections a second from one address, the response is 429 instead of the reason.
fn refuse(farm: &Farm, peer: Option<IpAddr>, caller: Caller, error: ApiError) -> Response {
    let error = match farm.doors.count_refusal(peer) {
        Ok(()) => error,
        Err(refusal) => refusal.into(),
    };
    with_caller(error.into_response(), caller)
}

/// Caller of this request.
fn caller(farm: &Farm, need: Need, peer: Option<IpAddr>, headers: &HeaderMap) -> Result<Caller, ApiError> {
    let keys = &farm.doors.keys;
    let bearer = headers.get(header::AUTHORIZATION).map(|value| {
        let text = value.to_str().unwrap_or_default();
        text.split_once(' ')
            .filter(|(scheme, _)| scheme.eq_ignore_ascii_case("bearer"))
            .map_or("", |(_, key)| key.trim())
    });
    let is_workers = need == Need::Scope(Scope::Worker);
    if is_workers && bearer.is_some_and(|token| same(token, farm.pool.token())) {
        return Ok(Caller::Pool);
    }
    if !keys.are_wanted() {
        // Without keys the server listens on loopback only, or was started with `--insecure`.
        return if is_workers && bearer.is_some() { Err(ApiError::WrongToken) } else { Ok(Caller::Local) };
    }
    if need == Need::Nothing {
        return Ok(Caller::Nobody);
    }
    match bearer {
        None => Err(ApiError::MissingKey),
        Some(secret) => match keys.find(secret) {
            Found::Live(key) => Ok(Caller::Key(key)),
            Found::Expired => Err(ApiError::ExpiredKey),
            Found::Revoked => Err(ApiError::EndedKey),
            Found::Unknown => {
                tracing::debug!(?peer, "an unknown key was brought");
                Err(ApiError::UnknownKey)
            }
        },
    }
}

/// Whether the caller has the permission.
async fn authorise(farm: &Farm, need: Need, caller: &Caller, job: Option<JobId>) -> Result<(), ApiError> {
    let Caller::Key(key) = caller else { return Ok(()) };
    let scope = match need {
        Need::Nothing => return Ok(()),
        Need::Scope(scope) | Need::OwnJob(scope) => scope,
    };
    if key.scopes().allow(scope) {
        return Ok(());
    }
    if matches!(need, Need::OwnJob(_)) && key.scopes().allow(Scope::Submit) {
        let Some(job) = job else { return Ok(()) };
        // For a job that does not exist, the handler responds.
        if farm.queue.submitter(job).await?.is_none_or(|submitter| submitter == key.name()) {
            return Ok(());
        }
    }
    Err(ApiError::MissingScope { scope, name: key.name().to_owned() })
}

/// Adds headers with the remaining rate.
fn with_pace(mut response: Response, pace: Option<Pace>) -> Response {
    if let Some(pace) = pace {
        for (name, value) in pace.headers() {
            response.headers_mut().insert(name, value);
        }
    }
    response
}

/// Ends a response of unknown length, such as an event stream, when the key is revoked.
fn until_ended(response: Response, key: &Key) -> Response {
    use axum::body::HttpBody;
    if response.body().size_hint().exact().is_some() {
        return response;
    }
    let ended = key.ended().clone().cancelled_owned();
    response.map(|body| Body::from_stream(body.into_data_stream().take_until(ended)))
}

impl<S: Sync> FromRequestParts<S> for Caller {
    type Rejection = std::convert::Infallible;

    async fn from_request_parts(parts: &mut axum::http::request::Parts, _state: &S) -> Result<Self, Self::Rejection> {
        Ok(parts.extensions.get().cloned().unwrap_or(Self::Nobody))
    }
}

impl From<Refusal> for ApiError {
    fn from(refusal: Refusal) -> Self {
        Self::TooManyRequests { per_second: refusal.per_second, retry_seconds: refusal.retry_seconds }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limited(method: Method, route: &str, header: Option<&str>) -> bool {
        let mut request = Request::builder().method(method).uri("/");
        if let Some(name) = header {
            request = request.header(name, "wait=5");
        }
        time_limit(route, &request.body(Body::empty()).expect("a request")) == Some(ANSWER)
    }

    #[test]
    fn answers_begin_in_time_but_where_they_wait_or_bodies_are_sent_in() {
        assert!(limited(Method::GET, "/v1/jobs", None));
        assert!(limited(Method::POST, "/v1/jobs/{id}/cancel", None));
        assert!(limited(Method::PATCH, "/v1/jobs/{id}", Some("accept")));
        assert!(!limited(Method::POST, "/v1/jobs", None));
        assert!(!limited(Method::GET, "/v1/jobs/{id}", Some("prefer")));
        assert!(!limited(Method::GET, "/v1/jobs/{id}/events", None));
        assert!(!limited(Method::PUT, "/v1/worker/blobs/{hash}", None));
    }

    #[tokio::test]
    async fn answer_that_does_not_begin_is_given_up() {
        let answer = in_time(std::future::pending(), Some(Duration::from_millis(1))).await;
        assert_eq!(answer.status(), ApiError::TooLong { limit_seconds: 0 }.into_response().status());
        assert!(answer.status().is_server_error());
        for limit in [None, Some(ANSWER)] {
            assert!(in_time(std::future::ready(Response::default()), limit).await.status().is_success());
        }
    }

    #[test]
    fn each_caller_has_its_name() {
        assert_eq!(
            [Caller::Nobody, Caller::Local, Caller::Pool].map(|caller| caller.name().to_owned()),
            ["-", "local", "pool"]
        );
        assert!(Caller::Local.sees_only().is_none() && Caller::Pool.key().is_none());
    }
}
