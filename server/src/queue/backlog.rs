//! Unfinished work of each submitter: the counters that quotas are checked against, kept by database
//! triggers.

use proto::JobId;

use super::{Connection, Queue, Result};

/// Number of unfinished jobs, and of their rays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Backlog {
    /// Jobs.
    pub(crate) jobs: i64,
    /// Camera rays of those jobs, rendered or not.
    pub(crate) rays: i64,
}

/// Maximum unfinished work; `None` means no limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct BacklogLimits {
    /// Unfinished jobs of all submitters.
    pub(crate) farm_jobs: Option<i64>,
    /// Unfinished jobs of the submitter.
    pub(crate) jobs: Option<i64>,
    /// Camera rays of the submitter's unfinished jobs.
    pub(crate) rays: Option<i64>,
}

/// Limit that another job would exceed, with its value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ExceededLimit {
    /// Unfinished jobs of all submitters.
    FarmJobs(i64),
    /// Unfinished jobs of the submitter.
    Jobs(i64),
    /// Camera rays of the submitter's unfinished jobs.
    Rays(i64),
}

impl BacklogLimits {
    /// The limit that one more job with this many rays would exceed.
    fn exceeded(self, farm: Backlog, own: Backlog, rays: u64) -> Option<ExceededLimit> {
        let above = |limit: Option<i64>, wanted: i64| limit.filter(|limit| wanted > *limit);
        above(self.farm_jobs, farm.jobs.saturating_add(1))
            .map(ExceededLimit::FarmJobs)
            .or_else(|| above(self.jobs, own.jobs.saturating_add(1)).map(ExceededLimit::Jobs))
            .or_else(|| above(self.rays, own.rays.saturating_add_unsigned(rays)).map(ExceededLimit::Rays))
    }

    /// The limit that one more job of this submitter would exceed, as the transaction of `connection` sees it.
    pub(super) async fn find_exceeded(
        self,
        connection: &mut Connection,
        submitter: &str,
        rays: u64,
    ) -> Result<Option<ExceededLimit>> {
        if self == Self::default() {
            return Ok(None);
        }
        let farm = read(&mut *connection, ALL_SUBMITTERS).await?;
        let own = read(connection, submitter).await?;
        Ok(self.exceeded(farm, own, rays))
    }
}

/// Row with the totals of all submitters; no key has this name.
const ALL_SUBMITTERS: &str = "*";

async fn read(executor: impl sqlx::SqliteExecutor<'_>, submitter: &str) -> Result<Backlog> {
    let row: Option<(i64, i64)> = sqlx::query_as("SELECT jobs, rays FROM backlog WHERE submitter = ?")
        .bind(submitter)
        .fetch_optional(executor)
        .await?;
    Ok(row.map_or_else(Backlog::default, |(jobs, rays)| Backlog { jobs, rays }))
}

impl Queue {
    /// The limit that one more job of this submitter would exceed now. Only the transaction that accepts the
    /// job decides; this saves reading a body that it would reject.
    pub(crate) async fn exceeded_limit(
        &self,
        limits: BacklogLimits,
        submitter: &str,
        rays: u64,
    ) -> Result<Option<ExceededLimit>> {
        let (farm, own) = (read(self.readers(), ALL_SUBMITTERS).await?, read(self.readers(), submitter).await?);
        Ok(limits.exceeded(farm, own, rays))
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
