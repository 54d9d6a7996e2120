//! API keys, as administrators see them over HTTP and on the command line.
//!
//! A key's secret is in [`IssuedApiKey`] alone, once.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Scope of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Scope {
    /// Submit jobs, and read, change and delete jobs of the key's own name.
    Submit,
    /// Read everything except keys and the audit log.
    Read,
    /// Render: the workers' protocol.
    Worker,
    /// Everything.
    Admin,
}

impl Scope {
    /// Every scope.
    pub const ALL: [Self; 4] = [Self::Submit, Self::Read, Self::Worker, Self::Admin];

    /// Name of the scope, as in flags and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Submit => "submit",
            Self::Read => "read",
            Self::Worker => "worker",
            Self::Admin => "admin",
        }
    }
}

/// Whether a key is accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ApiKeyState {
    /// Valid.
    Live,
    /// Expired.
    Expired,
    /// Revoked.
    Revoked,
}

/// Request for a new key: `POST /v1/keys`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NewApiKey {
    /// Owner's name: 1 to 64 letters, digits, dots, dashes and underscores. Jobs submitted with the key
    /// belong to this name; up to two live keys may share a name.
    pub name: String,
    /// Scopes, at least one.
    pub scopes: Vec<Scope>,
    /// Seconds until the key expires; absent means never.
    #[serde(default)]
    pub expires_in_seconds: Option<u64>,
    /// Maximum number of unfinished jobs of its name; the server's default if absent.
    #[serde(default)]
    pub max_jobs: Option<u32>,
    /// Maximum number of camera rays of the unfinished jobs of its name together.
    #[serde(default)]
    pub max_rays: Option<u64>,
    /// Maximum number of requests per second; the server's default if absent.
    #[serde(default)]
    pub requests_per_second: Option<u32>,
    /// Highest priority of its jobs, -100 to 100; if absent, 0, and 100 with scope admin.
    #[serde(default)]
    pub max_priority: Option<i32>,
}

/// A key, without its secret.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ApiKeyView {
    /// Id of the key, used to revoke it.
    pub id: String,
    /// Owner's name.
    pub name: String,
    /// Whether the key is accepted.
    pub state: ApiKeyState,
    /// Scopes.
    pub scopes: Vec<Scope>,
    /// Maximum number of unfinished jobs of its name; null means the server's default.
    pub max_jobs: Option<u32>,
    /// Maximum number of camera rays of the unfinished jobs of its name together; null means the server's default.
    pub max_rays: Option<u64>,
    /// Maximum number of requests per second; null means the server's default.
    pub requests_per_second: Option<u32>,
    /// Highest priority of its jobs.
    pub max_priority: i32,
    /// Time of creation.
    pub created_at: String,
    /// Time of expiry; null means never.
    pub expires_at: Option<String>,
    /// Time of revocation.
    pub revoked_at: Option<String>,
    /// Time of last use, accurate to about a minute.
    pub last_used_at: Option<String>,
}

/// New key with its secret, which is shown only here.
#[derive(Clone, Serialize, Deserialize, JsonSchema)]
pub struct IssuedApiKey {
    /// Secret, to be sent as `Authorization: Bearer …`; it cannot be shown again.
    pub secret: String,
    /// The key.
    pub key: ApiKeyView,
}

impl std::fmt::Debug for IssuedApiKey {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("IssuedApiKey").field("key", &self.key).finish_non_exhaustive()
    }
}

/// Response of `GET /v1/keys`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct ApiKeyList {
    /// Every key, newest first.
    pub keys: Vec<ApiKeyView>,
}
