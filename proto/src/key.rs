//! Keys and the audit log, as administrators see them over HTTP and on the command line.
//!
//! A key's secret is in [`IssuedKey`] alone, once.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::JobId;

/// What a key lets its bearer do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Scope {
    /// Hand in jobs, and look at, change and delete jobs of the key's own name.
    Submit,
    /// Look at everything but keys and the audit log.
    Read,
    /// Render: the workers' protocol.
    Worker,
    /// Everything.
    Admin,
}

impl Scope {
    /// Every scope.
    pub const ALL: [Self; 4] = [Self::Submit, Self::Read, Self::Worker, Self::Admin];

    /// Its name, as flags and messages write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Submit => "submit",
            Self::Read => "read",
            Self::Worker => "worker",
            Self::Admin => "admin",
        }
    }
}

/// Whether a key lets anyone in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum KeyState {
    /// It does.
    Live,
    /// Its time is over.
    Expired,
    /// It was revoked.
    Revoked,
}

/// A key to make: `POST /v1/keys`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NewKey {
    /// Whose key it is: 1 to 64 letters, digits, dots, dashes and underscores. Jobs handed in with it are this
    /// name's, and up to two live keys may have one name.
    pub name: String,
    /// What it lets its bearer do; one scope at least.
    pub scopes: Vec<Scope>,
    /// Seconds until it expires; without, it never does.
    #[serde(default)]
    pub expires_in_seconds: Option<u64>,
    /// Unfinished jobs that its name may have; without, the server's own limit holds.
    #[serde(default)]
    pub max_jobs: Option<u32>,
    /// Camera rays that the unfinished jobs of its name may have together.
    #[serde(default)]
    pub max_rays: Option<u64>,
    /// Requests a second that it may make; without, the server's own limit holds.
    #[serde(default)]
    pub requests_per_second: Option<u32>,
}

/// A key, without its secret.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct KeyView {
    /// Its id, by which it is revoked.
    pub id: String,
    /// Whose it is.
    pub name: String,
    /// Whether it lets anyone in.
    pub state: KeyState,
    /// What it lets its bearer do.
    pub scopes: Vec<Scope>,
    /// Unfinished jobs that its name may have; null is the server's own limit.
    pub max_jobs: Option<u32>,
    /// Camera rays that the unfinished jobs of its name may have together; null is any number.
    pub max_rays: Option<u64>,
    /// Requests a second that it may make; null is the server's own limit.
    pub requests_per_second: Option<u32>,
    /// When it was made.
    pub created_at: String,
    /// When it expires; null is never.
    pub expires_at: Option<String>,
    /// When it was revoked.
    pub revoked_at: Option<String>,
    /// When it was last used, to about a minute.
    pub last_used_at: Option<String>,
}

/// A key that was just made, with its secret: the only time that it is shown.
#[derive(Clone, Serialize, Deserialize, JsonSchema)]
pub struct IssuedKey {
    /// The secret, to be sent as `Authorization: Bearer …`; nobody can show it again.
    pub secret: String,
    /// The key.
    pub key: KeyView,
}

impl std::fmt::Debug for IssuedKey {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("IssuedKey").field("key", &self.key).finish_non_exhaustive()
    }
}

/// The answer of `GET /v1/keys`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct KeyList {
    /// Every key, newest first.
    pub keys: Vec<KeyView>,
}

/// Who did what, or was refused.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct AuditEntry {
    /// Its number; later entries have higher ones.
    pub number: i64,
    /// When.
    pub at: String,
    /// The key's name, `local` while there are no keys, `pool` for the server's own workers, `-` for nobody known.
    pub who: String,
    /// The key's id, if it was a key.
    pub key: Option<String>,
    /// Where the request came from, without port.
    pub address: String,
    /// The request's method.
    pub method: String,
    /// The route, with its parameters' names.
    pub route: String,
    /// The job it was about.
    pub job: Option<JobId>,
    /// The answer's status.
    pub status: u16,
    /// The problem's code, of a refusal.
    pub code: Option<String>,
    /// The request's id, as in the server's log.
    pub request_id: String,
    /// How many times the same was refused within a moment.
    pub times: u32,
}

/// The answer of `GET /v1/audit`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct AuditPage {
    /// Entries, newest first.
    pub entries: Vec<AuditEntry>,
    /// Where the next page begins; null on the last.
    pub next_cursor: Option<String>,
}
