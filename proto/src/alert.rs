//! Alerts: conditions that need an operator, as the HTTP API returns them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How much an alert matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AlertSeverity {
    /// Nothing is rendered, or soon nothing will be.
    Critical,
    /// The farm works, but needs attention.
    Warning,
}

/// Something that needs an operator.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct AlertView {
    /// Code, which stays the same in later versions, such as `disk_low`.
    pub code: String,
    /// How much it matters.
    pub severity: AlertSeverity,
    /// Message.
    pub message: String,
    /// Fix.
    pub cure: String,
    /// Time at which the server that was asked noticed it, RFC 3339 in UTC: within half a minute of its beginning, or at the
    /// server's start.
    pub since: String,
}

/// Response of `GET /v1/alerts`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct AlertList {
    /// Conditions that need an operator now, critical ones first.
    pub alerts: Vec<AlertView>,
}
