//! Unfinished work of each submitter: the counters that quotas are checked against. `effects` keeps them.

use crate::db;
use proto::JobId;

use crate::queue::{Connection, Queue, Result};

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
    /// Whether the submitter leaves half of what others have left of the queue, so that no submitter can fill it.
    pub(crate) leaves_half: bool,
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
            .or_else(|| above(self.own_jobs(farm, own), own.jobs.saturating_add(1)).map(ExceededLimit::Jobs))
            .or_else(|| above(self.rays, own.rays.saturating_add_unsigned(rays)).map(ExceededLimit::Rays))
    }

    /// Maximum number of unfinished jobs of the submitter: half of what others have left, rounded up, if that is less.
    fn own_jobs(self, farm: Backlog, own: Backlog) -> Option<i64> {
        let Some(farm_jobs) = self.farm_jobs.filter(|_| self.leaves_half) else { return self.jobs };
        let half = (farm_jobs - (farm.jobs - own.jobs) + 1) / 2;
        Some(self.jobs.map_or(half, |jobs| jobs.min(half)))
    }

    /// The limit that one more job of this submitter would exceed, as the transaction of `connection` sees it.
    pub(in crate::queue) async fn find_exceeded(
        self,
        connection: &mut Connection,
        submitter: &str,
        rays: u64,
    ) -> Result<Option<ExceededLimit>> {
        if self == Self::default() {
            return Ok(None);
        }
        let (farm, own) = read(connection, submitter).await?;
        Ok(self.exceeded(farm, own, rays))
    }
}

/// Row with the totals of all submitters; no key has this name.
const ALL_SUBMITTERS: &str = "*";

/// Backlog of all submitters, and of one.
async fn read(on: impl Into<db::Target<'_>>, submitter: &str) -> Result<(Backlog, Backlog)> {
    let rows = db::query("SELECT submitter, jobs, rays FROM backlog WHERE submitter = ?1 OR submitter = ?2")
        .bind(ALL_SUBMITTERS)
        .bind(submitter)
        .fetch_all(on)
        .await?;
    let (mut farm, mut own) = (Backlog::default(), Backlog::default());
    for row in &rows {
        let backlog = Backlog { jobs: row.get("jobs")?, rays: row.get("rays")? };
        *(if row.get::<String>("submitter")? == ALL_SUBMITTERS { &mut farm } else { &mut own }) = backlog;
    }
    Ok((farm, own))
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
        let (farm, own) = read(self.readers(), submitter).await?;
        Ok(limits.exceeded(farm, own, rays))
    }

    /// Submitter of a job; `None` if the job does not exist.
    pub(crate) async fn submitter(&self, job: JobId) -> Result<Option<String>> {
        let submitter = db::query_scalar("SELECT submitter FROM job WHERE id = ?")
            .bind(job.to_string())
            .fetch_optional(self.readers())
            .await?;
        Ok(submitter)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_submitter_can_fill_the_queue() {
        let limits = BacklogLimits { farm_jobs: Some(100), jobs: Some(1000), rays: None, leaves_half: true };
        let mut farm = Backlog::default();
        let mut taken = Vec::new();
        for _ in 0..8 {
            let mut own = Backlog::default();
            while limits.exceeded(farm, own, 1).is_none() {
                own.jobs += 1;
                farm.jobs += 1;
            }
            taken.push(own.jobs);
        }
        // Each submitter leaves half, so that the next one has room as long as there is any.
        assert_eq!(taken, [50, 25, 13, 6, 3, 2, 1, 0]);
        let own = Backlog { jobs: 50, rays: 0 };
        let farm = Backlog { jobs: 50, rays: 0 };
        assert_eq!(limits.exceeded(farm, own, 1), Some(ExceededLimit::Jobs(50)));
        assert_eq!(BacklogLimits { leaves_half: false, ..limits }.exceeded(farm, own, 1), None);
        assert_eq!(BacklogLimits { jobs: Some(20), ..limits }.exceeded(farm, own, 1), Some(ExceededLimit::Jobs(20)));
    }
}
