//! Unfinished work of each submitter: the counters that quotas are checked against, kept by database
//! triggers.

use proto::JobId;

use super::{Queue, Result};

/// Number of unfinished jobs, and of their rays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Backlog {
    /// Jobs.
    pub(crate) jobs: i64,
    /// Camera rays of those jobs, rendered or not.
    pub(crate) rays: i64,
}

/// Row with the totals of all submitters; no key has this name.
const ALL_SUBMITTERS: &str = "*";

impl Queue {
    /// Unfinished jobs and rays of a submitter.
    pub(crate) async fn backlog_of(&self, submitter: &str) -> Result<Backlog> {
        let row: Option<(i64, i64)> = sqlx::query_as("SELECT jobs, rays FROM backlog WHERE submitter = ?")
            .bind(submitter)
            .fetch_optional(self.readers())
            .await?;
        Ok(row.map_or_else(Backlog::default, |(jobs, rays)| Backlog { jobs, rays }))
    }

    /// Unfinished jobs and rays of all submitters.
    pub(crate) async fn backlog(&self) -> Result<Backlog> {
        self.backlog_of(ALL_SUBMITTERS).await
    }

    /// Submitter of a job; `None` if the job does not exist.
    pub(crate) async fn submitter(&self, job: JobId) -> Result<Option<String>> {
        let submitter = sqlx::query_scalar("SELECT submitter FROM job WHERE id = ?")
            .bind(job.to_string())
            .fetch_optional(self.readers())
            .await?;
        Ok(submitter)
    }
}
