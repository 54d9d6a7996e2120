//! Trace context of a job, so that all later work on the job belongs to its trace.
//!
//! No decision depends on a trace; without one, nothing else changes.

use proto::JobId;

use crate::db;
use crate::db::Durability;
use crate::queue::servers::recover;
use crate::queue::{Queue, Result, expect_rows};

impl Queue {
    /// Stores the trace context of a job that is about to be accepted.
    pub(crate) async fn keep_trace(&self, job: JobId, traceparent: String) -> Result<()> {
        self.database
            .write(Durability::Relaxed, move |connection| {
                Box::pin(async move {
                    let kept = db::query("INSERT INTO job_trace (job, traceparent) VALUES (?, ?)")
                        .bind(job.to_string())
                        .bind(traceparent)
                        .execute(connection)
                        .await?;
                    expect_rows("job_trace: stored", 1, kept)
                })
            })
            .await
    }

    /// Trace context of a job, if it has one.
    pub(crate) async fn trace_of(&self, job: JobId) -> Result<Option<String>> {
        db::query_scalar("SELECT traceparent FROM job_trace WHERE job = ?")
            .bind(job.to_string())
            .fetch_optional(self.readers())
            .await
    }

    /// Deletes trace contexts of jobs that finished, were deleted, or were never accepted, except recent ones;
    /// returns the number deleted.
    pub(crate) async fn drop_traces(&self) -> Result<u64> {
        let mut count = 0;
        loop {
            let limit = self.piece_rows;
            let dropped = self
                .database
                .write(Durability::Relaxed, move |connection| {
                    Box::pin(async move {
                        let dropped = db::query(
                            "DELETE FROM job_trace WHERE job IN (SELECT job FROM job_trace WHERE job < ? AND NOT EXISTS (
                                 SELECT 1 FROM job WHERE job.id = job_trace.job AND finished_at_ms IS NULL) LIMIT ?)",
                        )
                        .bind(recover::min_kept_id(uuid::Uuid::now_v7()))
                        .bind(limit)
                        .execute(connection)
                        .await?;
                        Ok(dropped.rows_affected())
                    })
                })
                .await?;
            count += dropped;
            if dropped < limit.unsigned_abs() {
                return Ok(count);
            }
        }
    }
}
