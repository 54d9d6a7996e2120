//! Progress and end of a job: its counters, success, failure, cancelling, deleting.

use proto::JobId;
use proto::job::JobState;

use super::cleanup::{self, RemovedContent};
use super::{Connection, Result, TransitionContext, expect_rows, parse_column};
use crate::db;
use crate::db::DatabaseError;

/// Increments of a job's counters.
#[derive(Clone, Copy, Debug)]
pub(super) struct ProgressDelta {
    /// Tiles done.
    pub(super) tiles: i64,
    /// Rays done.
    pub(super) rays: i64,
    /// Frames stored.
    pub(super) frames: i64,
}

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
pub(super) fn job_state(name: &str) -> Result<JobState> {
    parse_column("job.state", name, |name| JobState::ALL.into_iter().find(|state| state.name() == name))
}

/// Marks a job as running when its first lease is granted.
pub(super) async fn mark_started(connection: &mut Connection, job: i64, moment: TransitionContext) -> Result<()> {
    db::query("UPDATE job SET state = 'running', started_at_ms = ? WHERE number = ? AND state = 'queued'")
        .bind(moment.wall_ms)
        .bind(job)
        .execute(connection)
        .await?;
    Ok(())
}

/// Updates a job's counters; returns its number of finished tiles.
pub(super) async fn progress(connection: &mut Connection, job: i64, by: ProgressDelta) -> Result<i64> {
    let done: Option<i64> = db::query_scalar(
        "UPDATE job SET tiles_done = tiles_done + ?1, rays_done = rays_done + ?2, frames_stored = frames_stored + ?3,
                        rays_peak = @max(rays_peak, rays_done + ?2)
         WHERE number = ?4 RETURNING tiles_done",
    )
    .bind(by.tiles)
    .bind(by.rays)
    .bind(by.frames)
    .bind(job)
    .fetch_optional(connection)
    .await?;
    done.ok_or(DatabaseError::Rows { what: "job: counters", expected: 1, changed: 0 })
}

/// Marks a job as succeeded if all its frames are stored.
pub(super) async fn succeed_if_stored(connection: &mut Connection, job: i64, moment: TransitionContext) -> Result<()> {
    db::query(
        "UPDATE job SET state = 'succeeded', finished_at_ms = ?1, started_at_ms = coalesce(started_at_ms, ?1)
         WHERE number = ?2 AND frames_stored = frames_total AND finished_at_ms IS NULL",
    )
    .bind(moment.wall_ms)
    .bind(job)
    .execute(connection)
    .await?;
    Ok(())
}

/// Fails the job of a dead tile.
pub(super) async fn fail(
    connection: &mut Connection,
    job: i64,
    message: &str,
    moment: TransitionContext,
) -> Result<()> {
    let failed = db::query(
        "UPDATE job SET state = 'failed', error = ?, finished_at_ms = ?, tiles_dead = tiles_dead + 1, cleanup = 'void'
         WHERE number = ? AND finished_at_ms IS NULL",
    )
    .bind(message)
    .bind(moment.wall_ms)
    .bind(job)
    .execute(&mut *connection)
    .await?;
    expect_rows("job: failed", 1, failed)?;
    cleanup::piece(connection, job, moment).await.map(drop)
}

/// Fails the job of a frame that cannot be opened, unless the job has finished.
pub(super) async fn refuse(
    connection: &mut Connection,
    job: i64,
    message: &str,
    moment: TransitionContext,
) -> Result<()> {
    db::query(
        "UPDATE job SET state = 'failed', error = ?, finished_at_ms = ?, cleanup = 'void'
         WHERE number = ? AND finished_at_ms IS NULL",
    )
    .bind(message)
    .bind(moment.wall_ms)
    .bind(job)
    .execute(&mut *connection)
    .await?;
    cleanup::piece(connection, job, moment).await.map(drop)
}

/// Cancels a job that has not finished.
pub(super) async fn cancel(connection: &mut Connection, id: JobId, moment: TransitionContext) -> Result<CancelOutcome> {
    let cancelled: Option<i64> = db::query_scalar(
        "UPDATE job SET state = 'cancelled', finished_at_ms = ?, cleanup = 'void'
         WHERE id = ? AND finished_at_ms IS NULL RETURNING number",
    )
    .bind(moment.wall_ms)
    .bind(id.to_string())
    .fetch_optional(&mut *connection)
    .await?;
    if let Some(job) = cancelled {
        return cleanup::piece(connection, job, moment).await.map(CancelOutcome::Done);
    }
    let state: Option<String> =
        db::query_scalar("SELECT state FROM job WHERE id = ?").bind(id.to_string()).fetch_optional(connection).await?;
    state.map_or(Ok(CancelOutcome::Unknown), |name| job_state(&name).map(CancelOutcome::AlreadyFinished))
}

/// Deletes a job that is not running, with all its rows, and the pictures that only it used: the first piece of them
/// now.
pub(super) async fn delete(connection: &mut Connection, id: JobId, moment: TransitionContext) -> Result<DeleteOutcome> {
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
    cleanup::piece(connection, job, moment).await.map(DeleteOutcome::Done)
}
