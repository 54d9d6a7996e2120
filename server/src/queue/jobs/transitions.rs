//! The only statements that insert or delete jobs or change their state, end, priority, pause or progress, each with
//! its effects. Conditions of users and the order of steps are the callers'.

use proto::JobId;

use crate::db::{self, DatabaseError, Statement};
use crate::queue::events::effects::{
    self, ChangedJob, JobCounters, Progress, RemovedJob, Standing, changed_job_columns, read_source,
};
use crate::queue::{Connection, NewJob, Result, TransitionContext};

/// Name of the transition that hides a job, for errors.
const HIDDEN: &str = "job: marked for deletion";

/// A job's counters after progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::queue) struct Progressed {
    /// Tiles done.
    pub(in crate::queue) tiles_done: i64,
    /// Whether all its frames are stored.
    pub(in crate::queue) is_complete: bool,
}

/// Runs a statement on at most one job, which returns its changed columns.
async fn change(connection: &mut Connection, statement: Statement) -> Result<Option<ChangedJob>> {
    statement.fetch_optional(connection).await?.as_ref().map(ChangedJob::read).transpose()
}

/// The same, on exactly one job.
async fn change_one(connection: &mut Connection, what: &'static str, statement: Statement) -> Result<ChangedJob> {
    change(connection, statement).await?.ok_or(DatabaseError::Rows { what, expected: 1, changed: 0 })
}

/// Inserts a job; returns its number.
pub(in crate::queue) async fn insert(
    connection: &mut Connection,
    job: &NewJob,
    context: TransitionContext,
) -> Result<i64> {
    let plan = job.plan;
    let number: i64 = db::query_scalar(
        "INSERT INTO job (id, name, submitter, priority, state, fresh, width_px, height_px, samples, pixel_bytes,
                          edge_px, media_type, frames_total, tiles_total, rays_total, warnings, nodes,
                          tile_seconds, recorded, based_on, created_at_ms)
         VALUES (?, ?, ?, ?, 'queued', ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?) RETURNING number",
    )
    .bind(job.id.to_string())
    .bind(&job.name)
    .bind(&job.submitter)
    .bind(job.priority)
    .bind(job.no_cache)
    .bind(plan.width_px)
    .bind(plan.height_px)
    .bind(plan.samples)
    .bind(plan.pixel_bytes)
    .bind(plan.edge_px)
    .bind(job.media_type)
    .bind(plan.frames)
    .bind(i64::try_from(plan.tiles_total()).unwrap_or(i64::MAX))
    .bind(i64::try_from(plan.rays_total()).unwrap_or(i64::MAX))
    .bind(serde_json::json!(job.warnings).to_string())
    .bind(job.nodes)
    .bind(job.tile_seconds)
    .bind(job.recorded)
    .bind(job.based_on.map(|id| id.to_string()))
    .bind(context.wall_ms)
    .fetch_one(&mut *connection)
    .await?;
    effects::job_accepted(connection, number, job, context.wall_ms).await?;
    Ok(number)
}

/// Marks a job as running when its first lease is granted.
pub(in crate::queue) async fn start(connection: &mut Connection, job: i64, context: TransitionContext) -> Result<()> {
    let statement = db::query(concat!(
        "UPDATE job SET state = 'running', started_at_ms = ? WHERE number = ? AND state = 'queued' RETURNING ",
        changed_job_columns!()
    ));
    match change(connection, statement.bind(context.wall_ms).bind(job)).await? {
        Some(started) => effects::job_state_changed(connection, &started).await,
        None => Ok(()),
    }
}

/// Updates a job's counters.
pub(in crate::queue) async fn progress(connection: &mut Connection, job: i64, by: Progress) -> Result<Progressed> {
    let after = db::query(
        "UPDATE job SET tiles_done = tiles_done + ?1, rays_done = rays_done + ?2, frames_stored = frames_stored + ?3,
                        rays_peak = @max(rays_peak, rays_done + ?2)
         WHERE number = ?4
         RETURNING number, id, name, submitter, tiles_done, tiles_total, rays_peak, rays_total,
                   frames_stored = frames_total AS is_complete,
                   EXISTS (SELECT 1 FROM webhook WHERE webhook.job = job.number) AS has_webhooks",
    )
    .bind(by.tiles)
    .bind(by.rays)
    .bind(by.frames())
    .bind(job)
    .fetch_one(&mut *connection)
    .await?;
    let progressed = Progressed { tiles_done: after.get("tiles_done")?, is_complete: after.get("is_complete")? };
    let counters = JobCounters {
        tiles_done: after.get("tiles_done")?,
        tiles_total: after.get("tiles_total")?,
        rays_peak: after.get("rays_peak")?,
        rays_total: after.get("rays_total")?,
    };
    effects::job_progressed(connection, &read_source(&after)?, by, counters).await?;
    Ok(progressed)
}

/// Marks a job as succeeded if it has not finished and all its frames are stored.
pub(in crate::queue) async fn succeed(connection: &mut Connection, job: i64, context: TransitionContext) -> Result<()> {
    let statement = db::query(concat!(
        "UPDATE job SET state = 'succeeded', finished_at_ms = ?1, started_at_ms = coalesce(started_at_ms, ?1)
         WHERE number = ?2 AND frames_stored = frames_total AND finished_at_ms IS NULL RETURNING ",
        changed_job_columns!()
    ));
    finish(connection, statement.bind(context.wall_ms).bind(job)).await.map(drop)
}

/// Marks a job as failed if it has not finished; returns whether it is now.
pub(in crate::queue) async fn fail(
    connection: &mut Connection,
    job: i64,
    message: &str,
    dead_tiles: i64,
    context: TransitionContext,
) -> Result<bool> {
    let statement = db::query(concat!(
        "UPDATE job SET state = 'failed', error = ?, finished_at_ms = ?, tiles_dead = tiles_dead + ?, cleanup = 'void'
         WHERE number = ? AND finished_at_ms IS NULL RETURNING ",
        changed_job_columns!()
    ));
    let statement = statement.bind(message).bind(context.wall_ms).bind(dead_tiles).bind(job);
    Ok(finish(connection, statement).await?.is_some())
}

/// Marks a job as cancelled if it has not finished; returns its number if it is now.
pub(in crate::queue) async fn cancel(
    connection: &mut Connection,
    id: JobId,
    context: TransitionContext,
) -> Result<Option<i64>> {
    let statement = db::query(concat!(
        "UPDATE job SET state = 'cancelled', finished_at_ms = ?, cleanup = 'void'
         WHERE id = ? AND finished_at_ms IS NULL RETURNING ",
        changed_job_columns!()
    ));
    finish(connection, statement.bind(context.wall_ms).bind(id.to_string())).await
}

/// Runs a statement that finishes an unfinished job; returns the job's number if it did.
async fn finish(connection: &mut Connection, statement: Statement) -> Result<Option<i64>> {
    let Some(finished) = change(connection, statement).await? else { return Ok(None) };
    effects::job_finished(connection, &finished).await?;
    Ok(Some(finished.source.job))
}

/// Marks a failed job as running again.
pub(in crate::queue) async fn retry(connection: &mut Connection, job: i64, context: TransitionContext) -> Result<()> {
    let statement = db::query(concat!(
        "UPDATE job SET state = 'running', error = NULL, finished_at_ms = NULL, events_kept = 1, cleanup = 'requeue',
                        retried_at_ms = ?1, started_at_ms = coalesce(started_at_ms, ?1)
         WHERE number = ?2 AND state = 'failed' RETURNING ",
        changed_job_columns!()
    ));
    let retried = change_one(connection, "job: failed to running", statement.bind(context.wall_ms).bind(job)).await?;
    effects::job_state_changed(connection, &retried).await?;
    let before = Standing { is_finished: true, ..retried.standing };
    effects::job_standing_changed(connection, &retried, before).await
}

/// Marks a job as running because a stored frame, with this number of tiles and rays, is rendered again.
pub(in crate::queue) async fn reopen(connection: &mut Connection, job: i64, tiles: i64, rays: i64) -> Result<()> {
    let Some(before) = read(connection, JobKey::Number(job)).await? else {
        return Err(DatabaseError::Rows { what: "job: succeeded to running", expected: 1, changed: 0 });
    };
    let statement = db::query(concat!(
        "UPDATE job SET state = 'running', finished_at_ms = NULL, frames_stored = frames_stored - 1,
                        tiles_done = tiles_done - ?, rays_done = rays_done - ?
         WHERE number = ? AND state IN ('queued', 'running', 'succeeded') RETURNING ",
        changed_job_columns!()
    ));
    let statement = statement.bind(tiles).bind(rays).bind(job);
    let running = change_one(connection, "job: succeeded to running", statement).await?;
    if before.state == running.state {
        effects::job_changed(connection, &running).await?;
    } else {
        effects::job_state_changed(connection, &running).await?;
    }
    effects::job_standing_changed(connection, &running, before.standing).await
}

/// Changes the priority of a job that has not finished, if one is given; returns whether there is such a job.
pub(in crate::queue) async fn set_priority(
    connection: &mut Connection,
    id: JobId,
    priority: Option<i32>,
) -> Result<bool> {
    let statement = db::query(concat!(
        "UPDATE job SET priority = coalesce(?, priority) WHERE id = ? AND finished_at_ms IS NULL RETURNING ",
        changed_job_columns!()
    ));
    change_standing(connection, id, statement.bind(priority).bind(id.to_string())).await
}

/// Changes the place and the priority of a job that has not finished; returns whether there is such a job.
pub(in crate::queue) async fn set_place(
    connection: &mut Connection,
    id: JobId,
    place: i64,
    priority: i32,
) -> Result<bool> {
    let statement = db::query(concat!(
        "UPDATE job SET place = ?, priority = ? WHERE id = ? AND finished_at_ms IS NULL RETURNING ",
        changed_job_columns!()
    ));
    change_standing(connection, id, statement.bind(place).bind(priority).bind(id.to_string())).await
}

/// Pauses or resumes a job that has not finished; returns whether there is such a job.
pub(in crate::queue) async fn set_paused(connection: &mut Connection, id: JobId, paused: bool) -> Result<bool> {
    let statement = db::query(concat!(
        "UPDATE job SET paused = ? WHERE id = ? AND finished_at_ms IS NULL RETURNING ",
        changed_job_columns!()
    ));
    change_standing(connection, id, statement.bind(paused).bind(id.to_string())).await
}

/// Hides a job that is not running, so that it can be deleted in pieces: its id is no job's id from now on, and nothing
/// of it is leased.
pub(in crate::queue) async fn hide(connection: &mut Connection, job: i64) -> Result<()> {
    let statement = db::query(concat!(
        "UPDATE job SET id = 'deleted ' || number, paused = 1, cleanup = 'delete'
         WHERE number = ? AND state <> 'running' RETURNING ",
        changed_job_columns!()
    ));
    let missing = DatabaseError::Rows { what: HIDDEN, expected: 1, changed: 0 };
    let before = read(connection, JobKey::Number(job)).await?.ok_or(missing)?;
    let hidden = change_one(connection, HIDDEN, statement.bind(job)).await?;
    effects::job_hidden(connection, &before).await?;
    effects::job_standing_changed(connection, &hidden, before.standing).await
}

/// Deletes the row of a job whose other rows are deleted.
pub(in crate::queue) async fn delete(connection: &mut Connection, job: i64) -> Result<()> {
    let row = db::query(
        "DELETE FROM job WHERE number = ?
         RETURNING submitter, rays_total, priority, paused, finished_at_ms IS NOT NULL AS is_finished",
    )
    .bind(job)
    .fetch_one(&mut *connection)
    .await?;
    let removed = RemovedJob {
        submitter: row.get("submitter")?,
        rays_total: row.get("rays_total")?,
        standing: Standing {
            priority: row.get("priority")?,
            is_paused: row.get("paused")?,
            is_finished: row.get("is_finished")?,
        },
    };
    effects::job_removed(connection, &removed).await
}

/// Names a job.
#[derive(Clone, Copy, Debug)]
enum JobKey {
    Number(i64),
    Id(JobId),
}

/// A job as it is.
async fn read(connection: &mut Connection, key: JobKey) -> Result<Option<ChangedJob>> {
    let statement = match key {
        JobKey::Number(number) => {
            db::query(concat!("SELECT ", changed_job_columns!(), " FROM job WHERE number = ?")).bind(number)
        }
        JobKey::Id(id) => {
            db::query(concat!("SELECT ", changed_job_columns!(), " FROM job WHERE id = ?")).bind(id.to_string())
        }
    };
    change(connection, statement).await
}

/// Runs a statement that writes the standing of a job; returns whether it did.
async fn change_standing(connection: &mut Connection, id: JobId, statement: Statement) -> Result<bool> {
    let Some(before) = read(connection, JobKey::Id(id)).await? else { return Ok(false) };
    let Some(after) = change(connection, statement).await? else { return Ok(false) };
    effects::job_changed(connection, &after).await?;
    effects::job_standing_changed(connection, &after, before.standing).await?;
    Ok(true)
}
