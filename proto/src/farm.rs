//! State of the farm, as the HTTP API returns it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// State of the farm, as `GET /v1/farm` returns it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct FarmView {
    /// No tiles are leased until the farm is resumed; leased tiles finish and count.
    pub paused: bool,
    /// Disk of the server that was asked.
    pub disk: DiskView,
}

/// Disk of a server's data folder, and what the farm stores.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DiskView {
    /// Free space on the disk of the data folder.
    pub free_bytes: u64,
    /// Size of that disk.
    pub total_bytes: u64,
    /// Size of the stored pictures, at most 30 s old. Of a store in a bucket it is known once `/metrics` was read, and at
    /// most 10 min older than that; null before.
    pub pictures_bytes: Option<u64>,
    /// Size of the stored tiles of frames that are not finished, likewise.
    pub blobs_bytes: Option<u64>,
}

/// Summary of the farm, as `GET /` returns it to programs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct StartView {
    /// Always `sdfarm`.
    pub name: String,
    /// Version of the server.
    pub version: String,
    /// Path of the API's documentation page.
    pub docs: String,
    /// Path of the `OpenAPI` document.
    pub openapi: String,
    /// Path of the JSON Schema of a job file.
    pub job_schema: String,
    /// Whether requests need a key.
    pub needs_key: bool,
    /// The farm's numbers; null if requests need a key.
    pub farm: Option<FarmCounts>,
}

/// Numbers of a farm, at most 1 s old.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct FarmCounts {
    /// Whether the farm is paused.
    pub paused: bool,
    /// Jobs without a leased tile so far.
    pub queued: u64,
    /// Jobs in progress.
    pub running: u64,
    /// Jobs whose frames are all stored.
    pub succeeded: u64,
    /// Failed jobs: a tile could not be rendered.
    pub failed: u64,
    /// Jobs that a user cancelled.
    pub cancelled: u64,
    /// Workers that take work.
    pub workers_ready: u64,
}
