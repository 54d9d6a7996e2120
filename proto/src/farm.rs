//! State of the farm, as the HTTP API returns it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// State of the farm, as `GET /v1/farm` returns it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct FarmView {
    /// No tiles are leased until the farm is resumed; leased tiles finish and count.
    pub paused: bool,
}

/// The farm at a glance, as `GET /` shows it to programs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct StartView {
    /// Always `sdfarm`.
    pub name: String,
    /// The release.
    pub version: String,
    /// Path of the API's description as a page.
    pub docs: String,
    /// Path of the OpenAPI document.
    pub openapi: String,
    /// Path of the JSON Schema of a job file.
    pub job_schema: String,
    /// Whether requests need a key.
    pub needs_key: bool,
    /// The farm's numbers; null where requests need a key.
    pub farm: Option<FarmCounts>,
}

/// Numbers of a farm, at most a second old.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct FarmCounts {
    /// Whether the farm is paused.
    pub paused: bool,
    /// Jobs of which nothing was leased.
    pub queued: u64,
    /// Jobs that run.
    pub running: u64,
    /// Jobs whose frames are all stored.
    pub succeeded: u64,
    /// Jobs with a tile that could not be rendered.
    pub failed: u64,
    /// Jobs that a user stopped.
    pub cancelled: u64,
    /// Workers that take work.
    pub workers_ready: u64,
}
