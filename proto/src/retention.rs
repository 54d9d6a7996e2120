//! What a look for jobs that need not be kept found.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::JobId;

/// Why a job goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// It finished longer ago than it is to be kept.
    Age,
    /// The store is larger than it may be, and this is among the jobs that finished first.
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

/// A job that goes.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct Collected {
    /// Its id.
    pub id: JobId,
    /// Its name.
    pub name: String,
    /// When it reached its final state: RFC 3339, UTC.
    pub finished_at: String,
    /// Why it goes.
    pub reason: Reason,
    /// Bytes of pictures that no other job shows.
    pub freed_bytes: u64,
}

/// The answer to `POST /v1/gc`: what went, or would go.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct Collection {
    /// Nothing was removed; this is what would be.
    pub dry_run: bool,
    /// Bytes of pictures and tiles before.
    pub store_bytes: u64,
    /// What the store may have, as the server was told; null for no limit.
    pub max_store_bytes: Option<u64>,
    /// Bytes that the jobs' pictures take.
    pub freed_bytes: u64,
    /// The jobs, in the order in which they go.
    pub jobs: Vec<Collected>,
    /// There may be more that need not be kept: ask again.
    pub more: bool,
}
