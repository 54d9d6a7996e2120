//! Permission that each route requires if the farm has keys. A route not listed here requires `admin`.

use axum::http::Method;
use proto::api_key::Scope;

/// Permission that a route requires.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Permission {
    /// None: the route is public.
    Public,
    /// A key of this scope.
    Scope(Scope),
    /// A key of this scope, or one of scope `submit` whose name submitted the job.
    OwnJob(Scope),
}

/// Permission that a route requires; `route` is empty for an unknown path.
pub(super) fn required_permission(method: &Method, route: &str) -> Permission {
    let looks = *method == Method::GET || *method == Method::HEAD;
    if looks && is_public(route) {
        return Permission::Public;
    }
    match route {
        "/v1/jobs" if looks => Permission::OwnJob(Scope::Read),
        "/v1/jobs" if *method == Method::POST => Permission::Scope(Scope::Submit),
        // A caller who may read a picture may share a link to it.
        _ if route.starts_with("/v1/jobs/{id}") && (looks || route.ends_with("/link")) => {
            Permission::OwnJob(Scope::Read)
        }
        _ if route.starts_with("/v1/jobs/{id}") => Permission::OwnJob(Scope::Admin),
        _ if route.starts_with("/v1/worker/") => Permission::Scope(Scope::Worker),
        "/v1/workers" | "/v1/pool" | "/v1/farm" | "/metrics" if looks => Permission::Scope(Scope::Read),
        _ => Permission::Scope(Scope::Admin),
    }
}

/// Public routes: health, descriptions, and pictures by signed link. Unknown paths respond 404 to every caller.
fn is_public(route: &str) -> bool {
    matches!(route, "" | "/" | "/livez" | "/readyz" | "/openapi.json" | "/v1/schema/job")
        || route == "/docs"
        || route.starts_with("/docs/")
        || route.starts_with("/v1/pictures/")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unlisted_routes_require_admin() {
        for (method, route) in [
            (Method::GET, "/v1/keys"),
            (Method::POST, "/livez"),
            (Method::DELETE, "/v1/jobs"),
            (Method::GET, "/v1/new"),
            (Method::GET, "/docsy"),
            (Method::PUT, "/v1/pool"),
        ] {
            assert_eq!(required_permission(&method, route), Permission::Scope(Scope::Admin), "{method} {route}");
        }
    }
}
