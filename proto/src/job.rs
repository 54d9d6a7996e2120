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
    /// Cancelled by a user.
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

/// Progress of something counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DoneOfTotal {
    /// Finished.
    pub done: u64,
    /// In total.
    pub total: u64,
}

/// Job, as `GET /v1/jobs/{id}` returns it.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct JobView {
    /// Its id.
    pub id: JobId,
    /// Name from the job file.
    pub name: String,
    /// Submitter: the name of a key, or `local` while the farm has no keys.
    #[serde(default)]
    pub submitter: String,
    /// Priority, from -100 to 100: jobs of higher priority are leased first.
    #[serde(default)]
    pub priority: i32,
    /// State.
    pub state: JobState,
    /// Paused: no tiles are leased until the job is resumed; leased tiles finish and count.
    #[serde(default)]
    pub paused: bool,
    /// Fraction of its rays that are rendered, 0 to 1; never decreases.
    pub progress: f64,
    /// Tiles of all frames.
    pub tiles: DoneOfTotal,
    /// Frames; one is done when its picture is stored.
    pub frames: DoneOfTotal,
    /// Whether its tiles are kept with it, so that another job may be based on it.
    #[serde(default)]
    pub recorded: bool,
    /// The job that it is based on.
    #[serde(default)]
    pub based_on: Option<JobId>,
    /// Tiles that kept the pixels of the job that it is based on.
    #[serde(default)]
    pub tiles_kept: u64,
    /// Its place in the queue by priority and age, or by where it was moved, from 1: jobs of one submitter are rendered in this order,
    /// and submitters of equal priority take turns. Null for jobs that are paused or finished, and beyond the first 200.
    #[serde(default)]
    pub queue_position: Option<u32>,
    /// Error messages.
    pub errors: Vec<String>,
    /// Warnings for the author; the job renders all the same.
    pub warnings: Vec<String>,
    /// Time of acceptance: RFC 3339, UTC.
    pub created_at: String,
    /// Time at which its first tile was leased.
    pub started_at: Option<String>,
    /// Time at which it reached a final state.
    pub finished_at: Option<String>,
    /// Estimated seconds until it finishes; null if unknown.
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
    /// Always true: the response to an invalid job is a problem.
    pub valid: bool,
    /// Tiles in all frames.
    pub tiles: u64,
    /// Number of frames.
    pub frames: u64,
    /// Camera rays of all frames.
    pub rays: u64,
    /// Estimated cost; null if it could not be measured.
    #[serde(default)]
    pub estimate: Option<Estimate>,
    /// Warnings for the author; the job would render all the same.
    pub warnings: Vec<String>,
}

/// The body of `PATCH /v1/jobs/{id}`: absent members do not change.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JobPatch {
    /// Jobs of higher priority are leased first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -100, max = 100))]
    pub priority: Option<i32>,
}

/// The body of `POST /v1/jobs/{id}/move`: one of the members.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JobMove {
    /// Right before this job, with its priority.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub before: Option<JobId>,
    /// Right after this job, with its priority.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub after: Option<JobId>,
    /// Before all others, with the highest priority among them.
    #[serde(default, skip_serializing_if = "is_false")]
    pub first: bool,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_false(value: &bool) -> bool {
    !value
}

/// Response to `DELETE /v1/jobs/{id}?dry_run=true`: what would be deleted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DeleteDryRun {
    /// Pictures that no other job uses.
    pub pictures: u64,
    /// Blobs of finished tiles that no other frame uses.
    pub blobs: u64,
    /// Bytes of those pictures and blobs.
    pub size_bytes: u64,
    /// Database rows: the job, its file, frames, tiles and events.
    pub rows: u64,
}
