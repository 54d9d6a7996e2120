//! The audit log, as administrators see it over HTTP and on the command line.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::JobId;

/// Entry of the audit log: a change or a rejection.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct AuditEntry {
    /// Number of the entry; later entries have higher ones.
    pub number: i64,
    /// Time.
    pub at: String,
    /// Name of the key; `local` while there are no keys, `pool` for the server's own workers, `-` if
    /// unknown.
    pub who: String,
    /// The key's id, if it was a key.
    pub key: Option<String>,
    /// Client's address, without port.
    pub address: String,
    /// The request's method.
    pub method: String,
    /// The route, with its parameters' names.
    pub route: String,
    /// The job it was about.
    pub job: Option<JobId>,
    /// Status of the response.
    pub status: u16,
    /// Problem code of a rejection.
    pub code: Option<String>,
    /// The request's id, as in the server's log.
    pub request_id: String,
    /// Number of equal rejections in quick succession.
    pub times: u32,
}

/// Response of `GET /v1/audit`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct AuditPage {
    /// Entries, newest first.
    pub entries: Vec<AuditEntry>,
    /// Cursor of the next page; null on the last.
    pub next_cursor: Option<String>,
}
