//! The mode in which the page only shows: changes that a browser asks for are refused, whatever key it has.
//!
//! Browsers name the page that a changing request comes from (`Origin`, Fetch Standard), and no script can leave that out.
//! Programs do not name one: they change the farm as before.

use axum::extract::Request;
use axum::http::{Method, header};
use serde::Deserialize;

use crate::config::Config;
use crate::http::body;
use crate::http::error::ApiError;
use crate::http::routes::{self, Audit};

/// Routes that change nothing if their query has `dry_run=true`. Others do not read it.
const DRY_RUNS: [(Method, &str); 4] = [
    (Method::POST, "/v1/jobs"),
    (Method::POST, "/v1/jobs/{id}/resubmit"),
    (Method::DELETE, "/v1/jobs/{id}"),
    (Method::POST, "/v1/gc"),
];

#[derive(Debug, Deserialize)]
struct DryRunQuery {
    #[serde(default)]
    dry_run: bool,
}

/// Refuses a change that a browser asks for, if the page is read-only.
pub(in crate::http) fn check(config: &Config, request: &Request) -> Result<(), ApiError> {
    let is_refused = config.read_only_page
        && request.headers().contains_key(header::ORIGIN)
        && routes::policy_of(request).audit != Audit::Nothing
        && !is_dry_run(request);
    if is_refused { Err(ApiError::ReadOnlyPage) } else { Ok(()) }
}

/// Whether a request is a dry run; its handler reads the query the same way.
fn is_dry_run(request: &Request) -> bool {
    let path = routes::path_of(request);
    let has_dry_runs = DRY_RUNS.iter().any(|(method, route)| method == request.method() && *route == path);
    has_dry_runs && body::read_query::<DryRunQuery>(request.uri()).is_ok_and(|query| query.dry_run)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_route_with_dry_runs_is_one_that_changes_something() {
        for (method, path) in DRY_RUNS {
            assert_ne!(routes::policy(&method, path).audit, Audit::Nothing, "{method} {path}");
            assert!(crate::http::ROUTES.iter().any(|route| route.method == method && route.path == path));
        }
    }
}
