//! Adds security to the description of every route: the key it requires, and the responses without one.

use axum::http::Method;
use serde_json::{Value, json};

use crate::http::permissions::{Permission, required_permission};

/// The scheme's name in the document.
const SCHEME: &str = "key";

/// Adds security schemes, and the responses for missing keys, exceeded rates and timeouts.
pub(super) fn describe(document: &mut Value) {
    document["components"]["securitySchemes"] = json!({
        SCHEME: {
            "type": "http",
            "scheme": "bearer",
            "description": "A key made by `sdfarm key new`; a farm without keys asks for none.",
        }
    });
    let Some(paths) = document["paths"].as_object_mut() else { return };
    for (path, operations) in paths {
        let Some(operations) = operations.as_object_mut() else { continue };
        for (method, operation) in operations {
            let (Ok(method), true) = (method.to_uppercase().parse::<Method>(), operation.is_object()) else { continue };
            let what = match required_permission(&method, path) {
                Permission::Public => {
                    add(operation, "503", "The answer took too long, or the server is ending");
                    continue;
                }
                Permission::Scope(scope) => format!("The key has not the scope {}", scope.name()),
                Permission::OwnJob(scope) => {
                    format!("The key lacks scope {} and did not submit this job", scope.name())
                }
            };
            operation["security"] = json!([{}, { SCHEME: [] }]);
            add(operation, "401", "No key, or one that is unknown, expired or revoked");
            add(operation, "403", &what);
            add(operation, "408", "The body came too slowly");
            add(operation, "429", "Requests come too fast: see Retry-After");
            add(operation, "503", "The answer took too long, or the server is ending");
        }
    }
}

/// Adds an answer, unless its route describes it.
fn add(operation: &mut Value, status: &str, description: &str) {
    let answers = &mut operation["responses"];
    if answers[status].is_null() {
        answers[status] = json!({
            "description": description,
            "content": { "application/problem+json": { "schema": { "$ref": "#/components/schemas/Problem" } } },
        });
    }
}
