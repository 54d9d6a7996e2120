//! Result of a garbage collection.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::JobId;

/// Reason for a deletion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// It finished longer ago than its retention.
    Age,
    /// The store is larger than its limit, and the job is among those that finished first.
    Size,
}

impl Reason {
    /// The name used in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Age => "age",
            Self::Size => "size",
        }
    }
}

/// Deleted job.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct Collected {
    /// Its id.
    pub id: JobId,
    /// Its name.
    pub name: String,
    /// Time at which it reached its final state: RFC 3339, UTC.
    pub finished_at: String,
    /// Reason for its deletion.
    pub reason: Reason,
    /// Bytes of pictures that no other job shows.
    pub freed_bytes: u64,
}

/// Response to `POST /v1/gc`: the jobs that were deleted, or would be.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct Collection {
    /// Nothing was deleted; the response lists what would be.
    pub dry_run: bool,
    /// Bytes of pictures and tiles before.
    pub store_bytes: u64,
    /// The store's limit; null means no limit.
    pub max_store_bytes: Option<u64>,
    /// Bytes that the jobs' pictures take.
    pub freed_bytes: u64,
    /// The jobs, in the order of deletion.
    pub jobs: Vec<Collected>,
    /// More jobs may be past their retention: repeat the request.
    pub more: bool,
}
