//! Effects of transitions: the events, webhook deliveries and books that follow from a change of a job, tile, frame or
//! lease, written in its transaction.
//!
//! Only `jobs::transitions`, `tiles::results` and `leases::ends` change what has effects, and a test keeps it so. This module
//! changes no job, frame, tile or lease itself.

mod books;
mod changes;
mod events;
mod outbox;

use proto::job::JobState;

use crate::db::{self, Row};
use crate::queue::jobs::finish;
use crate::queue::workers::state::UsedLease;
use crate::queue::{Connection, NewJob, Result};

pub(in crate::queue) use events::{ChangedTile, FramePicture, JobCounters, NewEvent, Progress};
pub(in crate::queue) use outbox::EventSource;

/// The part of a job that the books depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::queue) struct Standing {
    /// Its priority.
    pub(in crate::queue) priority: i64,
    /// Whether it is paused.
    pub(in crate::queue) is_paused: bool,
    /// Whether it has finished.
    pub(in crate::queue) is_finished: bool,
}

impl Standing {
    /// Whether its tiles may be leased.
    fn takes_part(self) -> bool {
        !self.is_finished && !self.is_paused
    }
}

/// A job after a change.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::queue) struct ChangedJob {
    /// Itself.
    pub(in crate::queue) source: EventSource,
    /// Its state.
    pub(in crate::queue) state: JobState,
    /// Its standing.
    pub(in crate::queue) standing: Standing,
    error: Option<String>,
    rays_total: i64,
    /// Time of its state.
    at_ms: i64,
}

/// Columns of a [`ChangedJob`].
macro_rules! changed_job_columns {
    () => {
        "number, id, name, submitter, state, priority, paused, error, rays_total,
         finished_at_ms IS NOT NULL AS is_finished,
         coalesce(finished_at_ms, retried_at_ms, started_at_ms, created_at_ms) AS at_ms,
         EXISTS (SELECT 1 FROM webhook WHERE webhook.job = job.number) AS has_webhooks"
    };
}
pub(in crate::queue) use changed_job_columns;

impl ChangedJob {
    /// Reads a row with [`changed_job_columns`].
    pub(in crate::queue) fn read(row: &Row) -> Result<Self> {
        Ok(Self {
            source: read_source(row)?,
            state: finish::job_state(&row.get::<String>("state")?)?,
            standing: Standing {
                priority: row.get("priority")?,
                is_paused: row.get("paused")?,
                is_finished: row.get("is_finished")?,
            },
            error: row.get("error")?,
            rays_total: row.get("rays_total")?,
            at_ms: row.get("at_ms")?,
        })
    }
}

/// Reads the source of events from a row of a job.
pub(in crate::queue) fn read_source(row: &Row) -> Result<EventSource> {
    Ok(EventSource {
        job: row.get("number")?,
        id: row.get("id")?,
        name: row.get("name")?,
        submitter: row.get("submitter")?,
        has_webhooks: row.get("has_webhooks")?,
    })
}

/// A lease that has just ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::queue) struct EndedLease {
    /// Its tile.
    pub(in crate::queue) tile: i64,
    /// Submitter of its job.
    submitter: String,
    /// Priority that it was charged to.
    priority: i64,
    charged_us: i64,
    used_us: Option<i64>,
}

/// Columns of an [`EndedLease`].
macro_rules! ended_lease_columns {
    () => {
        "tile, charged_us, used_us, charged_priority,
         (SELECT job.submitter FROM tile @join job ON job.number = tile.job WHERE tile.id = lease.tile) AS submitter"
    };
}
pub(in crate::queue) use ended_lease_columns;

impl EndedLease {
    /// A lease that ended with a result.
    pub(in crate::queue) fn with_result(used: UsedLease<'_>) -> Self {
        let held = used.held;
        Self {
            tile: held.live.tile,
            submitter: held.submitter.clone(),
            priority: held.charged_priority,
            charged_us: held.charged_us,
            used_us: Some(used.used_us),
        }
    }

    /// Reads a row with [`ended_lease_columns`].
    pub(in crate::queue) fn read(row: &Row) -> Result<Self> {
        Ok(Self {
            tile: row.get("tile")?,
            submitter: row.get("submitter")?,
            priority: row.get("charged_priority")?,
            charged_us: row.get("charged_us")?,
            used_us: row.get("used_us")?,
        })
    }
}

/// A job was accepted. It has no webhooks yet.
pub(in crate::queue) async fn job_accepted(
    connection: &mut Connection,
    number: i64,
    job: &NewJob,
    at_ms: i64,
) -> Result<()> {
    let rays = i64::try_from(job.plan.rays_total()).unwrap_or(i64::MAX);
    outbox::insert(connection, number, &NewEvent::state(JobState::Queued, None, at_ms)).await?;
    books::grow_backlog(connection, &job.submitter, rays).await?;
    books::join_share(connection, &job.submitter, job.priority.into()).await
}

/// A job has reached another state.
pub(in crate::queue) async fn job_state_changed(connection: &mut Connection, job: &ChangedJob) -> Result<()> {
    let event = NewEvent::state(job.state, job.error.clone(), job.at_ms);
    outbox::write(connection, &job.source, &[event]).await
}

/// A job that had not finished has finished.
pub(in crate::queue) async fn job_finished(connection: &mut Connection, job: &ChangedJob) -> Result<()> {
    job_state_changed(connection, job).await?;
    let before = Standing { is_finished: false, ..job.standing };
    job_standing_changed(connection, job, before).await
}

/// The standing of a job was written, even if it is the same: a submitter's only job begins again without credit.
pub(in crate::queue) async fn job_standing_changed(
    connection: &mut Connection,
    job: &ChangedJob,
    before: Standing,
) -> Result<()> {
    let (submitter, after) = (&job.source.submitter, job.standing);
    match (before.is_finished, after.is_finished) {
        (false, true) => {
            books::shrink_backlog(connection, submitter, job.rays_total).await?;
            forget_measurements(connection, job).await?;
        }
        (true, false) => books::grow_backlog(connection, submitter, job.rays_total).await?,
        (false, false) | (true, true) => {}
    }
    if before.takes_part() {
        books::leave_share(connection, submitter, before.priority).await?;
    }
    if after.takes_part() {
        books::join_share(connection, submitter, after.priority).await?;
    }
    Ok(())
}

/// A job has changed for those who follow all jobs, without an event of its own.
pub(in crate::queue) async fn job_changed(connection: &mut Connection, job: &ChangedJob) -> Result<()> {
    changes::insert(connection, &job.source, false).await
}

/// A job is deleted for its users, who know it by the id that it had before.
pub(in crate::queue) async fn job_hidden(connection: &mut Connection, before: &ChangedJob) -> Result<()> {
    changes::insert(connection, &before.source, true).await
}

/// Deletes what was measured in a job that has finished.
async fn forget_measurements(connection: &mut Connection, job: &ChangedJob) -> Result<()> {
    for statement in ["DELETE FROM pace WHERE job = ?", "DELETE FROM speed WHERE job = ?"] {
        db::query(statement).bind(job.source.job).execute(&mut *connection).await?;
    }
    if job.state == JobState::Failed {
        // A job that failed, failed on every worker: if it is tried again, each may try again.
        db::query("DELETE FROM strike WHERE job = ?").bind(job.source.job).execute(connection).await?;
    }
    Ok(())
}

/// Counters of a job have changed.
pub(in crate::queue) async fn job_progressed(
    connection: &mut Connection,
    source: &EventSource,
    progress: Progress,
    after: JobCounters,
) -> Result<()> {
    outbox::write(connection, source, &progress.into_events(&source.id, after)).await
}

/// Leases have ended.
pub(in crate::queue) async fn leases_ended(connection: &mut Connection, leases: &[EndedLease]) -> Result<()> {
    books::correct_charges(connection, leases).await
}

/// A job's row was deleted. Its events, measurements and webhooks go with it.
pub(in crate::queue) async fn job_removed(connection: &mut Connection, job: &RemovedJob) -> Result<()> {
    if job.standing.is_finished {
        return Ok(());
    }
    books::shrink_backlog(connection, &job.submitter, job.rays_total).await?;
    if job.standing.takes_part() {
        books::leave_share(connection, &job.submitter, job.standing.priority).await?;
    }
    Ok(())
}

/// A job whose row was deleted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::queue) struct RemovedJob {
    /// Its submitter.
    pub(in crate::queue) submitter: String,
    /// Its rays.
    pub(in crate::queue) rays_total: i64,
    /// Its standing.
    pub(in crate::queue) standing: Standing,
}
