//! Tiles of a job and their workers, as the HTTP API returns them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::WorkerId;

/// State of a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TileState {
    /// It waits for a worker.
    Ready,
    /// A worker has it.
    Leased,
    /// It is rendered.
    Done,
    /// It failed too often.
    Dead,
    /// It is not needed any more.
    Void,
}

/// How a lease of a tile ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TileOutcome {
    /// With the tile's result.
    Done,
    /// The renderer failed, or delivered something else.
    Failed,
    /// The worker crashed.
    Crashed,
    /// The worker vanished, or did not renew in time.
    Lost,
    /// The worker handed it back.
    Released,
    /// Its result was not needed any more: another worker was faster, or the job ended.
    Void,
}

/// Lease of a tile: one worker had it for a time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TileLeaseView {
    /// The worker.
    pub worker: WorkerId,
    /// The worker's label.
    pub worker_name: String,
    /// Device of the worker.
    pub device: String,
    /// Time at which it began, RFC 3339 in UTC.
    pub started_at: String,
    /// Time at which it ended, RFC 3339 in UTC; null while the worker has the tile.
    pub ended_at: Option<String>,
    /// How it ended; null while the worker has the tile.
    pub outcome: Option<TileOutcome>,
    /// Time that the worker used for the tile: of tiles that were delivered together, each has a share by its rays. Null
    /// without a result.
    pub seconds: Option<f64>,
}

/// Tile of a frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TileView {
    /// The frame.
    pub frame: u32,
    /// Left edge, in pixels.
    pub x: u32,
    /// Upper edge, in pixels.
    pub y: u32,
    /// Width, in pixels.
    pub width: u32,
    /// Height, in pixels.
    pub height: u32,
    /// State.
    pub state: TileState,
    /// Number of its leases so far.
    pub attempts: u64,
    /// Its leases of the last hour, those that have not ended, and the last one with a result, oldest first.
    pub leases: Vec<TileLeaseView>,
}

/// Response of `GET /v1/jobs/{id}/tiles`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct TilePage {
    /// Tiles of frames that have been opened, by frame and row.
    pub tiles: Vec<TileView>,
    /// Cursor of the next page; null on the last.
    pub next_cursor: Option<String>,
}
