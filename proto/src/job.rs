//! Jobs as users see them over HTTP.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::JobId;
use crate::sketch::Estimate;

/// Where a job stands.
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

    /// Nothing will change any more.
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

/// So many done of so many.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Count {
    /// Finished.
    pub done: u64,
    /// In all.
    pub total: u64,
}

/// A job, as `GET /v1/jobs/{id}` shows it.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct JobView {
    /// Its id.
    pub id: JobId,
    /// The name its author gave it.
    pub name: String,
    /// Who submitted it: the name of a key, or `local` while the farm has none.
    #[serde(default)]
    pub submitter: String,
    /// Its priority, from -100 to 100: higher goes first.
    #[serde(default)]
    pub priority: i32,
    /// Where it stands.
    pub state: JobState,
    /// Nothing of it is leased until it is resumed; what is leased already goes on.
    #[serde(default)]
    pub paused: bool,
    /// Share of its rays that are rendered, 0 to 1; never falls.
    pub progress: f64,
    /// Tiles of all frames.
    pub tiles: Count,
    /// Frames; one is done when its picture is stored.
    pub frames: Count,
    /// What went wrong, in words.
    pub errors: Vec<String>,
    /// What its author should know although it renders.
    pub warnings: Vec<String>,
    /// When it was accepted: RFC 3339, UTC.
    pub created_at: String,
    /// When its first tile was leased.
    pub started_at: Option<String>,
    /// When it reached a final state.
    pub finished_at: Option<String>,
    /// Seconds until it should be finished; null where unknown.
    pub eta_seconds: Option<f64>,
}

/// A page of jobs, newest first.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct JobPage {
    /// The jobs.
    pub jobs: Vec<JobView>,
    /// What to pass as `cursor` for the next page; null on the last.
    pub next_cursor: Option<String>,
}

/// The answer to `POST /v1/jobs?dry_run=true`: the job is sound.
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
    /// What it would take; null if that could not be found out.
    #[serde(default)]
    pub estimate: Option<Estimate>,
    /// What its author should know although it would render.
    pub warnings: Vec<String>,
}
