//! The table of routes: how a row is written, how the rows become the router, and which policy a request has.
//!
//! The rows are in `http.rs`. A route without a row does not exist, because the router is made from the rows alone.

use std::time::Duration;

use axum::extract::{MatchedPath, Request};
use axum::http::Method;
use axum::routing::MethodRouter;
use proto::api_key::Scope;
use utoipa::openapi::path::Paths;

use crate::audit_log::EntryKind;
use crate::http::ROUTES;
use crate::http::error::ErrorKind;
use crate::http::state::ApiState;

/// Time limit for the start of most responses.
const RESPONSE_TIMEOUT: Duration = Duration::from_mins(1);
/// End of the path of a job's links: a caller who may read a picture may share it.
const LINK_SUFFIX: &str = "/link";

/// Permission that a route requires if the farm has keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::http) enum Permission {
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
pub(in crate::http) mod permission {
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
pub(in crate::http) mod limit {
    use super::{Duration, RESPONSE_TIMEOUT};

    /// One minute, unless the client prefers to wait.
    pub(in crate::http) const MINUTE: Option<Duration> = Some(RESPONSE_TIMEOUT);
    /// None: the route waits, or takes in a large body.
    pub(in crate::http) const NONE: Option<Duration> = None;
}

/// Changes that the audit log records of a route. Rejections are recorded of every route.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::http) enum Audit {
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
    pub(in crate::http) fn entry_kind(self) -> EntryKind {
        match self {
            Self::Work | Self::NewJob => EntryKind::Work,
            Self::Admin | Self::NewKey | Self::Nothing => EntryKind::Admin,
        }
    }

    /// Whether success is that something was created.
    pub(in crate::http) fn creates(self) -> bool {
        match self {
            Self::NewJob | Self::NewKey => true,
            Self::Nothing | Self::Work | Self::Admin => false,
        }
    }
}

/// Treatment of a request before and after its handler.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::http) struct Policy {
    /// Permission that it requires.
    pub(in crate::http) permission: Permission,
    /// Time limit for the start of the response.
    pub(in crate::http) time_limit: Option<Duration>,
    /// Changes that the audit log records.
    pub(in crate::http) audit: Audit,
    /// Whether monitors and workers request it again and again: it is served before others, and not traced.
    pub(in crate::http) is_polled: bool,
}

/// Row of the table.
pub(in crate::http) struct Route {
    /// Method; a row for `GET` also serves `HEAD`.
    pub(in crate::http) method: Method,
    /// Path, with its parameters' names.
    pub(in crate::http) path: &'static str,
    /// Treatment of its requests.
    pub(in crate::http) policy: Policy,
    /// Makes its handler.
    pub(in crate::http) endpoint: fn() -> MethodRouter<ApiState>,
    /// Makes its description for the `OpenAPI` document; `None` for the workers' protocol, and the pages of the document
    /// itself.
    pub(in crate::http) description: Option<Description>,
}

/// Description of a route for users.
pub(in crate::http) struct Description {
    /// Makes that of its handler, under an empty path.
    pub(in crate::http) operation: fn() -> Paths,
    /// Errors of its own.
    pub(in crate::http) errors: &'static [ErrorKind],
}

/// Declares the table of routes.
macro_rules! table {
    (@is_polled) => { false };
    (@is_polled polled) => { true };
    (
        @row $description:expr;
        $method:ident $path:literal $permission:ident $limit:ident $audit:ident $($handler:ident)::+ $($polled:ident)?
    ) => {
        $crate::http::routes::Route {
            method: axum::http::Method::$method,
            path: $path,
            policy: $crate::http::routes::Policy {
                permission: $crate::http::routes::permission::$permission,
                time_limit: $crate::http::routes::limit::$limit,
                audit: $crate::http::routes::Audit::$audit,
                is_polled: $crate::http::routes::table!(@is_polled $($polled)?),
            },
            endpoint: || axum::routing::on(axum::routing::MethodFilter::$method, $($handler)::+),
            description: $description,
        }
    };
    (
        described {$(
            $method:ident $path:literal $permission:ident $limit:ident $audit:ident $($handler:ident)::+ $(, $polled:ident)?
            $([$($error:ident)*])?;
        )*}
        hidden {$(
            $hidden_method:ident $hidden_path:literal $hidden_permission:ident $hidden_limit:ident $hidden_audit:ident
            $($hidden_handler:ident)::+ $(, $hidden_polled:ident)?;
        )*}
    ) => {
        /// Every route of the server.
        static ROUTES: &[$crate::http::routes::Route] = &[
            $($crate::http::routes::table!(
                @row Some($crate::http::routes::Description {
                    operation: || {
                        let (_, paths, _): utoipa_axum::router::UtoipaMethodRouter<ApiState> =
                            utoipa_axum::routes!($($handler)::+);
                        paths
                    },
                    errors: &[$($($crate::http::error::ErrorKind::$error),*)?],
                });
                $method $path $permission $limit $audit $($handler)::+ $($polled)?
            ),)*
            $($crate::http::routes::table!(
                @row None;
                $hidden_method $hidden_path $hidden_permission $hidden_limit $hidden_audit
                $($hidden_handler)::+ $($hidden_polled)?
            ),)*
        ];
    };
}

pub(in crate::http) use table;

/// Router of all routes.
pub(in crate::http) fn router() -> axum::Router<ApiState> {
    ROUTES.iter().fold(axum::Router::new(), |router, route| router.route(route.path, (route.endpoint)()))
}

/// Route of a request, with its parameters' names; empty for an unknown path.
pub(in crate::http) fn path_of(request: &Request) -> &str {
    request.extensions().get::<MatchedPath>().map_or("", MatchedPath::as_str)
}

/// Policy of a request.
pub(in crate::http) fn policy_of(request: &Request) -> Policy {
    policy(request.method(), path_of(request))
}

/// Policy of a request with this method to this route.
pub(in crate::http) fn policy(method: &Method, path: &str) -> Policy {
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
    use std::fs;
    use std::path::{Path, PathBuf};

    use super::*;

    /// Files besides the table that name paths: what the page may change, where to look next, and whom to answer 405.
    const MAY_NAME_PATHS: [&str; 5] = [
        "http/page/docs.rs",
        "http/page/read_only.rs",
        "http/routes.rs",
        "http/page/start_page.rs",
        "http/jobs/submission.rs",
    ];

    /// Sources of the HTTP layer without their tests, by their paths under `src`.
    fn sources() -> Vec<(String, String)> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
        let (mut found, mut folders) = (Vec::new(), vec![root.join("http")]);
        let mut take = |path: PathBuf| {
            let name = path.strip_prefix(&root).expect("under the root").display().to_string();
            let text = fs::read_to_string(&path).expect("a source is text");
            found.push((name, text.split("#[cfg(test)]").next().unwrap_or_default().to_owned()));
        };
        take(root.join("http.rs"));
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).expect("a folder of sources") {
                let path = entry.expect("an entry").path();
                if path.is_dir() { folders.push(path) } else { take(path) }
            }
        }
        found
    }

    /// With its handler, the matrix of permissions and `docs/openapi.json`, which tests compare with the table, these are
    /// the four files that a new route touches.
    #[test]
    fn the_path_of_a_route_stands_in_the_table_alone() {
        for (name, text) in sources() {
            let named: Vec<_> = ROUTES.iter().filter(|route| text.contains(&format!("{:?}", route.path))).collect();
            match &*name {
                "http.rs" => assert_eq!(named.len(), ROUTES.len()),
                name if MAY_NAME_PATHS.contains(&name) => assert!(named.len() < ROUTES.len() / 5, "{name}"),
                name => assert!(named.is_empty(), "{name} names {}, which stands in http.rs", named[0].path),
            }
        }
    }

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
    fn a_description_has_the_method_of_its_row_and_leaves_the_path_to_it() {
        for route in ROUTES {
            let Some(description) = &route.description else { continue };
            let paths = serde_json::to_value((description.operation)()).expect("a description is plain JSON");
            let paths = paths.as_object().expect("an object");
            assert_eq!(paths.keys().collect::<Vec<_>>(), [""], "{} {}", route.method, route.path);
            let methods: Vec<_> = paths[""].as_object().expect("an object").keys().collect();
            assert_eq!(methods, [&route.method.as_str().to_lowercase()], "{}", route.path);
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
