//! The sender of a request, as the server sees it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::api_key::Scope;

/// Response of `GET /v1/caller`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct CallerView {
    /// Whether requests need a key.
    pub needs_key: bool,
    /// Name under which the caller submits jobs; null if a key is needed and none was sent.
    pub name: Option<String>,
    /// The scope of the key that allows most: `admin`, then `submit`, `read` and `worker`. Null without a key.
    pub scope: Option<Scope>,
    /// Every scope of the key; null without a key.
    pub scopes: Option<Vec<Scope>>,
    /// Whether the server refuses changes that browsers ask for.
    pub read_only: bool,
    /// Version of the server.
    pub version: String,
}
