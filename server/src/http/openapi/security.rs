//! Adds security to the description of every route: the permission that it requires, and the responses without
//! it.

use axum::http::Method;
use serde_json::{Value, json};

use crate::http::routes::{self, Permission};

/// Name of the security scheme in the document.
const SCHEME: &str = "key";

/// Adds security schemes, and the responses for missing keys, exceeded rates and timeouts.
pub(super) fn describe(document: &mut Value) {
    document["components"]["securitySchemes"] = json!({
        SCHEME: {
            "type": "http",
            "scheme": "bearer",
            "description": "A key created by `sdfarm key new`; not required if the farm has no keys.",
        }
    });
    let Some(paths) = document["paths"].as_object_mut() else { return };
    for (path, operations) in paths {
        let Some(operations) = operations.as_object_mut() else { continue };
        for (method, operation) in operations {
            let (Ok(method), true) = (method.to_uppercase().parse::<Method>(), operation.is_object()) else { continue };
            let permission = routes::policy(&method, path).permission;
            let what = match permission {
                Permission::Public | Permission::AnyOrNone => {
                    add(operation, "429", "Too many requests, or too many in progress: see Retry-After");
                    add(
                        operation,
                        "503",
                        "The response timed out, or the server is busy or shutting down; see Retry-After",
                    );
                    if permission == Permission::AnyOrNone {
                        operation["security"] = json!([{}, { SCHEME: [] }]);
                        add(operation, "401", "The key is unknown, expired or revoked");
                    }
                    continue;
                }
                Permission::Scope(scope) => format!("The key lacks scope {}", scope.name()),
                Permission::OwnJob(scope) => {
                    format!("The key lacks scope {} and did not submit this job", scope.name())
                }
            };
            operation["security"] = json!([{}, { SCHEME: [] }]);
            add(operation, "401", "The key is missing, unknown, expired or revoked");
            add(operation, "403", &what);
            add(operation, "408", "The body arrived too slowly");
            add(operation, "429", "Too many requests, or too many in progress: see Retry-After");
            add(operation, "503", "The response timed out, or the server is busy or shutting down; see Retry-After");
        }
    }
}

/// Adds a response, unless its route describes it.
fn add(operation: &mut Value, status: &str, description: &str) {
    let answers = &mut operation["responses"];
    if answers[status].is_null() {
        answers[status] = json!({
            "description": description,
            "content": { "application/problem+json": { "schema": { "$ref": "#/components/schemas/Problem" } } },
        });
    }
}
