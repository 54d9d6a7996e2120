//! Throughput of the farm over time, as the HTTP API returns it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Throughput in one step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HistoryPoint {
    /// Begin of the step, RFC 3339 in UTC.
    pub at: String,
    /// Camera rays of the tiles that were rendered in it.
    pub rays: u64,
    /// Tiles that were rendered in it.
    pub tiles: u64,
    /// Pictures that were made in it.
    pub frames: u64,
    /// Mean number of workers that take work.
    pub workers: f64,
    /// Part of them that had work, 0 to 1.
    pub busy: f64,
    /// Mean number of tiles of unfinished jobs that no worker has.
    pub queued_tiles: f64,
    /// Mean number of queued jobs.
    pub jobs_queued: f64,
    /// Mean number of running jobs.
    pub jobs_running: f64,
}

/// Response of `GET /v1/history`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HistoryView {
    /// Length of a step: whole minutes.
    pub step_seconds: u32,
    /// The steps up to the last full minute, oldest first; all are zero while no server runs.
    pub points: Vec<HistoryPoint>,
}
