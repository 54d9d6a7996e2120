//! Changes of an existing job by its users: retry, priority, and a preview of what deleting it would remove.

use proto::JobId;
use proto::job::JobState;
use proto::job::{DeleteDryRun, JobPatch};

use crate::db;
use crate::db::Durability;
use crate::queue::jobs::{cleanup, finish, transitions};
use crate::queue::{BacklogLimits, Connection, ExceededLimit, Queue, Result, TransitionContext, Wake};

/// Outcome of a change to a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ChangeOutcome {
    /// The change was made.
    Done,
    /// The job's state does not allow it.
    WrongState(JobState),
    /// The job does not exist.
    Unknown,
}

/// Outcome of an attempt to retry a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RetryOutcome {
    /// The job is running again, or can't.
    Changed(ChangeOutcome),
    /// It would exceed a limit.
    Rejected(ExceededLimit),
}

/// Step of an attempt to retry a job.
enum RetryStep {
    /// It was decided.
    Outcome(RetryOutcome),
    /// The open work of this job must be voided completely first.
    CleanUpFirst(i64),
}

impl Queue {
    /// Requeues the dead tiles of a failed job, which is unfinished work like a new job.
    pub(crate) async fn retry(&self, job: JobId, limits: BacklogLimits) -> Result<RetryOutcome> {
        loop {
            let context = self.context();
            let step = self
                .database
                .write(Durability::Full, move |connection| {
                    Box::pin(async move { retry(connection, job, limits, context).await })
                })
                .await?;
            match step {
                RetryStep::CleanUpFirst(job) => self.finish_cleanup(job).await?,
                RetryStep::Outcome(outcome) => {
                    self.wake(Wake::WORK);
                    self.wake_signals.cleanup.notify_one();
                    return Ok(outcome);
                }
            }
        }
    }

    /// Changes a job that has not finished.
    pub(crate) async fn patch(&self, job: JobId, patch: JobPatch) -> Result<ChangeOutcome> {
        self.database
            .write(Durability::Full, move |connection| Box::pin(async move { change(connection, job, &patch).await }))
            .await
    }

    /// Dry run of a deletion: the contents that it would remove; `None` if the job does not exist.
    pub(crate) async fn delete_preview(&self, job: JobId) -> Result<Option<(JobState, DeleteDryRun)>> {
        let row = db::query(DRY_RUN_SQL).bind(job.to_string()).fetch_optional(self.readers()).await?;
        row.map(|row| {
            let picture_bytes: i64 = row.get("picture_bytes")?;
            let blob_bytes: i64 = row.get("blob_bytes")?;
            let preview = DeleteDryRun {
                pictures: row.get("pictures")?,
                blobs: row.get("blobs")?,
                size_bytes: picture_bytes.saturating_add(blob_bytes).unsigned_abs(),
                rows: row.get("rows")?,
            };
            Ok((finish::job_state(&row.get::<String>("state")?)?, preview))
        })
        .transpose()
    }
}

/// Bytes that only this job uses, and the number of its rows.
const DRY_RUN_SQL: &str = "
    WITH this AS (SELECT number, state, recorded FROM job WHERE id = ?),
    alone AS (
        SELECT DISTINCT frame.picture, frame.size_bytes FROM this @join frame ON frame.job = this.number
        WHERE frame.picture IS NOT NULL AND NOT EXISTS (
            SELECT 1 FROM frame AS other
            WHERE other.picture IS NOT NULL AND other.picture = frame.picture AND other.job <> this.number)),
    unneeded AS (
        SELECT DISTINCT tile.blob, tile.blob_bytes FROM this @join tile ON tile.job = this.number
        @join frame ON frame.job = tile.job AND frame.number = tile.frame
        WHERE tile.blob IS NOT NULL AND (frame.state <> 'stored' OR this.recorded = 1) AND NOT EXISTS (
            SELECT 1 FROM tile AS other WHERE other.blob IS NOT NULL AND other.blob = tile.blob AND other.job <> this.number)
        UNION SELECT tile.record, tile.record_bytes FROM this @join tile ON tile.job = this.number
        WHERE tile.record IS NOT NULL AND NOT EXISTS (
            SELECT 1 FROM tile AS other
            WHERE other.record IS NOT NULL AND other.record = tile.record AND other.job <> this.number))
    SELECT state,
           (SELECT count(*) FROM alone) AS pictures,
           (SELECT CAST(coalesce(sum(size_bytes), 0) AS BIGINT) FROM alone) AS picture_bytes,
           (SELECT count(*) FROM unneeded) AS blobs,
           (SELECT CAST(coalesce(sum(blob_bytes), 0) AS BIGINT) FROM unneeded) AS blob_bytes,
           2 + (SELECT count(*) FROM frame WHERE frame.job = this.number)
             + (SELECT count(*) FROM tile WHERE tile.job = this.number)
             + (SELECT count(*) FROM outbox WHERE outbox.job = this.number) AS rows
    FROM this";

async fn state(connection: &mut Connection, id: JobId) -> Result<ChangeOutcome> {
    let state: Option<String> =
        db::query_scalar("SELECT state FROM job WHERE id = ?").bind(id.to_string()).fetch_optional(connection).await?;
    state.map_or(Ok(ChangeOutcome::Unknown), |name| finish::job_state(&name).map(ChangeOutcome::WrongState))
}

/// Marks a failed job as running; its dead tiles, and the tiles skipped because of them, become ready: the first piece
/// of them now.
async fn retry(
    connection: &mut Connection,
    id: JobId,
    limits: BacklogLimits,
    context: TransitionContext,
) -> Result<RetryStep> {
    let failed = db::query(
        "SELECT number, cleanup, submitter, rays_total FROM job WHERE id = ? AND state = 'failed' AND tiles_dead > 0",
    )
    .bind(id.to_string())
    .fetch_optional(&mut *connection)
    .await?;
    let Some(failed) = failed else {
        let outcome = state(connection, id).await?;
        return Ok(RetryStep::Outcome(RetryOutcome::Changed(outcome)));
    };
    let job: i64 = failed.get("number")?;
    let rays: i64 = failed.get("rays_total")?;
    let submitter: String = failed.get("submitter")?;
    if let Some(limit) = limits.find_exceeded(connection, &submitter, rays.unsigned_abs()).await? {
        return Ok(RetryStep::Outcome(RetryOutcome::Rejected(limit)));
    }
    if failed.get::<Option<String>>("cleanup")?.is_some() {
        return Ok(RetryStep::CleanUpFirst(job));
    }
    transitions::retry(connection, job, context).await?;
    cleanup::piece(connection, job, context).await?;
    Ok(RetryStep::Outcome(RetryOutcome::Changed(ChangeOutcome::Done)))
}

async fn change(connection: &mut Connection, id: JobId, patch: &JobPatch) -> Result<ChangeOutcome> {
    let is_changed = transitions::set_priority(connection, id, patch.priority).await?;
    if is_changed { Ok(ChangeOutcome::Done) } else { state(connection, id).await }
}
