//! Finished jobs past their retention: found by index, oldest first, and deleted in pieces like any job.
//!
//! Deletes only rows. The sweep deletes unreferenced bytes afterwards, so that a kill between the two leaves
//! bytes without a row, which the next sweep finds, and never a row without bytes.

use db::Row;
use proto::{JobId, Retention};

use crate::db;
use crate::db::Durability;
use crate::queue::jobs::cleanup::{self, RemovedContent};
use crate::queue::{Connection, Queue, Result, TransitionContext, json_numbers, parse_column};

/// `job.keep_ms` of a job that is kept forever.
const FOREVER: i64 = -1;

/// Jobs past their own retention.
const OVER_SQL: &str = "SELECT number, id, name, finished_at_ms, keep_ms FROM job @index(job_by_own_end)
     WHERE finished_at_ms IS NOT NULL AND keep_ms >= 0 AND finished_at_ms + keep_ms <= ? AND cleanup IS DISTINCT FROM 'delete'
     ORDER BY finished_at_ms + keep_ms LIMIT ?";

/// Jobs without a retention of their own that finished before the given time.
const OLD_SQL: &str = "SELECT number, id, name, finished_at_ms, keep_ms FROM job @index(job_by_finish)
     WHERE finished_at_ms IS NOT NULL AND keep_ms IS NULL AND finished_at_ms <= ? AND cleanup IS DISTINCT FROM 'delete'
     ORDER BY finished_at_ms LIMIT ?";

/// Jobs that may be deleted for the store's size, oldest first.
const OLDEST_SQL: &str = "SELECT number, id, name, finished_at_ms, keep_ms FROM job @index(job_not_for_ever)
     WHERE finished_at_ms IS NOT NULL AND (keep_ms IS NULL OR keep_ms >= 0)
       AND (finished_at_ms, number) > (?, ?) AND cleanup IS DISTINCT FROM 'delete'
     ORDER BY finished_at_ms, number LIMIT ?";

/// Bytes of pictures that only this job and the listed jobs use.
const FREED_SQL: &str = "SELECT CAST(coalesce(sum(size_bytes), 0) AS BIGINT) FROM (
         SELECT DISTINCT picture, size_bytes FROM frame AS own
         WHERE own.job = ?1 AND own.picture IS NOT NULL AND NOT EXISTS (
             SELECT 1 FROM frame AS other WHERE other.picture = own.picture AND other.picture IS NOT NULL
             AND other.job <> ?1 AND other.job NOT IN (SELECT value FROM @numbers(?2)))) AS alone";

/// Finished job, as read from the database.
#[derive(Clone, Debug)]
pub(crate) struct FinishedJob {
    /// Its number.
    pub(crate) number: i64,
    /// Its id.
    pub(crate) id: JobId,
    /// Its name.
    pub(crate) name: String,
    /// Time at which it finished, by the wall clock.
    pub(crate) finished_at_ms: i64,
    keep_ms: Option<i64>,
}

/// Stores a job's retention.
pub(in crate::queue) async fn keep(connection: &mut Connection, job: i64, keep: Retention) -> Result<()> {
    let keep_ms = match keep {
        Retention::Forever => FOREVER,
        Retention::For(time) => i64::try_from(time.as_millis()).unwrap_or(FOREVER),
    };
    let kept =
        db::query("UPDATE job SET keep_ms = ? WHERE number = ?").bind(keep_ms).bind(job).execute(connection).await?;
    crate::queue::expect_rows("job: retention stored", 1, kept)
}

fn read(row: &Row) -> Result<FinishedJob> {
    let id: String = row.get("id")?;
    Ok(FinishedJob {
        number: row.get("number")?,
        id: parse_column("job.id", &id, |id| id.parse().ok())?,
        name: row.get("name")?,
        finished_at_ms: row.get("finished_at_ms")?,
        keep_ms: row.get("keep_ms")?,
    })
}

impl Queue {
    /// Jobs past their retention: their own, or the server's default for jobs without one. At most
    /// `limit` of each.
    pub(crate) async fn expired_jobs(&self, kept_ms: Option<i64>, limit: u32) -> Result<Vec<FinishedJob>> {
        let wall_ms = self.clock.wall_ms();
        let mut rows = db::query(OVER_SQL).bind(wall_ms).bind(limit).fetch_all(self.readers()).await?;
        if let Some(kept_ms) = kept_ms {
            let before_ms = wall_ms.saturating_sub(kept_ms);
            rows.extend(db::query(OLD_SQL).bind(before_ms).bind(limit).fetch_all(self.readers()).await?);
        }
        rows.iter().map(read).collect()
    }

    /// Finished jobs not kept forever, from the oldest; only those after `after` if given.
    pub(crate) async fn oldest_jobs(&self, after: Option<&FinishedJob>, limit: u32) -> Result<Vec<FinishedJob>> {
        let (finished_at_ms, number) = after.map_or((i64::MIN, i64::MIN), |job| (job.finished_at_ms, job.number));
        let query = db::query(OLDEST_SQL).bind(finished_at_ms).bind(number).bind(limit);
        query.fetch_all(self.readers()).await?.iter().map(read).collect()
    }

    /// Bytes of a job's pictures that no job uses once it and the jobs `gone` are deleted.
    pub(crate) async fn freed_bytes(&self, job: &FinishedJob, gone: &[i64]) -> Result<u64> {
        let query = db::query_scalar(FREED_SQL).bind(job.number).bind(json_numbers(gone.iter().copied()));
        query.fetch_one(self.readers()).await
    }

    /// Deletes a job if it has not changed since it was read; `None` if it has.
    pub(crate) async fn remove(&self, job: &FinishedJob) -> Result<Option<RemovedContent>> {
        let (job, context) = (job.clone(), self.context());
        let removed = self
            .database
            .write(Durability::Full, move |connection| Box::pin(async move { remove(connection, &job, context).await }))
            .await?;
        self.wake_signals.cleanup.notify_one();
        Ok(removed)
    }
}

async fn remove(
    connection: &mut Connection,
    job: &FinishedJob,
    context: TransitionContext,
) -> Result<Option<RemovedContent>> {
    let same: Option<i64> = db::query_scalar(
        "SELECT number FROM job
         WHERE number = ? AND finished_at_ms = ? AND keep_ms IS NOT DISTINCT FROM ? AND cleanup IS DISTINCT FROM 'delete'",
    )
    .bind(job.number)
    .bind(job.finished_at_ms)
    .bind(job.keep_ms)
    .fetch_optional(&mut *connection)
    .await?;
    let Some(number) = same else { return Ok(None) };
    cleanup::mark_deleted(connection, number).await?;
    cleanup::piece(connection, number, context).await.map(Some)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::Clock;
    use crate::db::Database;

    #[tokio::test]
    async fn retention_queries_need_no_full_table_scan() {
        if crate::postgres_server::server().is_some() {
            return;
        }
        let folder = tempfile::tempdir().expect("a temporary folder");
        let store = Database::open(folder.path()).await.expect("opens");
        let (queue, _) = Queue::open(store.into(), Clock::manual().0, 1000, "test").await.expect("opens");
        for statement in [OVER_SQL, OLD_SQL, OLDEST_SQL, FREED_SQL] {
            let plan = format!("EXPLAIN QUERY PLAN {statement}");
            let rows = db::made_query(plan).fetch_all(queue.readers()).await.expect("explains");
            for row in rows {
                let step: String = row.get("detail").expect("a text");
                let reads = ["SCAN job", "SCAN frame", "SCAN tile", "SCAN own", "SCAN other", "TEMP B-TREE FOR ORDER"];
                let ordered = step.contains("USING INDEX job_not_for_ever");
                assert!(ordered || !reads.iter().any(|word| step.contains(word)), "{step} in {statement}");
            }
        }
    }
}
