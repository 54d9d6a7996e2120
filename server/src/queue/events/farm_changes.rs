//! Jobs that have changed since a position, for followers of all jobs. Events have most changes; those that
//! are no events of a job, of its priority or pause and its deletion, have rows of their own.
//!
//! Only `effects` writes these rows, in the transaction of the change.

use std::collections::BTreeSet;

use proto::job::JobView;

use crate::db::{self, Durability};
use crate::queue::jobs::{jobs_where, read_job};
use crate::queue::{Connection, Queue, Result, json_numbers};

/// Number of rows that are read at a time.
const MAX_ROWS: u32 = 20_000;
/// Number of rows that are kept.
const KEPT_CHANGES: i64 = 10_000;

/// Events of a page, by job; the last row read is the position of the next page.
const EVENTS_SQL: &str = "SELECT job, max(number) AS number
     FROM (SELECT job, number FROM outbox WHERE number > ? ORDER BY number LIMIT ?) AS page GROUP BY job";

/// How far changes have been read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct ChangePosition {
    event: i64,
    change: i64,
}

/// A job that was deleted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct DeletedJob {
    /// The id that it had.
    pub(crate) id: String,
    /// Its submitter.
    pub(crate) submitter: String,
}

/// Changes after a position.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct FarmChanges {
    /// Position after them.
    pub(crate) position: ChangePosition,
    /// Numbers of the jobs that have changed.
    pub(crate) jobs: BTreeSet<i64>,
    /// Jobs that were deleted.
    pub(crate) deleted: Vec<DeletedJob>,
}

impl Queue {
    /// Position after all changes so far.
    pub(crate) async fn newest_change(&self) -> Result<ChangePosition> {
        let row = db::query(
            "SELECT coalesce((SELECT max(number) FROM outbox), 0) AS event,
                    coalesce((SELECT max(number) FROM job_change), 0) AS change",
        )
        .fetch_one(self.readers())
        .await?;
        Ok(ChangePosition { event: row.get("event")?, change: row.get("change")? })
    }

    /// Changes after a position. If there are very many, those that are left come after the position of the result.
    pub(crate) async fn changes_after(&self, after: ChangePosition) -> Result<FarmChanges> {
        let mut changes = FarmChanges { position: after, ..FarmChanges::default() };
        for row in db::query(EVENTS_SQL).bind(after.event).bind(MAX_ROWS).fetch_all(self.readers()).await? {
            changes.jobs.insert(row.get("job")?);
            changes.position.event = changes.position.event.max(row.get("number")?);
        }
        let rows = db::query(
            "SELECT number, job, id, submitter, deleted FROM job_change WHERE number > ? ORDER BY number LIMIT ?",
        )
        .bind(after.change)
        .bind(MAX_ROWS)
        .fetch_all(self.readers())
        .await?;
        for row in rows {
            changes.position.change = row.get("number")?;
            if row.get("deleted")? {
                changes.deleted.push(DeletedJob { id: row.get("id")?, submitter: row.get("submitter")? });
            } else {
                changes.jobs.insert(row.get("job")?);
            }
        }
        Ok(changes)
    }

    /// Views of jobs by their numbers, without those that do not exist any more.
    pub(crate) async fn jobs_numbered(&self, numbers: &BTreeSet<i64>) -> Result<Vec<JobView>> {
        if numbers.is_empty() {
            return Ok(Vec::new());
        }
        let rows = db::query(jobs_where!("number IN (SELECT value FROM @numbers(?)) ORDER BY number"))
            .bind(json_numbers(numbers.iter().copied()))
            .fetch_all(self.readers())
            .await?;
        let wall_ms = self.clock.wall_ms();
        rows.iter().map(|row| read_job(row, wall_ms)).collect()
    }

    /// Deletes the oldest rows beyond the number that is kept.
    pub(crate) async fn prune_changes(&self) -> Result<()> {
        self.database.write(Durability::Relaxed, move |connection| Box::pin(prune(connection, KEPT_CHANGES))).await
    }
}

async fn prune(connection: &mut Connection, keep: i64) -> Result<()> {
    db::query("DELETE FROM job_change WHERE number <= (SELECT max(number) FROM job_change) - ?")
        .bind(keep)
        .execute(connection)
        .await?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::queue::tests::Fixture;

    #[tokio::test]
    async fn the_oldest_changes_are_pruned_and_their_numbers_are_not_given_again() {
        let bench = Fixture::new().await;
        let id = bench.submit(1, 1).await;
        let start = bench.queue.newest_change().await.expect("reads");
        for paused in [true, false, true] {
            bench.queue.pause(id, paused, None).await.expect("changes");
        }
        let changes = bench.queue.changes_after(start).await.expect("reads");
        assert_eq!((changes.jobs.len(), changes.deleted.len()), (1, 0));
        assert_eq!(changes.position, bench.queue.newest_change().await.expect("reads"));
        let prune =
            |keep| bench.queue.database.write(Durability::Relaxed, move |connection| Box::pin(prune(connection, keep)));
        prune(1).await.expect("prunes");
        let left: i64 =
            db::query_scalar("SELECT count(*) FROM job_change").fetch_one(bench.queue.readers()).await.expect("reads");
        assert_eq!(left, 1);
        prune(0).await.expect("prunes");
        bench.queue.delete(id).await.expect("deletes");
        let changes = bench.queue.changes_after(changes.position).await.expect("reads");
        assert_eq!(changes.deleted, [DeletedJob { id: id.to_string(), submitter: "local".to_owned() }]);
        assert!(bench.queue.jobs_numbered(&[1].into()).await.expect("reads").is_empty());
    }
}
