//! Which errors `docs/openapi.json` documents for a path. Each refusal of these tests is compared with it.

use std::sync::LazyLock;

use serde_json::Value;

/// The description of the API, which is made from the table of errors and the table of routes.
static DOCUMENT: LazyLock<Value> =
    LazyLock::new(|| serde_json::from_str(include_str!("../../../docs/openapi.json")).expect("JSON"));

/// Errors that any request may get: before its route is chosen, or because the server or its storage fails.
const OF_ANY_ROUTE: [&str; 11] = [
    "wrong_request",
    "unknown_route",
    "wrong_method",
    "foreign_host",
    "foreign_origin",
    "read_only_page",
    "internal",
    "disk_full",
    "database_unreachable",
    "store_unreachable",
    "damaged_database",
];

/// Whether a path is one of a template such as `/v1/jobs/{id}`.
fn is_of(path: &str, template: &str) -> bool {
    let (parts, wanted) = (path.split('/'), template.split('/'));
    parts.clone().count() == wanted.clone().count()
        && parts.zip(wanted).all(|(part, wanted)| part == wanted || wanted.starts_with('{'))
}

/// Asserts that a route of this path documents this status with this code. The paths of workers are not documented.
pub(crate) fn assert_documented(path: &str, status: u16, code: &str) {
    let routes = DOCUMENT["paths"].as_object().expect("paths");
    let mut operations = routes.iter().filter(|(template, _)| is_of(path, template)).peekable();
    let about = |operation: &Value| operation["responses"][status.to_string()]["description"].to_string();
    let documents = |operation: &Value| about(operation).contains(&format!("(`{code}`)"));
    assert!(
        OF_ANY_ROUTE.contains(&code)
            || operations.peek().is_none()
            || operations.any(|(_, methods)| methods.as_object().expect("methods").values().any(documents)),
        "{path} responds with {status} {code}, which its row in the table of routes lacks"
    );
}

#[test]
fn paths_are_found_by_their_templates() {
    assert!(is_of("/v1/jobs/7/frames/0/image", "/v1/jobs/{id}/frames/{frame}/image"));
    assert!(!is_of("/v1/jobs/7/frames", "/v1/jobs/{id}/events") && !is_of("/v1/jobs", "/v1/jobs/{id}"));
    assert_documented("/v1/jobs/7", 404, "unknown_job");
    assert!(std::panic::catch_unwind(|| assert_documented("/v1/jobs/7", 404, "unknown_layer")).is_err());
}
