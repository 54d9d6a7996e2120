//! A job's events: read in order, replaced by a snapshot if older ones were pruned, and pruned by age and
//! number.
//!
//! Only `effects` writes events, in the transaction of the change.

pub(super) mod effects;
pub(super) mod farm_changes;
pub(super) mod gaps;
pub(super) mod wake;
pub(super) mod webhooks;

use db::Row;
use proto::JobId;
use proto::event::{ProgressEvent, Snapshot, TileEvent};
use proto::job::{DoneOfTotal, JobState};
use proto::rounding;

use crate::db;
use crate::db::Durability;
use crate::queue::jobs::finish;
use crate::queue::{Connection, Queue, Result};

/// Minimum retention of events of finished jobs.
const RETENTION_MS: i64 = 24 * 3_600_000;
/// Maximum number of events in total; beyond it the oldest are pruned, even of running jobs.
const MAX_EVENTS: i64 = 500_000;
/// Number of events pruned in one transaction.
const EVENTS_BATCH: i64 = 1_000;
/// Maximum number of rectangles in a snapshot.
const MAX_RECTANGLES: i64 = 20_000;

/// Event of a job, as sent to subscribers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Event {
    /// Event number; later events have greater ones.
    pub(crate) number: i64,
    /// The job's number.
    pub(crate) job: i64,
    /// Event type.
    pub(crate) kind: String,
    /// State of the job, if it is a `state` event.
    pub(crate) state: Option<JobState>,
    /// Payload, as JSON.
    pub(crate) body: String,
}

impl Event {
    /// Whether no event follows this one, unless the job is retried.
    pub(crate) fn is_final(&self) -> bool {
        self.state.is_some_and(JobState::is_final)
    }

    fn read(row: &Row) -> Result<Self> {
        let state: Option<String> = row.get("state")?;
        let (kind, body): (String, String) = (row.get("kind")?, row.get("body")?);
        Ok(Self {
            number: row.get("number")?,
            job: row.get("job")?,
            state: state.map(|state| finish::job_state(&state)).transpose()?,
            body: if kind == "progress" { rounded(body) } else { body },
            kind,
        })
    }
}

/// Body of a progress event with its fraction rounded; the row has every digit.
fn rounded(body: String) -> String {
    let Ok(event) = serde_json::from_str::<ProgressEvent>(&body) else { return body };
    let event = ProgressEvent { progress: rounding::fraction(event.progress), ..event };
    serde_json::to_string(&event).unwrap_or(body)
}

/// State that a subscriber needs before its first event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct EventPosition {
    /// The job's number.
    pub(crate) job: i64,
    /// Whether the job has finished.
    pub(crate) ended: bool,
    /// Number of the last pruned event.
    pub(crate) pruned: i64,
    /// Number of the newest event, which may have been pruned. It is read from the rows: a sequence would tell of events
    /// that are not committed yet.
    pub(crate) newest: i64,
    /// Whether the number that was asked for is in a gap between two epochs.
    pub(crate) is_in_gap: bool,
}

impl Queue {
    /// State that a subscriber to a job, after an event with this number, needs before its first event.
    pub(crate) async fn event_position(&self, id: JobId, after: i64) -> Result<Option<EventPosition>> {
        let row = db::query(
            "SELECT number, finished_at_ms IS NOT NULL AS ended, events_pruned,
                    @max(events_pruned, coalesce((SELECT max(number) FROM outbox), 0)) AS newest,
                    EXISTS (SELECT 1 FROM event_gap WHERE after_number < ?2 AND next_number > ?2) AS is_in_gap
             FROM job WHERE id = ?1",
        )
        .bind(id.to_string())
        .bind(after)
        .fetch_optional(self.readers())
        .await?;
        row.map(|row| {
            Ok(EventPosition {
                job: row.get("number")?,
                ended: row.get("ended")?,
                pruned: row.get("events_pruned")?,
                newest: row.get("newest")?,
                is_in_gap: row.get("is_in_gap")?,
            })
        })
        .transpose()
    }

    /// Whether a job has finished; `None` if it does not exist.
    pub(crate) async fn has_ended(&self, job: i64) -> Result<Option<bool>> {
        db::query_scalar(
            "SELECT finished_at_ms IS NOT NULL FROM job WHERE number = ? AND cleanup IS DISTINCT FROM 'delete'",
        )
        .bind(job)
        .fetch_optional(self.readers())
        .await
    }

    /// Number of the newest event.
    pub(crate) async fn newest_event(&self) -> Result<i64> {
        db::query_scalar("SELECT coalesce(max(number), 0) FROM outbox").fetch_one(self.readers()).await
    }

    /// The next events of all jobs.
    pub(crate) async fn events_after(&self, number: i64, limit: u32) -> Result<Vec<Event>> {
        let rows =
            db::query("SELECT number, job, kind, state, body FROM outbox WHERE number > ? ORDER BY number LIMIT ?")
                .bind(number)
                .bind(limit)
                .fetch_all(self.readers())
                .await?;
        rows.iter().map(Event::read).collect()
    }

    /// The next events of a job.
    pub(crate) async fn job_events_after(&self, job: i64, number: i64, limit: u32) -> Result<Vec<Event>> {
        let rows = db::query(
            "SELECT number, job, kind, state, body FROM outbox WHERE job = ? AND number > ? ORDER BY number LIMIT ?",
        )
        .bind(job)
        .bind(number)
        .bind(limit)
        .fetch_all(self.readers())
        .await?;
        rows.iter().map(Event::read).collect()
    }

    /// State of a job and the number of the last event included in it, read in one transaction.
    pub(crate) async fn snapshot(&self, job: i64) -> Result<Option<(i64, Snapshot)>> {
        let mut reading = self.readers().snapshot().await?;
        let row = db::query(
            "SELECT state, error, rays_peak, rays_total, tiles_done, tiles_total, frames_stored, frames_total,
                    @max(events_pruned, coalesce((SELECT max(number) FROM outbox), 0)) AS newest
             FROM job WHERE number = ?",
        )
        .bind(job)
        .fetch_optional(&mut reading)
        .await?;
        let Some(row) = row else { return Ok(None) };
        let newest = row.get("newest")?;
        let numbers: Vec<u32> =
            db::query_scalar("SELECT number FROM frame WHERE job = ? AND state = 'stored' ORDER BY number")
                .bind(job)
                .fetch_all(&mut reading)
                .await?;
        let tiles = db::query(
            "SELECT tile.frame, tile.x_px, tile.y_px, tile.width_px, tile.height_px
             FROM frame @join tile ON tile.job = frame.job AND tile.frame = frame.number
             WHERE frame.job = ? AND frame.state <> 'stored' AND tile.kind = 'render' AND tile.state = 'done'
             ORDER BY frame.number, tile.position LIMIT ?",
        )
        .bind(job)
        .bind(MAX_RECTANGLES)
        .fetch_all(&mut reading)
        .await?;
        drop(reading);
        let error: Option<String> = row.get("error")?;
        let snapshot = Snapshot {
            state: finish::job_state(&row.get::<String>("state")?)?,
            errors: error.into_iter().collect(),
            progress: rounding::fraction(row.get::<i64>("rays_peak")? as f64 / row.get::<i64>("rays_total")? as f64),
            tiles: DoneOfTotal { done: row.get("tiles_done")?, total: row.get("tiles_total")? },
            frames: DoneOfTotal { done: row.get("frames_stored")?, total: row.get("frames_total")? },
            stored: contiguous_ranges(&numbers),
            rectangles: tiles.iter().map(tile_event).collect::<Result<_>>()?,
        };
        Ok(Some((newest, snapshot)))
    }

    /// Prunes events of jobs that finished long ago, and the oldest beyond the maximum; returns the number
    /// pruned.
    pub(crate) async fn prune_events(&self) -> Result<u64> {
        let ended_before_ms = self.clock.wall_ms() - RETENTION_MS;
        let mut count = 0;
        loop {
            let dropped = self
                .database
                .write(Durability::Relaxed, move |connection| {
                    Box::pin(async move { prune(connection, ended_before_ms).await })
                })
                .await?;
            count += dropped;
            if dropped == 0 {
                return Ok(count);
            }
        }
    }
}

#[cfg(test)]
impl Queue {
    /// Deletes the oldest events beyond the newest `keep`.
    pub(crate) async fn prune_surplus(&self, keep: i64) -> Result<u64> {
        self.database
            .write(Durability::Relaxed, move |connection| {
                Box::pin(async move { prune_surplus(connection, keep).await })
            })
            .await
    }
}

fn tile_event(row: &Row) -> Result<TileEvent> {
    Ok(TileEvent {
        frame: row.get("frame")?,
        x: row.get("x_px")?,
        y: row.get("y_px")?,
        width: row.get("width_px")?,
        height: row.get("height_px")?,
        done: true,
    })
}

/// First and last of each run of consecutive numbers.
fn contiguous_ranges(numbers: &[u32]) -> Vec<[u32; 2]> {
    let mut runs: Vec<[u32; 2]> = Vec::new();
    for &number in numbers {
        match runs.last_mut() {
            Some([_, last]) if *last + 1 == number => *last = number,
            Some(_) | None => runs.push([number, number]),
        }
    }
    runs
}

/// Deletes the oldest events of a job that ended long ago, or of all jobs; returns how many, or 1 if there was none of
/// the job.
async fn prune(connection: &mut Connection, ended_before_ms: i64) -> Result<u64> {
    let job: Option<i64> = db::query_scalar(
        "SELECT number FROM job WHERE events_kept = 1 AND finished_at_ms IS NOT NULL AND finished_at_ms < ? LIMIT 1",
    )
    .bind(ended_before_ms)
    .fetch_optional(&mut *connection)
    .await?;
    let Some(job) = job else { return prune_surplus(connection, MAX_EVENTS).await };
    let last: Option<i64> = db::query_scalar(
        "SELECT max(number) FROM (SELECT number FROM outbox WHERE job = ? ORDER BY number LIMIT ?) AS oldest",
    )
    .bind(job)
    .bind(EVENTS_BATCH)
    .fetch_one(&mut *connection)
    .await?;
    db::query(
        "UPDATE job SET events_pruned = coalesce(?1, events_pruned),
                        events_kept = CAST(EXISTS (SELECT 1 FROM outbox WHERE outbox.job = ?2 AND outbox.number > ?1) AS INTEGER)
         WHERE number = ?2",
    )
    .bind(last)
    .bind(job)
    .execute(&mut *connection)
    .await?;
    let dropped =
        db::query("DELETE FROM outbox WHERE job = ? AND number <= ?").bind(job).bind(last).execute(connection).await?;
    Ok(dropped.rows_affected().max(1))
}

/// Deletes the oldest events beyond the newest `keep`.
async fn prune_surplus(connection: &mut Connection, keep: i64) -> Result<u64> {
    let ends = db::query("SELECT min(number) AS oldest, coalesce(max(number), 0) AS newest FROM outbox");
    let ends = ends.fetch_one(&mut *connection).await?;
    let (oldest, newest): (Option<i64>, i64) = (ends.get("oldest")?, ends.get("newest")?);
    let Some(oldest) = oldest.filter(|oldest| newest - oldest >= keep) else { return Ok(0) };
    let last = (oldest + EVENTS_BATCH - 1).min(newest - keep);
    db::query("UPDATE job SET events_pruned = ?1 WHERE number IN (SELECT job FROM outbox WHERE number <= ?1)")
        .bind(last)
        .execute(&mut *connection)
        .await?;
    let dropped = db::query("DELETE FROM outbox WHERE number <= ?").bind(last).execute(connection).await?;
    Ok(dropped.rows_affected())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_reported_by_first_and_last() {
        assert_eq!(contiguous_ranges(&[]), Vec::<[u32; 2]>::new());
        assert_eq!(contiguous_ranges(&[0, 1, 2, 5, 7, 8]), [[0, 2], [5, 5], [7, 8]]);
    }
}
