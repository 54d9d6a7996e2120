//! Errors of the HTTP API: RFC 9457 problem details.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Media type of a [`Problem`].
pub const PROBLEM_JSON: &str = "application/problem+json";

/// RFC 9457 problem details, with a stable `code` for programs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Problem {
    /// Address of the code's description: `/docs#code`.
    #[serde(rename = "type")]
    pub kind: String,
    /// Title of the problem type; the same for every problem with one code.
    pub title: String,
    /// The HTTP status.
    pub status: u16,
    /// Stable name for programs.
    pub code: String,
    /// Error in this request, and the fix.
    pub detail: String,
    /// Errors of an invalid job.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub errors: Vec<ValidationErrorView>,
    /// Id of the request, as in the server's log.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub request_id: Option<String>,
}

/// One error of an invalid job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ValidationErrorView {
    /// JSON pointer (RFC 6901) to the error; for an unknown member to that member, for a missing one to its
    /// parent.
    pub pointer: String,
    /// The error, and the fix.
    pub message: String,
    /// Line in the body, from 1.
    pub line: u32,
    /// Column in the line, from 1, in bytes.
    pub column: u32,
}

impl From<&scene::ValidationError> for ValidationErrorView {
    fn from(fault: &scene::ValidationError) -> Self {
        Self { pointer: fault.pointer.clone(), message: fault.message.clone(), line: fault.line, column: fault.column }
    }
}
