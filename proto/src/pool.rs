//! Workers and the local pool, as the HTTP API returns them.

use std::fmt;

use schemars::JsonSchema;
use serde::de::{Error, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use crate::{JobId, WorkerId};

/// Maximum number of workers in the local pool.
pub const MAX_POOL_WORKERS: u32 = 256;

/// Lifecycle of a worker. `quarantined` workers get no work until they are released or restarted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum WorkerState {
    /// Registered and running its self-test.
    Starting,
    /// Takes work.
    Ready,
    /// Finishes its leased tiles and gets no more.
    Draining,
    /// Exited or lost.
    Gone,
    /// Failed its self-test, failed too often, or was put aside by an administrator.
    Quarantined,
}

/// Worker, as `GET /v1/workers` returns it.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct WorkerView {
    /// Its id, new at every start.
    pub id: WorkerId,
    /// Its label.
    pub name: String,
    /// Device: `cpu` or `cuda:0`.
    pub device: String,
    /// State.
    pub state: WorkerState,
    /// Measured camera rays a second; null before its first tile.
    pub rays_per_second: Option<f64>,
    /// Number of its leases.
    pub leases: u64,
    /// Whether the server runs it itself, on its own machine.
    #[serde(default)]
    pub pool: bool,
    /// Time of its start, RFC 3339 in UTC.
    #[serde(default)]
    pub registered_at: String,
    /// Time of its last request, RFC 3339 in UTC; a worker that waits for work is silent for up to 30 s.
    #[serde(default)]
    pub last_seen_at: String,
    /// Whether it gets no work until it is released.
    #[serde(default)]
    pub quarantined: bool,
    /// Whether it gets no more work, and exits when it has finished what it holds.
    #[serde(default)]
    pub draining: bool,
    /// Number of tiles that failed on it since its start.
    #[serde(default)]
    pub errors: u64,
    /// Message of its last error.
    #[serde(default)]
    pub last_error: Option<String>,
    /// Tiles that it holds, by job and frame.
    #[serde(default)]
    pub holds: Vec<WorkerHold>,
}

/// Tiles of a frame that a worker holds.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct WorkerHold {
    /// The job.
    pub job: JobId,
    /// The job's name.
    pub name: String,
    /// The frame.
    pub frame: u32,
    /// Number of tiles; the joining of a frame's tiles to a picture counts as one.
    pub tiles: u64,
}

/// Response of `GET /v1/workers`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct WorkerList {
    /// Every worker that is not gone.
    pub workers: Vec<WorkerView>,
}

/// The body of `PUT /v1/pool`.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PoolSize {
    /// Target number of workers, 0 to 256.
    #[schemars(range(max = MAX_POOL_WORKERS))]
    #[serde(deserialize_with = "worker_count")]
    pub workers: u32,
}

/// Parses a number of workers; any other value gets an error with the range.
fn worker_count<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    deserializer.deserialize_u64(WorkerCountVisitor)
}

struct WorkerCountVisitor;

impl Visitor<'_> for WorkerCountVisitor {
    type Value = u32;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a whole number from 0 to {MAX_POOL_WORKERS}")
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<u32, E> {
        let workers = u32::try_from(value).ok().filter(|workers| *workers <= MAX_POOL_WORKERS);
        workers.ok_or_else(|| E::invalid_value(Unexpected::Unsigned(value), &self))
    }
}

/// The local pool.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct PoolView {
    /// Target number of workers.
    pub workers: u32,
    /// Workers that take work.
    pub ready: u32,
}
