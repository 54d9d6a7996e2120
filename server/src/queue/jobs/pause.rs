//! Pausing a job or the farm: no new tiles are leased; leased tiles finish and count.

use proto::JobId;
use proto::job::JobState;

use crate::db;
use crate::db::Durability;
use crate::queue::jobs::{finish, transitions};
use crate::queue::{Connection, Queue, Result, Wake, expect_rows};

/// Outcome of pausing or resuming a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PauseOutcome {
    /// The job is in the requested state.
    Done,
    /// The job had finished already.
    AlreadyFinished(JobState),
    /// Its submitter has the maximum of paused jobs.
    TooMany(u32),
    /// The job does not exist.
    Unknown,
}

/// Whether the job's submitter has this number of paused jobs, without this one.
async fn has_paused(connection: &mut Connection, id: JobId, limit: u32) -> Result<bool> {
    let others: i64 = db::query_scalar(
        "SELECT count(*) FROM job
         WHERE submitter = (SELECT submitter FROM job WHERE id = ?1) AND paused = 1 AND finished_at_ms IS NULL
           AND id <> ?1",
    )
    .bind(id.to_string())
    .fetch_one(connection)
    .await?;
    Ok(others >= i64::from(limit))
}

async fn pause_job(
    connection: &mut Connection,
    id: JobId,
    paused: bool,
    max_paused: Option<u32>,
) -> Result<PauseOutcome> {
    if let Some(limit) = max_paused.filter(|_| paused)
        && has_paused(connection, id, limit).await?
    {
        return Ok(PauseOutcome::TooMany(limit));
    }
    if transitions::set_paused(connection, id, paused).await? {
        return Ok(PauseOutcome::Done);
    }
    let state: Option<String> =
        db::query_scalar("SELECT state FROM job WHERE id = ?").bind(id.to_string()).fetch_optional(connection).await?;
    state.map_or(Ok(PauseOutcome::Unknown), |name| finish::job_state(&name).map(PauseOutcome::AlreadyFinished))
}

async fn pause_farm(connection: &mut Connection, paused: bool) -> Result<()> {
    let changed = db::query("UPDATE meta SET value = ? WHERE name = 'paused'").bind(paused).execute(connection).await?;
    expect_rows("meta: paused", 1, changed)
}

impl Queue {
    /// Pauses or resumes a job that has not finished, if its submitter has fewer paused jobs than the maximum.
    pub(crate) async fn pause(&self, job: JobId, paused: bool, max_paused: Option<u32>) -> Result<PauseOutcome> {
        let done = self
            .database
            .write(Durability::Full, move |connection| Box::pin(pause_job(connection, job, paused, max_paused)))
            .await?;
        if !paused {
            self.wake(Wake::WORK);
        }
        Ok(done)
    }

    /// Pauses or resumes the farm.
    pub(crate) async fn pause_all(&self, paused: bool) -> Result<()> {
        self.database.write(Durability::Full, move |connection| Box::pin(pause_farm(connection, paused))).await?;
        if !paused {
            self.wake(Wake::WORK);
        }
        Ok(())
    }

    /// Whether the farm is paused.
    pub(crate) async fn is_paused(&self) -> Result<bool> {
        db::query_scalar("SELECT value <> 0 FROM meta WHERE name = 'paused'").fetch_one(self.readers()).await
    }
}
