//! Workers and the local pool as users see them over HTTP.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::WorkerId;

/// Most workers the local pool may hold.
pub const MAX_POOL_WORKERS: u32 = 256;

/// Where a worker stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum WorkerState {
    /// Registered, and testing itself.
    Starting,
    /// Takes work.
    Ready,
    /// Finishes what it holds and takes no more.
    Draining,
    /// Ended.
    Gone,
    /// Failed its test, or failed too often.
    Quarantined,
}

/// A worker, as `GET /v1/workers` shows it.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct WorkerView {
    /// Its id, new at every start.
    pub id: WorkerId,
    /// Its label.
    pub name: String,
    /// What it renders on: `cpu` or `cuda:0`.
    pub device: String,
    /// Where it stands.
    pub state: WorkerState,
    /// Measured camera rays a second; null before its first tile.
    pub rays_per_second: Option<f64>,
    /// Leases it holds.
    pub leases: u64,
}

/// The answer of `GET /v1/workers`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct WorkerList {
    /// Every worker that is not gone.
    pub workers: Vec<WorkerView>,
}

/// The body of `PUT /v1/pool`.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PoolSize {
    /// Workers wanted, 0 to 256.
    #[schemars(range(max = MAX_POOL_WORKERS))]
    pub workers: u32,
}

/// The local pool.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct PoolView {
    /// Workers wanted.
    pub workers: u32,
    /// Workers that take work.
    pub ready: u32,
}
