//! The table of routes: how a row is written, how the rows become the router, and which policy a request has.
//!
//! The rows are in `http.rs`. A route without a row does not exist, because the router is made from the rows alone.

use std::time::Duration;

use axum::extract::{MatchedPath, Request};
use axum::http::Method;
use axum::routing::MethodRouter;
use proto::api_key::Scope;
use utoipa::openapi::OpenApi;
use utoipa_axum::router::{OpenApiRouter, UtoipaMethodRouter};

use super::ROUTES;
use super::state::ApiState;
use crate::audit_log::EntryKind;

/// Time limit for the start of most responses.
const RESPONSE_TIMEOUT: Duration = Duration::from_mins(1);
/// End of the path of a job's links: a caller who may read a picture may share it.
const LINK_SUFFIX: &str = "/link";

/// Permission that a route requires if the farm has keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Permission {
    /// None: the route is public.
    Public,
    /// None, but a key that is sent must be valid.
    AnyOrNone,
    /// A key of this scope.
    Scope(Scope),
    /// A key of this scope, or one of scope `submit` whose name submitted the job.
    OwnJob(Scope),
}

/// Permissions as the table names them.
pub(super) mod permission {
    use super::{Permission, Scope};

    /// No key is needed.
    pub(in crate::http) const PUBLIC: Permission = Permission::Public;
    /// No key is needed, and any valid one is accepted.
    pub(in crate::http) const ANY_OR_NONE: Permission = Permission::AnyOrNone;
    /// Reads the farm.
    pub(in crate::http) const READ: Permission = Permission::Scope(Scope::Read);
    /// Submits jobs.
    pub(in crate::http) const SUBMIT: Permission = Permission::Scope(Scope::Submit);
    /// Is a worker.
    pub(in crate::http) const WORKER: Permission = Permission::Scope(Scope::Worker);
    /// Administers the farm.
    pub(in crate::http) const ADMIN: Permission = Permission::Scope(Scope::Admin);
    /// Reads any job, or its own ones.
    pub(in crate::http) const READ_OWN: Permission = Permission::OwnJob(Scope::Read);
    /// Changes any job, or its own ones.
    pub(in crate::http) const CHANGE_OWN: Permission = Permission::OwnJob(Scope::Admin);
}

/// Time limits as the table names them: of the start of the response; request bodies have a minimum rate instead.
pub(super) mod limit {
    use super::{Duration, RESPONSE_TIMEOUT};

    /// One minute, unless the client prefers to wait.
    pub(in crate::http) const MINUTE: Option<Duration> = Some(RESPONSE_TIMEOUT);
    /// None: the route waits, or takes in a large body.
    pub(in crate::http) const NONE: Option<Duration> = None;
}

/// Changes that the audit log records of a route. Rejections are recorded of every route.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Audit {
    /// Nothing.
    Nothing,
    /// A change to a job, or a registered worker.
    Work,
    /// A change to keys, the pool or the farm.
    Admin,
    /// A new job.
    NewJob,
    /// A new key.
    NewKey,
}

impl Audit {
    /// Kind of the entry of a change.
    pub(super) fn entry_kind(self) -> EntryKind {
        match self {
            Self::Work | Self::NewJob => EntryKind::Work,
            Self::Admin | Self::NewKey | Self::Nothing => EntryKind::Admin,
        }
    }

    /// Whether success is that something was created.
    pub(super) fn creates(self) -> bool {
        match self {
            Self::NewJob | Self::NewKey => true,
            Self::Nothing | Self::Work | Self::Admin => false,
        }
    }
}

/// Treatment of a request before and after its handler.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Policy {
    /// Permission that it requires.
    pub(super) permission: Permission,
    /// Time limit for the start of the response.
    pub(super) time_limit: Option<Duration>,
    /// Changes that the audit log records.
    pub(super) audit: Audit,
    /// Whether monitors and workers request it again and again: it is served before others, and not traced.
    pub(super) is_polled: bool,
}

/// Row of the table.
pub(super) struct Route {
    /// Method; a row for `GET` also serves `HEAD`.
    pub(super) method: Method,
    /// Path, with its parameters' names.
    pub(super) path: &'static str,
    /// Treatment of its requests.
    pub(super) policy: Policy,
    /// Makes its handler.
    pub(super) endpoint: fn() -> Endpoint,
}

/// Handler of a route.
pub(super) enum Endpoint {
    /// With its description for the `OpenAPI` document.
    Described(UtoipaMethodRouter<ApiState>),
    /// Not in the document: the workers' protocol, and the pages of the document itself.
    Hidden(MethodRouter<ApiState>),
}

/// Declares the table of routes.
macro_rules! table {
    (@is_polled) => { false };
    (@is_polled polled) => { true };
    (@row $endpoint:expr; $method:ident $path:literal $permission:ident $limit:ident $audit:ident $($polled:ident)?) => {
        $crate::http::routes::Route {
            method: axum::http::Method::$method,
            path: $path,
            policy: $crate::http::routes::Policy {
                permission: $crate::http::routes::permission::$permission,
                time_limit: $crate::http::routes::limit::$limit,
                audit: $crate::http::routes::Audit::$audit,
                is_polled: $crate::http::routes::table!(@is_polled $($polled)?),
            },
            endpoint: $endpoint,
        }
    };
    (
        described {$(
            $method:ident $path:literal $permission:ident $limit:ident $audit:ident $($handler:ident)::+ $(, $polled:ident)?;
        )*}
        hidden {$(
            $hidden_method:ident $hidden_path:literal $hidden_permission:ident $hidden_limit:ident $hidden_audit:ident
            $($hidden_handler:ident)::+ $(, $hidden_polled:ident)?;
        )*}
    ) => {
        /// Every route of the server.
        static ROUTES: &[$crate::http::routes::Route] = &[
            $($crate::http::routes::table!(
                @row || $crate::http::routes::Endpoint::Described(utoipa_axum::routes!($($handler)::+));
                $method $path $permission $limit $audit $($polled)?
            ),)*
            $($crate::http::routes::table!(
                @row || $crate::http::routes::Endpoint::Hidden(
                    axum::routing::on(axum::routing::MethodFilter::$hidden_method, $($hidden_handler)::+)
                );
                $hidden_method $hidden_path $hidden_permission $hidden_limit $hidden_audit $($hidden_polled)?
            ),)*
        ];
    };
}

pub(super) use table;

/// Router of all routes, and the description of the documented ones.
pub(super) fn router() -> (axum::Router<ApiState>, OpenApi) {
    let router = ROUTES.iter().fold(OpenApiRouter::new(), |router, route| match (route.endpoint)() {
        Endpoint::Described(described) => router.routes(described),
        Endpoint::Hidden(methods) => router.route(route.path, methods),
    });
    router.split_for_parts()
}

/// Route of a request, with its parameters' names; empty for an unknown path.
pub(super) fn path_of(request: &Request) -> &str {
    request.extensions().get::<MatchedPath>().map_or("", MatchedPath::as_str)
}

/// Policy of a request.
pub(super) fn policy_of(request: &Request) -> Policy {
    policy(request.method(), path_of(request))
}

/// Policy of a request with this method to this route.
pub(super) fn policy(method: &Method, path: &str) -> Policy {
    let served = if *method == Method::HEAD { &Method::GET } else { method };
    let row = ROUTES.iter().find(|route| route.method == *served && route.path == path);
    row.map_or_else(|| policy_without_row(method, path), |route| route.policy)
}

/// Policy of a request that no row serves. Unknown paths respond 404 to every reader; a method that a path does not
/// have responds 405 to callers who may use the path, and to no other.
fn policy_without_row(method: &Method, path: &str) -> Policy {
    let looks = *method == Method::GET || *method == Method::HEAD;
    let is_of_workers = path.starts_with("/v1/worker/");
    let permission = match path {
        "" | "/v1/pictures/{hash}" if looks => permission::PUBLIC,
        _ if path.starts_with("/v1/jobs/{id}") && (looks || path.ends_with(LINK_SUFFIX)) => permission::READ_OWN,
        _ if path.starts_with("/v1/jobs/{id}") => permission::CHANGE_OWN,
        _ if is_of_workers => permission::WORKER,
        _ => permission::ADMIN,
    };
    let is_recorded = !looks
        && *method != Method::OPTIONS
        && !path.is_empty()
        && (!is_of_workers || path == proto::worker_protocol::REGISTER_PATH);
    Policy {
        permission,
        time_limit: limit::MINUTE,
        audit: if is_recorded { Audit::Admin } else { Audit::Nothing },
        is_polled: ROUTES.iter().any(|route| route.path == path && route.policy.is_polled),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn a_request_without_a_row_requires_admin() {
        for (method, path) in [
            (Method::POST, "/livez"),
            (Method::DELETE, "/v1/jobs"),
            (Method::GET, "/v1/new"),
            (Method::GET, "/docsy"),
            (Method::POST, "/v1/pool"),
            (Method::POST, ""),
        ] {
            assert_eq!(policy(&method, path).permission, permission::ADMIN, "{method} {path}");
        }
    }

    #[test]
    fn a_method_that_a_path_does_not_have_is_answered_to_callers_who_may_use_the_path() {
        for (method, path, needed) in [
            (Method::GET, "", permission::PUBLIC),
            (Method::HEAD, "/livez", permission::PUBLIC),
            (Method::GET, "/v1/jobs/{id}/cancel", permission::READ_OWN),
            (Method::PUT, "/v1/jobs/{id}", permission::CHANGE_OWN),
            (Method::PUT, "/v1/jobs/{id}/frames/{frame}/link", permission::READ_OWN),
            (Method::GET, "/v1/worker/sync", permission::WORKER),
            (Method::GET, "/v1/pictures/{hash}", permission::PUBLIC),
        ] {
            assert_eq!(policy(&method, path).permission, needed, "{method} {path}");
        }
    }

    #[test]
    fn each_row_has_the_method_and_the_path_of_its_handlers_description() {
        for route in ROUTES {
            let Endpoint::Described((_, paths, _)) = (route.endpoint)() else { continue };
            let described: Vec<_> = paths
                .paths
                .iter()
                .flat_map(|(path, item)| {
                    let item = serde_json::to_value(item).expect("a description is plain JSON");
                    let methods: Vec<_> = item.as_object().expect("an object").keys().cloned().collect();
                    methods.into_iter().map(move |method| format!("{} {path}", method.to_uppercase()))
                })
                .collect();
            assert_eq!(described, [format!("{} {}", route.method, route.path)]);
        }
    }

    #[test]
    fn no_two_rows_are_of_one_method_and_path() {
        let names: BTreeSet<_> = ROUTES.iter().map(|route| format!("{} {}", route.method, route.path)).collect();
        assert_eq!(names.len(), ROUTES.len());
    }

    #[test]
    fn the_workers_paths_are_those_of_the_protocol() {
        for path in [proto::worker_protocol::REGISTER_PATH, proto::worker_protocol::SYNC_PATH] {
            assert_eq!(policy(&Method::POST, path).permission, permission::WORKER);
            assert!(ROUTES.iter().any(|route| route.path == path), "{path}");
        }
    }

    #[test]
    fn only_waiting_and_uploading_routes_have_no_time_limit() {
        let unlimited: Vec<_> = ROUTES
            .iter()
            .filter(|route| route.policy.time_limit.is_none() && route.policy.permission != permission::WORKER)
            .map(|route| format!("{} {}", route.method, route.path))
            .collect();
        assert_eq!(unlimited, ["POST /v1/jobs", "GET /v1/jobs/{id}/events", "GET /v1/events"]);
    }
}
