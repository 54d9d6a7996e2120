//! Jobs, as the HTTP API returns them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::JobId;
use crate::sketch::Estimate;

/// Lifecycle of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// Accepted; no tile has been leased yet.
    Queued,
    /// Some tile has been leased.
    Running,
    /// Every frame is stored.
    Succeeded,
    /// A tile could not be rendered.
    Failed,
    /// Stopped by a user.
    Cancelled,
}

impl JobState {
    /// Every state, in the order a job passes through them.
    pub const ALL: [Self; 5] = [Self::Queued, Self::Running, Self::Succeeded, Self::Failed, Self::Cancelled];

    /// Whether the state is final.
    pub fn is_final(self) -> bool {
        match self {
            Self::Queued | Self::Running => false,
            Self::Succeeded | Self::Failed | Self::Cancelled => true,
        }
    }

    /// The name used in JSON and in the database.
    pub fn name(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Succeeded => "succeeded",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }
}

/// Done and total of something counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Count {
    /// Finished.
    pub done: u64,
    /// In all.
    pub total: u64,
}

/// Job, as `GET /v1/jobs/{id}` returns it.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct JobView {
    /// Its id.
    pub id: JobId,
    /// The name its author gave it.
    pub name: String,
    /// State.
    pub state: JobState,
    /// No tiles of it are leased until it is resumed; leased tiles finish and count.
    #[serde(default)]
    pub paused: bool,
    /// Fraction of its rays that are rendered, 0 to 1; never decreases.
    pub progress: f64,
    /// Tiles of all frames.
    pub tiles: Count,
    /// Frames; one is done when its picture is stored.
    pub frames: Count,
    /// Error messages.
    pub errors: Vec<String>,
    /// Warnings for its author; the job renders all the same.
    pub warnings: Vec<String>,
    /// Time of acceptance: RFC 3339, UTC.
    pub created_at: String,
    /// Time at which its first tile was leased.
    pub started_at: Option<String>,
    /// Time at which it reached a final state.
    pub finished_at: Option<String>,
    /// Seconds until it should be finished; null where unknown.
    pub eta_seconds: Option<f64>,
}

/// A page of jobs, newest first.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct JobPage {
    /// The jobs.
    pub jobs: Vec<JobView>,
    /// `cursor` of the next page; null on the last.
    pub next_cursor: Option<String>,
}

/// Response to `POST /v1/jobs?dry_run=true`: the job is valid.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct DryRun {
    /// Always true: an unsound job is answered with a problem.
    pub valid: bool,
    /// Tiles it would be cut into.
    pub tiles: u64,
    /// Frames it would store.
    pub frames: u64,
    /// Camera rays it would trace.
    pub rays: u64,
    /// Estimated cost; null if it could not be measured.
    #[serde(default)]
    pub estimate: Option<Estimate>,
    /// Warnings for its author; the job would render all the same.
    pub warnings: Vec<String>,
}
