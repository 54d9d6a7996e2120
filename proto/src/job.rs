//! Jobs, as the HTTP API returns them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::JobId;
use crate::preview_helper::Estimate;

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
pub struct DoneOfTotal {
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
    /// Submitter: the name of a key, or `local` while the farm has no keys.
    #[serde(default)]
    pub submitter: String,
    /// Priority, from -100 to 100: jobs of higher priority are leased first.
    #[serde(default)]
    pub priority: i32,
    /// State.
    pub state: JobState,
    /// No tiles of it are leased until it is resumed; leased tiles finish and count.
    #[serde(default)]
    pub paused: bool,
    /// Fraction of its rays that are rendered, 0 to 1; never decreases.
    pub progress: f64,
    /// Tiles of all frames.
    pub tiles: DoneOfTotal,
    /// Frames; one is done when its picture is stored.
    pub frames: DoneOfTotal,
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

/// The body of `PATCH /v1/jobs/{id}`: what is left out stays as it is.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JobPatch {
    /// Jobs of higher priority are leased first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -100, max = 100))]
    pub priority: Option<i32>,
}

/// Response to `DELETE /v1/jobs/{id}?dry_run=true`: what would be deleted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DeleteDryRun {
    /// Pictures that no other job shows.
    pub pictures: u64,
    /// Blobs of finished tiles that no other frame needs.
    pub blobs: u64,
    /// Bytes of those pictures and blobs.
    pub size_bytes: u64,
    /// Rows of the database: the job, its file, frames, tiles and events.
    pub rows: u64,
}
