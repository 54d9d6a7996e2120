//! Counts of work and workers for operators, read through indexes only.
//!
//! Counting changes nothing, and no decision depends on it.

use crate::db;
use crate::queue::{Queue, Result};

/// Jobs by state; the index covers the query.
const JOBS_SQL: &str = "SELECT state, count(*) AS number FROM job GROUP BY state";

/// Remaining work of unfinished jobs.
const UNFINISHED_SQL: &str = "SELECT count(*) AS jobs, min(created_at_ms) AS oldest_ms,
        CAST(coalesce(sum(tiles_total - tiles_done), 0) AS BIGINT) AS tiles, CAST(coalesce(sum(tiles_done), 0) AS BIGINT) AS tiles_done,
        CAST(coalesce(sum(rays_total - rays_done), 0) AS BIGINT) AS rays
     FROM job WHERE finished_at_ms IS NULL";

/// Oldest job without any lease so far.
const OLDEST_QUEUED_SQL: &str = "SELECT created_at_ms FROM job WHERE state = 'queued' ORDER BY number LIMIT 1";

/// Tiles and stitches that are ready.
const READY_SQL: &str = "SELECT count(*) FROM tile WHERE state = 'ready'";

/// Live leases.
const LEASED_SQL: &str = "SELECT count(*) FROM lease WHERE ended IS NULL";

/// Workers that are not gone, by state and device.
const WORKERS_SQL: &str =
    "SELECT state, device, count(*) AS number, coalesce(sum(rays_per_second), 0.0) AS rays_per_second
     FROM worker WHERE state <> 'gone' GROUP BY state, device";

/// All statements of this file, for a test that checks their query plans.
#[cfg(test)]
pub(in crate::queue) const STATEMENTS: [&str; 6] =
    [JOBS_SQL, UNFINISHED_SQL, OLDEST_QUEUED_SQL, READY_SQL, LEASED_SQL, WORKERS_SQL];

/// Workers of one state and device.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct WorkerCount {
    /// Their state.
    pub(crate) state: String,
    /// Device they render on.
    pub(crate) device: String,
    /// Number of workers.
    pub(crate) number: i64,
    /// Sum of their measured camera rays per second.
    pub(crate) rays_per_second: f64,
}

/// Counts of work and workers.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct QueueStats {
    /// Jobs by state.
    pub(crate) jobs: Vec<(String, i64)>,
    /// Number of unfinished jobs.
    pub(crate) unfinished: i64,
    /// Age of the oldest of them, in seconds.
    pub(crate) oldest_seconds: f64,
    /// Age of the oldest job without any lease so far, in seconds.
    pub(crate) oldest_queued_seconds: f64,
    /// Tiles of unfinished jobs that are not done.
    pub(crate) tiles_left: i64,
    /// Tiles of unfinished jobs that are done.
    pub(crate) tiles_done: i64,
    /// Tiles and stitches that are ready.
    pub(crate) tiles_ready: i64,
    /// Live leases.
    pub(crate) leases: i64,
    /// Camera rays of unfinished jobs that are not rendered.
    pub(crate) rays_left: i64,
    /// Workers that are not gone.
    pub(crate) workers: Vec<WorkerCount>,
}

impl QueueStats {
    /// Camera rays per second of the ready workers.
    pub(crate) fn rays_per_second(&self) -> f64 {
        self.workers.iter().filter(|workers| workers.state == "ready").map(|workers| workers.rays_per_second).sum()
    }

    /// Seconds of work in the queue, at the speed of the ready workers; infinite if no speed is known.
    pub(crate) fn work_seconds(&self) -> f64 {
        if self.rays_left == 0 { 0.0 } else { self.rays_left as f64 / self.rays_per_second() }
    }

    /// Number of jobs in a state.
    pub(crate) fn jobs_in(&self, state: &str) -> i64 {
        self.jobs.iter().find(|(name, _)| name == state).map_or(0, |(_, number)| *number)
    }
}

impl Queue {
    /// Counts work and workers.
    pub(crate) async fn counts(&self) -> Result<QueueStats> {
        let readers = self.readers();
        let age_seconds = |created_at_ms: Option<i64>| {
            created_at_ms.map_or(0.0, |then_ms| (self.clock.wall_ms() - then_ms).max(0) as f64 / 1e3)
        };
        let jobs = db::query(JOBS_SQL).fetch_all(readers).await?;
        let left = db::query(UNFINISHED_SQL).fetch_one(readers).await?;
        let oldest_queued: Option<i64> = db::query_scalar(OLDEST_QUEUED_SQL).fetch_optional(readers).await?;
        let workers = db::query(WORKERS_SQL).fetch_all(readers).await?;
        Ok(QueueStats {
            jobs: jobs.iter().map(|row| Ok((row.get("state")?, row.get("number")?))).collect::<Result<Vec<_>>>()?,
            unfinished: left.get("jobs")?,
            oldest_seconds: age_seconds(left.get("oldest_ms")?),
            oldest_queued_seconds: age_seconds(oldest_queued),
            tiles_left: left.get("tiles")?,
            tiles_done: left.get("tiles_done")?,
            tiles_ready: db::query_scalar(READY_SQL).fetch_one(readers).await?,
            leases: db::query_scalar(LEASED_SQL).fetch_one(readers).await?,
            rays_left: left.get("rays")?,
            workers: workers
                .iter()
                .map(|row| {
                    Ok(WorkerCount {
                        state: row.get("state")?,
                        device: row.get("device")?,
                        number: row.get("number")?,
                        rays_per_second: row.get("rays_per_second")?,
                    })
                })
                .collect::<Result<Vec<_>>>()?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn counting_reads_indexes() {
        if crate::postgres_server::server().is_some() {
            return;
        }
        let folder = tempfile::tempdir().expect("a temporary folder");
        let store = db::Database::open(folder.path()).await.expect("opens");
        for statement in STATEMENTS {
            let explain = db::made_query(format!("EXPLAIN QUERY PLAN {statement}"));
            let rows = explain.fetch_all(store.readers()).await.expect("explains");
            for row in rows {
                let step: String = row.get("detail").expect("a text");
                let is_indexed = step.contains("INDEX") || step.contains("TEMP B-TREE");
                assert!(is_indexed, "{step} in {statement}");
            }
        }
        store.close().await;
    }

    #[test]
    fn work_without_workers_takes_infinite_time() {
        let idle = QueueStats::default();
        assert_eq!(idle.work_seconds(), 0.0);
        assert!(QueueStats { rays_left: 5, ..idle }.work_seconds().is_infinite());
    }
}
