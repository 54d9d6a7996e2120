//! End of a job by failure, cancelling or deleting, with the first piece of the cleanup.

use proto::JobId;
use proto::job::JobState;

use crate::db;
use crate::queue::jobs::cleanup::{self, RemovedContent};
use crate::queue::jobs::transitions;
use crate::queue::{Connection, Result, TransitionContext, expect_rows_in, parse_column};

/// Outcome of a cancel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum CancelOutcome {
    /// The job is cancelled; this content may be orphaned now.
    Done(RemovedContent),
    /// The job had finished already.
    AlreadyFinished(JobState),
    /// The job does not exist.
    Unknown,
}

/// Outcome of a delete.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum DeleteOutcome {
    /// The job is deleted, or hidden while it is; this content may be orphaned now.
    Done(RemovedContent),
    /// The job is running.
    Running,
    /// The job does not exist.
    Unknown,
}

/// Parses a job's state from the database.
pub(in crate::queue) fn job_state(name: &str) -> Result<JobState> {
    parse_column("job.state", name, |name| JobState::ALL.into_iter().find(|state| state.name() == name))
}

/// Fails the job of a dead tile.
pub(in crate::queue) async fn fail(
    connection: &mut Connection,
    job: i64,
    message: &str,
    context: TransitionContext,
) -> Result<()> {
    let is_failed = transitions::fail(connection, job, message, 1, context).await?;
    expect_rows_in("job: failed", 1, usize::from(is_failed))?;
    cleanup::piece(connection, job, context).await.map(drop)
}

/// Fails the job of a frame that cannot be opened, unless the job has finished.
pub(in crate::queue) async fn refuse(
    connection: &mut Connection,
    job: i64,
    message: &str,
    context: TransitionContext,
) -> Result<()> {
    transitions::fail(connection, job, message, 0, context).await?;
    cleanup::piece(connection, job, context).await.map(drop)
}

/// Cancels a job that has not finished.
pub(in crate::queue) async fn cancel(
    connection: &mut Connection,
    id: JobId,
    context: TransitionContext,
) -> Result<CancelOutcome> {
    if let Some(job) = transitions::cancel(connection, id, context).await? {
        return cleanup::piece(connection, job, context).await.map(CancelOutcome::Done);
    }
    let state: Option<String> =
        db::query_scalar("SELECT state FROM job WHERE id = ?").bind(id.to_string()).fetch_optional(connection).await?;
    state.map_or(Ok(CancelOutcome::Unknown), |name| job_state(&name).map(CancelOutcome::AlreadyFinished))
}

/// Deletes a job that is not running, with all its rows, and the pictures that only it used: the first piece of them
/// now.
pub(in crate::queue) async fn delete(
    connection: &mut Connection,
    id: JobId,
    context: TransitionContext,
) -> Result<DeleteOutcome> {
    let row = db::query("SELECT number, state FROM job WHERE id = ?")
        .bind(id.to_string())
        .fetch_optional(&mut *connection)
        .await?;
    let Some(row) = row else { return Ok(DeleteOutcome::Unknown) };
    if job_state(&row.get::<String>("state")?)? == JobState::Running {
        return Ok(DeleteOutcome::Running);
    }
    let job = row.get("number")?;
    cleanup::mark_deleted(connection, job).await?;
    cleanup::piece(connection, job, context).await.map(DeleteOutcome::Done)
}
