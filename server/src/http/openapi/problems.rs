//! Completes the description of a route: the permission that it requires, and the errors that it may respond with.
//!
//! Errors that all routes with a permission, a body or a query share are added here; the others are in the route's row.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use crate::http::error::ErrorKind;
use crate::http::routes::{Permission, Policy};

/// Name of the security scheme in the document.
const SCHEME: &str = "key";

/// The security scheme of the document.
pub(super) fn security_schemes() -> Value {
    json!({
        SCHEME: {
            "type": "http",
            "scheme": "bearer",
            "description": "A key created by `sdfarm key new`; not required if the farm has no keys.",
        }
    })
}

/// Adds a route's security, and one response for each status of its errors.
pub(super) fn describe(operation: &mut Value, policy: &Policy, own: &[ErrorKind]) {
    if policy.permission != Permission::Public {
        operation["security"] = json!([{}, { SCHEME: [] }]);
    }
    let mut by_status: BTreeMap<u16, Vec<ErrorKind>> = BTreeMap::new();
    for kind in of_request(operation).iter().chain(own).chain(&of_policy(policy)) {
        by_status.entry(kind.response().status.as_u16()).or_default().push(*kind);
    }
    for (status, kinds) in by_status {
        operation["responses"][status.to_string()] = response(&kinds, policy.permission);
    }
}

/// Errors of what a request has: a body, a content encoding, a query.
fn of_request(operation: &Value) -> Vec<ErrorKind> {
    let mut kinds = Vec::new();
    let parameters = operation["parameters"].as_array().map(Vec::as_slice).unwrap_or_default();
    if operation["requestBody"].is_object() {
        kinds.extend([ErrorKind::NotJson, ErrorKind::BrokenBody, ErrorKind::TooLarge]);
        kinds.extend([ErrorKind::WrongType, ErrorKind::WrongEncoding]);
        let is_encoded = parameters.iter().any(|parameter| parameter["name"] == "Content-Encoding");
        kinds.push(if is_encoded { ErrorKind::DamagedEncoding } else { ErrorKind::WrongBody });
    }
    if parameters.iter().any(|parameter| parameter["in"] == "query") {
        kinds.push(ErrorKind::WrongQuery);
    }
    kinds
}

/// Errors of every route with this policy.
fn of_policy(policy: &Policy) -> Vec<ErrorKind> {
    let mut kinds = match policy.permission {
        Permission::Public => Vec::new(),
        Permission::AnyOrNone => vec![ErrorKind::UnknownKey, ErrorKind::ExpiredKey, ErrorKind::RevokedKey],
        Permission::Scope(_) | Permission::OwnJob(_) => vec![
            ErrorKind::MissingKey,
            ErrorKind::UnknownKey,
            ErrorKind::ExpiredKey,
            ErrorKind::RevokedKey,
            ErrorKind::MissingScope,
            ErrorKind::SlowBody,
        ],
    };
    kinds.extend([ErrorKind::TooManyRequests, ErrorKind::TooManyAtOnce, ErrorKind::Busy, ErrorKind::ShuttingDown]);
    if policy.time_limit.is_some() {
        kinds.push(ErrorKind::ResponseTimeout);
    }
    kinds
}

/// Response for errors of one status: the title and the code of each, and their headers.
fn response(kinds: &[ErrorKind], permission: Permission) -> Value {
    let mut sentences: Vec<String> = Vec::new();
    let mut headers = Map::new();
    for kind in kinds {
        let row = kind.response();
        let title = match (kind, permission) {
            (ErrorKind::MissingScope, Permission::Scope(scope)) => format!("The key lacks scope {}", scope.name()),
            (ErrorKind::MissingScope, Permission::OwnJob(scope)) => {
                format!("The key lacks scope {} and did not submit this job", scope.name())
            }
            _ => row.title.to_owned(),
        };
        sentences.push(format!("{title} (`{}`)", row.code));
        if let Some(header) = row.header {
            headers.insert(title_case(header.as_str()), json!({ "schema": { "type": "string" } }));
        }
    }
    let mut response = json!({
        "description": sentences.join("; "),
        "content": { "application/problem+json": { "schema": { "$ref": "#/components/schemas/Problem" } } },
    });
    if !headers.is_empty() {
        response["headers"] = Value::Object(headers);
    }
    response
}

/// Name of a header as documents write it: `Retry-After`.
fn title_case(name: &str) -> String {
    let words = name.split('-').map(|word| {
        let (first, rest) = word.split_at(1);
        if word == "www" { "WWW".to_owned() } else { format!("{}{rest}", first.to_uppercase()) }
    });
    words.collect::<Vec<_>>().join("-")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Errors that no described route documents: of requests that reach no route, of the workers' routes, and of the
    /// server itself.
    const UNDOCUMENTED: [ErrorKind; 14] = [
        ErrorKind::WrongRequest,
        ErrorKind::UnknownRoute,
        ErrorKind::WrongMethod,
        ErrorKind::ForeignHost,
        ErrorKind::ForeignOrigin,
        ErrorKind::ReadOnlyPage,
        ErrorKind::WrongToken,
        ErrorKind::ForeignWorker,
        ErrorKind::NoLease,
        ErrorKind::UnneededBytes,
        ErrorKind::WrongPictureVersion,
        ErrorKind::WrongBytes,
        ErrorKind::UnknownBlob,
        ErrorKind::Internal,
    ];

    /// With `server/tests/api/documented.rs`, which compares each refusal of those tests with the document.
    #[test]
    fn every_row_of_the_table_of_errors_is_documented_with_its_status() {
        let paths = super::super::DOCUMENT["paths"].as_object().expect("paths");
        let operations = || paths.values().flat_map(|path| path.as_object().expect("operations").values());
        for kind in ErrorKind::ALL {
            let (status, code) = (kind.response().status.as_u16().to_string(), format!("(`{}`)", kind.response().code));
            let about = |operation: &Value| operation["responses"][&status]["description"].to_string();
            let is_documented = operations().any(|operation| about(operation).contains(&code));
            assert_ne!(is_documented, UNDOCUMENTED.contains(kind), "{kind:?}: {status} {code}");
        }
    }
}
