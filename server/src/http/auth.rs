//! Authentication and authorization: each request must have the permission that its route requires.
//!
//! The table of routes has the permission of each; `audit` records the outcome in the audit log.

use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body, HttpBody};
use axum::extract::{FromRequestParts, RawPathParams, Request, State};
use axum::http::{HeaderMap, HeaderValue, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures_util::StreamExt;
use proto::JobId;
use proto::api_key::Scope;

use crate::admission::{
    CallerClass, Holder, RateLimitStatus, RateLimited, RateLimits, ResponseShares, Shares, UNCOUNTED_BYTES,
};
use crate::api_keys::{ApiKey, ApiKeys, KeyLookup, constant_time_eq};
use crate::audit_log;
use crate::budget::Share;
use crate::http::error::ApiError;
use crate::http::routes::{self, Audit, Permission, Policy};
use crate::http::state::handle_group;
use crate::listen::Peer;
use crate::pool::Pool;
use crate::queue::Queue;

/// Submitter of all jobs on a farm without keys.
pub(in crate::http) const KEYLESS_SUBMITTER: &str = "local";

/// Caller of a request; an extension of every request and response.
#[derive(Clone, Debug)]
pub(crate) enum Caller {
    /// Unknown: the route is public, or the request is rejected.
    Anonymous,
    /// Client of a farm without keys.
    Keyless,
    /// One of the server's own workers.
    Pool,
    /// Client that sent a live key.
    Key(Arc<ApiKey>),
}

impl Caller {
    /// Name under which jobs are submitted.
    pub(crate) fn name(&self) -> &str {
        match self {
            Self::Anonymous => "-",
            Self::Keyless => KEYLESS_SUBMITTER,
            Self::Pool => "pool",
            Self::Key(key) => key.name(),
        }
    }

    /// The same name, if the caller is known.
    pub(in crate::http) fn identity(&self) -> Option<&str> {
        match self {
            Self::Anonymous => None,
            Self::Keyless | Self::Pool | Self::Key(_) => Some(self.name()),
        }
    }

    /// Name whose jobs are the only ones the caller may see; `None` if it may see every job.
    pub(crate) fn visible_submitter(&self) -> Option<&str> {
        self.key().filter(|key| !key.scopes().is_allowed(Scope::Read)).map(|key| key.name())
    }

    /// Owner of the workers that the caller registers: a key's id, `pool`, or `local` without keys.
    pub(crate) fn owner(&self) -> &str {
        self.key().map_or_else(|| self.name(), |key| key.id())
    }

    /// Key of the caller, if it sent one.
    pub(crate) fn key(&self) -> Option<&Arc<ApiKey>> {
        match self {
            Self::Key(key) => Some(key),
            Self::Anonymous | Self::Keyless | Self::Pool => None,
        }
    }
}

handle_group! {
    /// Handles of authentication and authorization.
    Gate {
        /// Has the keys.
        api_keys: Arc<ApiKeys>,
        /// Has the rates of callers.
        rate_limits: Arc<RateLimits>,
        /// Has what callers have in progress.
        shares: Arc<Shares>,
        /// Has the token of local workers.
        pool: Arc<Pool>,
        /// Has the submitters of jobs.
        queue: Queue,
    }
}

/// Authenticates and authorizes a request; if the caller's key is revoked, an open request ends.
pub(in crate::http) async fn authenticate_and_authorize(
    State(gate): State<Gate>,
    parameters: Result<RawPathParams, axum::extract::rejection::RawPathParamsRejection>,
    mut request: Request,
    next: Next,
) -> Response {
    let policy = routes::policy_of(&request);
    let need = policy.permission;
    let peer = request.extensions().get::<Peer>().map(|peer| peer.0);
    let caller = match gate.caller(need, peer, request.headers()).await {
        Ok(caller) => caller,
        Err(error) => return gate.reject(peer, Caller::Anonymous, error),
    };
    let holder = holder(&caller, policy, peer);
    let place = match gate.shares.request(&holder) {
        Ok(place) => place,
        Err(exhausted) => {
            let error = ApiError::exhausted(&holder, "requests in progress, with unread responses", exhausted);
            return with_caller(error.into_response(), caller);
        }
    };
    let job = parameters.ok().and_then(|parameters| {
        parameters.iter().find(|(name, _)| *name == "id").and_then(|(_, id)| id.parse::<JobId>().ok())
    });
    if let Err(error) = gate.authorize(need, &caller, job).await {
        return gate.reject(peer, caller, error);
    }
    let pace = match gate.rate_limits.admit(caller.key().map(|key| &**key), peer, matches!(caller, Caller::Keyless)) {
        Ok(pace) => pace,
        Err(refusal) => return with_caller(ApiError::from(refusal).into_response(), caller),
    };
    request.extensions_mut().insert(caller.clone());
    audit_log::describe(|record| {
        caller.name().clone_into(&mut record.actor);
        record.key = caller.key().map(|key| key.id().to_owned());
    });
    request.extensions_mut().insert(holder.clone());
    let limit = time_limit(policy, request.headers());
    let answer = with_timeout(next.run(request), limit);
    let response = match caller.key() {
        None => answer.await,
        Some(key) => {
            let response = tokio::select! {
                response = answer => response,
                () = key.revoked().cancelled() => ApiError::RevokedKey.into_response(),
            };
            keep_private(end_with_key(with_rate_limit_headers(response, pace), key))
        }
    };
    with_caller(hold_shares(&gate.shares, &holder, place, response), caller)
}

impl Gate {
    /// Rejects the request. After 20 rejections a second from one address, the response is 429 instead of the reason.
    fn reject(&self, peer: Option<IpAddr>, caller: Caller, error: ApiError) -> Response {
        let error = match self.rate_limits.count_rejection(peer) {
            Ok(()) => error,
            Err(refusal) => refusal.into(),
        };
        with_caller(error.into_response(), caller)
    }

    /// Caller of this request.
    async fn caller(&self, need: Permission, peer: Option<IpAddr>, headers: &HeaderMap) -> Result<Caller, ApiError> {
        let keys = &self.api_keys;
        let bearer = headers.get(header::AUTHORIZATION).map(|value| {
            let text = value.to_str().unwrap_or_default();
            text.split_once(' ')
                .filter(|(scheme, _)| scheme.eq_ignore_ascii_case("bearer"))
                .map_or("", |(_, key)| key.trim())
        });
        let is_workers = need == Permission::Scope(Scope::Worker);
        if is_workers && bearer.is_some_and(|token| constant_time_eq(token, self.pool.token())) {
            return Ok(Caller::Pool);
        }
        if !keys.are_required() {
            // Without keys the server listens on loopback only, or was started with `--insecure`.
            return if is_workers && bearer.is_some() { Err(ApiError::WrongToken) } else { Ok(Caller::Keyless) };
        }
        if need == Permission::Public {
            return Ok(Caller::Anonymous);
        }
        match bearer {
            None if need == Permission::AnyOrNone => Ok(Caller::Anonymous),
            None => Err(ApiError::MissingKey),
            Some(secret) => match keys.find_or_reread(secret).await? {
                KeyLookup::Live(key) => Ok(Caller::Key(key)),
                KeyLookup::Expired => Err(ApiError::ExpiredKey),
                KeyLookup::Revoked => Err(ApiError::RevokedKey),
                KeyLookup::Unknown => {
                    tracing::debug!(?peer, "request with an unknown key");
                    Err(ApiError::UnknownKey)
                }
            },
        }
    }

    /// Whether the caller has the permission.
    async fn authorize(&self, need: Permission, caller: &Caller, job: Option<JobId>) -> Result<(), ApiError> {
        let Caller::Key(key) = caller else { return Ok(()) };
        let scope = match need {
            Permission::Public | Permission::AnyOrNone => return Ok(()),
            Permission::Scope(scope) | Permission::OwnJob(scope) => scope,
        };
        if key.scopes().is_allowed(scope) {
            return Ok(());
        }
        if matches!(need, Permission::OwnJob(_)) && key.scopes().is_allowed(Scope::Submit) {
            let Some(job) = job else { return Ok(()) };
            // For a job that does not exist, the handler sends the response.
            if self.queue.submitter(job).await?.is_none_or(|submitter| submitter == key.name()) {
                return Ok(());
            }
        }
        Err(ApiError::MissingScope { scope, name: key.name().to_owned() })
    }
}

/// Keeps the request's place, and room for a large response in memory, until the response is sent.
fn hold_shares(shares: &Shares, holder: &Holder, place: Share, response: Response) -> Response {
    // A stream has no exact size: only a chunk of it is in memory.
    let size_bytes = response.body().size_hint().exact().unwrap_or(0) as usize;
    let room = if size_bytes > UNCOUNTED_BYTES { shares.response(holder, size_bytes).map(Some) } else { Ok(None) };
    let (mut response, room) = match room {
        Ok(room) => (response, room),
        Err(exhausted) => (
            ApiError::exhausted(holder, "bytes of responses that are not received yet", exhausted).into_response(),
            None,
        ),
    };
    response.extensions_mut().insert(ResponseShares::new(place, room));
    response
}

/// Caller of a request to a route, as far as limits are concerned.
fn holder(caller: &Caller, policy: Policy, peer: Option<IpAddr>) -> Holder {
    let is_admin = caller.key().is_some_and(|key| key.scopes().is_allowed(Scope::Admin));
    let class = if policy.permission == Permission::Scope(Scope::Worker) {
        CallerClass::Worker
    } else if policy.is_polled || (is_admin && policy.audit != Audit::NewJob) {
        CallerClass::Reserved
    } else {
        CallerClass::User
    };
    match caller {
        Caller::Key(key) => Holder { class, name: format!("key {}", key.name()) },
        Caller::Pool => Holder { class, name: "the pool".to_owned() },
        Caller::Anonymous | Caller::Keyless => Holder::of_address(class, peer),
    }
}

/// Time limit for the start of the response; none if the client prefers to wait.
fn time_limit(policy: Policy, headers: &HeaderMap) -> Option<Duration> {
    policy.time_limit.filter(|_| !headers.contains_key("prefer"))
}

async fn with_timeout(answer: impl Future<Output = Response>, limit: Option<Duration>) -> Response {
    let Some(limit) = limit else { return answer.await };
    match tokio::time::timeout(limit, answer).await {
        Ok(response) => response,
        Err(_) => ApiError::ResponseTimeout { limit_seconds: limit.as_secs() }.into_response(),
    }
}

fn with_caller(mut response: Response, caller: Caller) -> Response {
    response.extensions_mut().insert(caller);
    response
}

/// Adds headers with the caller's remaining requests.
fn with_rate_limit_headers(mut response: Response, pace: Option<RateLimitStatus>) -> Response {
    if let Some(pace) = pace {
        for (name, value) in pace.headers() {
            response.headers_mut().insert(name, value);
        }
    }
    response
}

/// Forbids shared caches to store a response that needed a key.
fn keep_private(mut response: Response) -> Response {
    let headers = response.headers_mut();
    let directives = headers.get(header::CACHE_CONTROL).and_then(|value| value.to_str().ok()).unwrap_or_default();
    let kept = directives.split(',').map(str::trim).filter(|directive| !["", "public", "private"].contains(directive));
    let value = std::iter::once("private").chain(kept).collect::<Vec<_>>().join(", ");
    if let Ok(value) = HeaderValue::from_str(&value) {
        headers.insert(header::CACHE_CONTROL, value);
    }
    response
}

/// Ends a response of unknown length, such as an event stream, when the key is revoked.
fn end_with_key(response: Response, key: &ApiKey) -> Response {
    if response.body().size_hint().exact().is_some() {
        return response;
    }
    let ended = key.revoked().clone().cancelled_owned();
    response.map(|body| Body::from_stream(body.into_data_stream().take_until(ended)))
}

impl<S: Sync> FromRequestParts<S> for Caller {
    type Rejection = std::convert::Infallible;

    async fn from_request_parts(parts: &mut axum::http::request::Parts, _state: &S) -> Result<Self, Self::Rejection> {
        Ok(parts.extensions.get().cloned().unwrap_or(Self::Anonymous))
    }
}

impl From<RateLimited> for ApiError {
    fn from(refusal: RateLimited) -> Self {
        Self::TooManyRequests { per_second: refusal.per_second, retry_seconds: refusal.retry_seconds }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_client_that_prefers_to_wait_has_no_time_limit() {
        let policy =
            |time_limit| Policy { permission: Permission::Public, time_limit, audit: Audit::Nothing, is_polled: false };
        let mut headers = HeaderMap::new();
        headers.insert(header::ACCEPT, HeaderValue::from_static("*/*"));
        assert_eq!(time_limit(policy(routes::limit::MINUTE), &headers), routes::limit::MINUTE);
        assert_eq!(time_limit(policy(routes::limit::NONE), &headers), None);
        headers.insert("prefer", HeaderValue::from_static("wait=5"));
        assert_eq!(time_limit(policy(routes::limit::MINUTE), &headers), None);
    }

    #[tokio::test]
    async fn a_response_that_does_not_start_times_out() {
        let answer = with_timeout(std::future::pending(), Some(Duration::from_millis(1))).await;
        assert_eq!(answer.status(), ApiError::ResponseTimeout { limit_seconds: 0 }.into_response().status());
        assert!(answer.status().is_server_error());
        for limit in [routes::limit::NONE, routes::limit::MINUTE] {
            assert!(with_timeout(std::future::ready(Response::default()), limit).await.status().is_success());
        }
    }

    #[test]
    fn responses_that_needed_a_key_are_private() {
        for (set, kept) in [
            ("", "private"),
            ("public, max-age=31536000, immutable", "private, max-age=31536000, immutable"),
            ("no-cache", "private, no-cache"),
            ("private, no-store", "private, no-store"),
        ] {
            let mut response = Response::new(Body::empty());
            if !set.is_empty() {
                response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static(set));
            }
            assert_eq!(keep_private(response).headers()[header::CACHE_CONTROL], kept);
        }
    }

    #[test]
    fn each_caller_has_its_name() {
        assert_eq!(
            [Caller::Anonymous, Caller::Keyless, Caller::Pool].map(|caller| caller.name().to_owned()),
            ["-", "local", "pool"]
        );
        assert!(Caller::Keyless.visible_submitter().is_none() && Caller::Pool.key().is_none());
    }
}
