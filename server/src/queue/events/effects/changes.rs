//! Writes the changes of jobs that are no events of theirs, for followers of all jobs.

use super::outbox::EventSource;
use crate::db;
use crate::queue::{Connection, Result};

/// Writes that a job has changed, or was deleted.
pub(super) async fn insert(connection: &mut Connection, job: &EventSource, is_deleted: bool) -> Result<()> {
    db::query("INSERT INTO job_change (job, id, submitter, deleted) VALUES (?, ?, ?, ?)")
        .bind(job.job)
        .bind(&job.id)
        .bind(&job.submitter)
        .bind(is_deleted)
        .execute(connection)
        .await?;
    Ok(())
}
