//! Progress and end of a job: its counters, success, failure, cancelling, deleting.

use proto::JobId;
use proto::job::JobState;
use sqlx::Row;

use super::{Connection, Result, TransitionContext, expect_rows, parse_column};
use crate::database::DatabaseError;

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
    /// The job is cancelled; these blobs may be orphans now.
    Done {
        /// Hashes of blobs.
        blobs: Vec<String>,
    },
    /// The job had finished already.
    AlreadyFinished(JobState),
    /// The job does not exist.
    Unknown,
}

/// Outcome of a delete.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum DeleteOutcome {
    /// The job is deleted; these pictures and blobs may be orphans now.
    Done {
        /// Hashes of pictures.
        pictures: Vec<String>,
        /// Hashes of blobs.
        blobs: Vec<String>,
    },
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
    sqlx::query("UPDATE job SET state = 'running', started_at_ms = ? WHERE number = ? AND state = 'queued'")
        .bind(moment.wall_ms)
        .bind(job)
        .execute(connection)
        .await?;
    Ok(())
}

/// Updates a job's counters; returns its number of finished tiles.
pub(super) async fn progress(connection: &mut Connection, job: i64, by: ProgressDelta) -> Result<i64> {
    let done: Option<i64> = sqlx::query_scalar(
        "UPDATE job SET tiles_done = tiles_done + ?1, rays_done = rays_done + ?2, frames_stored = frames_stored + ?3,
                        rays_peak = max(rays_peak, rays_done + ?2)
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
    sqlx::query(
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
    let failed = sqlx::query(
        "UPDATE job SET state = 'failed', error = ?, finished_at_ms = ?, tiles_dead = tiles_dead + 1
         WHERE number = ? AND finished_at_ms IS NULL",
    )
    .bind(message)
    .bind(moment.wall_ms)
    .bind(job)
    .execute(&mut *connection)
    .await?;
    expect_rows("job: failed", 1, &failed)?;
    void_open_work(connection, job).await
}

/// Fails the job of a frame that cannot be opened, unless the job has finished.
pub(super) async fn refuse(
    connection: &mut Connection,
    job: i64,
    message: &str,
    moment: TransitionContext,
) -> Result<()> {
    sqlx::query(
        "UPDATE job SET state = 'failed', error = ?, finished_at_ms = ? WHERE number = ? AND finished_at_ms IS NULL",
    )
    .bind(message)
    .bind(moment.wall_ms)
    .bind(job)
    .execute(&mut *connection)
    .await?;
    void_open_work(connection, job).await
}

/// Cancels a job that has not finished.
pub(super) async fn cancel(connection: &mut Connection, id: JobId, moment: TransitionContext) -> Result<CancelOutcome> {
    let cancelled: Option<i64> = sqlx::query_scalar(
        "UPDATE job SET state = 'cancelled', finished_at_ms = ? WHERE id = ? AND finished_at_ms IS NULL
         RETURNING number",
    )
    .bind(moment.wall_ms)
    .bind(id.to_string())
    .fetch_optional(&mut *connection)
    .await?;
    if let Some(job) = cancelled {
        void_open_work(connection, job).await?;
        return Ok(CancelOutcome::Done { blobs: blobs(connection, job).await? });
    }
    let state: Option<String> = sqlx::query_scalar("SELECT state FROM job WHERE id = ?")
        .bind(id.to_string())
        .fetch_optional(connection)
        .await?;
    state.map_or(Ok(CancelOutcome::Unknown), |name| job_state(&name).map(CancelOutcome::AlreadyFinished))
}

/// Voids the open frames and tiles of a finished job.
async fn void_open_work(connection: &mut Connection, job: i64) -> Result<()> {
    for statement in [
        "UPDATE lease SET ended = 'void' WHERE ended IS NULL
         AND tile IN (SELECT id FROM tile WHERE job = ? AND state = 'leased')",
        "UPDATE tile SET state = 'void' WHERE job = ? AND state IN ('ready', 'leased')",
        "UPDATE frame SET state = 'void' WHERE job = ? AND state IN ('open', 'stitching')",
    ] {
        sqlx::query(statement).bind(job).execute(&mut *connection).await?;
    }
    Ok(())
}

/// Deletes a job that is not running, with all its rows, and the pictures that only it used.
pub(super) async fn delete(connection: &mut Connection, id: JobId) -> Result<DeleteOutcome> {
    let row = sqlx::query("SELECT number, state FROM job WHERE id = ?")
        .bind(id.to_string())
        .fetch_optional(&mut *connection)
        .await?;
    let Some(row) = row else { return Ok(DeleteOutcome::Unknown) };
    if job_state(&row.try_get::<String, _>("state")?)? == JobState::Running {
        return Ok(DeleteOutcome::Running);
    }
    let (pictures, blobs) = delete_rows(connection, row.try_get("number")?).await?;
    Ok(DeleteOutcome::Done { pictures, blobs })
}

/// Deletes a job with all its rows; returns the hashes of its pictures and blobs, which may be orphans now.
pub(super) async fn delete_rows(connection: &mut Connection, job: i64) -> Result<(Vec<String>, Vec<String>)> {
    let pictures: Vec<String> =
        sqlx::query_scalar("SELECT DISTINCT picture FROM frame WHERE job = ? AND picture IS NOT NULL")
            .bind(job)
            .fetch_all(&mut *connection)
            .await?;
    let blobs = blobs(connection, job).await?;
    let deleted = sqlx::query("DELETE FROM job WHERE number = ?").bind(job).execute(&mut *connection).await?;
    expect_rows("job: deleted", 1, &deleted)?;
    sqlx::query(
        "DELETE FROM picture WHERE hash IN (SELECT value FROM json_each(?))
         AND NOT EXISTS (SELECT 1 FROM frame WHERE frame.picture = picture.hash)",
    )
    .bind(super::json_list(&pictures))
    .execute(connection)
    .await?;
    Ok((pictures, blobs))
}

async fn blobs(connection: &mut Connection, job: i64) -> Result<Vec<String>> {
    Ok(sqlx::query_scalar("SELECT DISTINCT blob FROM tile WHERE job = ? AND blob IS NOT NULL")
        .bind(job)
        .fetch_all(connection)
        .await?)
}
