//! Places of jobs in the queue: among jobs of equal priority the older one is first, unless one was moved.
//!
//! The order is that of `coalesce(place, number * 1048576)`. A moved job gets the middle between its neighbors; if there is
//! none left, the jobs of its priority share out their ages in their order.

use proto::JobId;
use proto::job::JobState;

use crate::db::{self, Durability};
use crate::queue::jobs::{finish, transitions};
use crate::queue::{Connection, Queue, Result, Wake};

/// Distance of the places of two jobs of consecutive numbers.
const STEP: i64 = 1 << 20;

/// Place that a job is moved to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum QueuePosition {
    /// Before all other jobs of the priority.
    First,
    /// Right before another job.
    Before(JobId),
    /// Right after another job.
    After(JobId),
}

/// Outcome of moving a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ReorderOutcome {
    /// The job has its new place.
    Done,
    /// This job, the moved one or the one beside it, has finished.
    Finished(JobId, JobState),
    /// This job does not exist.
    Unknown(JobId),
}

/// A job in the queue.
struct Queued {
    number: i64,
    key: i64,
}

impl Queue {
    /// Highest priority of the jobs in the queue.
    pub(crate) async fn highest_priority(&self) -> Result<Option<i32>> {
        db::query_scalar("SELECT max(priority) FROM job WHERE finished_at_ms IS NULL AND paused = 0")
            .fetch_one(self.readers())
            .await
    }

    /// Moves a job in the queue, to this priority.
    pub(crate) async fn reorder_job(&self, job: JobId, place: QueuePosition, priority: i32) -> Result<ReorderOutcome> {
        let moved = self
            .database
            .write(Durability::Full, move |connection| {
                Box::pin(async move { reorder_job(connection, job, place, priority).await })
            })
            .await?;
        self.wake(Wake::WORK);
        Ok(moved)
    }
}

async fn reorder_job(
    connection: &mut Connection,
    id: JobId,
    place: QueuePosition,
    priority: i32,
) -> Result<ReorderOutcome> {
    let job = match queued(connection, id).await? {
        Ok(job) => job,
        Err(refused) => return Ok(refused),
    };
    let other = match place {
        QueuePosition::First => None,
        QueuePosition::Before(other) | QueuePosition::After(other) => match queued(connection, other).await? {
            Ok(other) => Some(other),
            Err(refused) => return Ok(refused),
        },
    };
    if other.as_ref().is_some_and(|other| other.number == job.number) {
        return Ok(ReorderOutcome::Done);
    }
    let mut key = free_key(connection, &job, place, other.as_ref(), priority).await?;
    if let (None, QueuePosition::Before(id) | QueuePosition::After(id)) = (key, place) {
        spread(connection, priority).await?;
        let other = queued(connection, id).await?.ok();
        // Now all places are apart.
        key = free_key(connection, &job, place, other.as_ref(), priority).await?;
    }
    transitions::set_place(connection, id, key.unwrap_or(job.key), priority).await?;
    Ok(ReorderOutcome::Done)
}

/// A key for the place, between its neighbors' keys; `None` if none is left.
async fn free_key(
    connection: &mut Connection,
    job: &Queued,
    place: QueuePosition,
    other: Option<&Queued>,
    priority: i32,
) -> Result<Option<i64>> {
    let (low, high) = match (place, other) {
        (QueuePosition::After(_), Some(other)) => {
            let next = neighbor(connection, NEXT_SQL, job, other, priority).await?;
            // Jobs that are submitted from now on come after it.
            let newest: i64 = db::query_scalar("SELECT max(number) FROM job").fetch_one(&mut *connection).await?;
            (other.key, next.unwrap_or((newest + 1).saturating_mul(STEP).max(other.key + 2)))
        }
        (QueuePosition::Before(_), Some(other)) => {
            let previous = neighbor(connection, PREVIOUS_SQL, job, other, priority).await?;
            (previous.unwrap_or(other.key - 2 * STEP), other.key)
        }
        (QueuePosition::First | QueuePosition::Before(_) | QueuePosition::After(_), _) => {
            let first: Option<i64> =
                db::query_scalar(FIRST_SQL).bind(priority).bind(job.number).fetch_one(&mut *connection).await?;
            first.map_or((job.key - 1, job.key + 1), |first| (first - 2 * STEP, first))
        }
    };
    Ok((high - low >= 2).then_some(low + (high - low) / 2))
}

const PREVIOUS_SQL: &str = "SELECT max(coalesce(place, number * 1048576)) FROM job
     WHERE finished_at_ms IS NULL AND priority = ?1 AND number <> ?2 AND number <> ?3
       AND coalesce(place, number * 1048576) <= ?4";
const NEXT_SQL: &str = "SELECT min(coalesce(place, number * 1048576)) FROM job
     WHERE finished_at_ms IS NULL AND priority = ?1 AND number <> ?2 AND number <> ?3
       AND coalesce(place, number * 1048576) >= ?4";
const FIRST_SQL: &str = "SELECT min(coalesce(place, number * 1048576)) FROM job
     WHERE finished_at_ms IS NULL AND priority = ? AND number <> ?";

async fn neighbor(
    connection: &mut Connection,
    statement: &'static str,
    job: &Queued,
    other: &Queued,
    priority: i32,
) -> Result<Option<i64>> {
    db::query_scalar(statement)
        .bind(priority)
        .bind(job.number)
        .bind(other.number)
        .bind(other.key)
        .fetch_one(connection)
        .await
}

/// Moves the places of a priority's jobs apart: in their order they get the places of their ages.
async fn spread(connection: &mut Connection, priority: i32) -> Result<()> {
    let ordered: Vec<i64> = db::query_scalar(
        "SELECT number FROM job WHERE finished_at_ms IS NULL AND priority = ?
         ORDER BY coalesce(place, number * 1048576), number",
    )
    .bind(priority)
    .fetch_all(&mut *connection)
    .await?;
    let mut ages = ordered.clone();
    ages.sort_unstable();
    let places: Vec<(i64, i64)> = ordered.into_iter().zip(ages.into_iter().map(|number| number * STEP)).collect();
    db::query(
        "UPDATE job SET place = CAST(listed.value ->> 1 AS BIGINT) FROM @rows(?)
         WHERE job.number = CAST(listed.value ->> 0 AS BIGINT)",
    )
    .bind(serde_json::json!(places).to_string())
    .execute(connection)
    .await?;
    Ok(())
}

/// A job that has not finished.
async fn queued(connection: &mut Connection, id: JobId) -> Result<std::result::Result<Queued, ReorderOutcome>> {
    let row = db::query(
        "SELECT number, state, finished_at_ms IS NULL AS is_open, coalesce(place, number * 1048576) AS sort_key
         FROM job WHERE id = ?",
    )
    .bind(id.to_string())
    .fetch_optional(connection)
    .await?;
    let Some(row) = row else { return Ok(Err(ReorderOutcome::Unknown(id))) };
    if !row.get::<bool>("is_open")? {
        return Ok(Err(ReorderOutcome::Finished(id, finish::job_state(&row.get::<String>("state")?)?)));
    }
    Ok(Ok(Queued { number: row.get("number")?, key: row.get("sort_key")? }))
}
