//! The farm's throughput by minutes of the wall clock, kept for a week.
//!
//! Each server adds what its workers have rendered in a minute to the minute's row; the counts of workers and jobs are
//! the first server's that writes it.

use proto::history::{HistoryPoint, HistoryView};
use proto::rounding;

use crate::clock::rfc3339;
use crate::db::{self, Durability};
use crate::queue::{Connection, Queue, QueueStats, Result};

/// Length of a minute.
const MINUTE_MS: i64 = 60_000;
/// Time for which rows are kept.
const KEPT_MS: i64 = 7 * 24 * 60 * MINUTE_MS;

/// Ready workers with a live lease.
const BUSY_SQL: &str = "SELECT count(*) FROM worker WHERE state <> 'gone' AND state = 'ready' AND EXISTS (
         SELECT 1 FROM lease @index(lease_live_by_worker) WHERE lease.worker = worker.id AND lease.ended IS NULL)";

/// Results of workers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Rendered {
    /// Camera rays.
    pub(crate) rays: u64,
    /// Tiles.
    pub(crate) tiles: u64,
    /// Pictures of frames.
    pub(crate) frames: u64,
}

impl Rendered {
    /// Adds others.
    pub(crate) fn add(&mut self, other: Self) {
        self.rays += other.rays;
        self.tiles += other.tiles;
        self.frames += other.frames;
    }
}

/// A row.
#[derive(Clone, Copy, Debug, Default)]
struct Minute {
    at_ms: i64,
    rendered: Rendered,
    workers: i64,
    busy: i64,
    queued_tiles: i64,
    jobs_queued: i64,
    jobs_running: i64,
}

async fn record(connection: &mut Connection, minute: Minute) -> Result<()> {
    let number = |count: u64| i64::try_from(count).unwrap_or(i64::MAX);
    db::query(
        "INSERT INTO minute (at_ms, rays, tiles, frames, workers, busy, queued_tiles, jobs_queued, jobs_running)
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)
         ON CONFLICT (at_ms) DO UPDATE SET rays = minute.rays + excluded.rays, tiles = minute.tiles + excluded.tiles,
                                           frames = minute.frames + excluded.frames",
    )
    .bind(minute.at_ms)
    .bind(number(minute.rendered.rays))
    .bind(number(minute.rendered.tiles))
    .bind(number(minute.rendered.frames))
    .bind(minute.workers)
    .bind(minute.busy)
    .bind(minute.queued_tiles)
    .bind(minute.jobs_queued)
    .bind(minute.jobs_running)
    .execute(&mut *connection)
    .await?;
    db::query("DELETE FROM minute WHERE at_ms < ?").bind(minute.at_ms - KEPT_MS).execute(connection).await?;
    Ok(())
}

impl Queue {
    /// Begin of the current minute of the wall clock.
    pub(crate) fn minute_ms(&self) -> i64 {
        self.clock.wall_ms().div_euclid(MINUTE_MS) * MINUTE_MS
    }

    /// Records what this server's workers have rendered in a minute, and the state of the farm now.
    pub(crate) async fn record_minute(&self, at_ms: i64, rendered: Rendered) -> Result<()> {
        let counts: QueueStats = self.counts().await?;
        let busy: i64 = db::query_scalar(BUSY_SQL).fetch_one(self.readers()).await?;
        let ready = counts.workers.iter().filter(|workers| workers.state == "ready");
        let minute = Minute {
            at_ms,
            rendered,
            workers: ready.map(|workers| workers.number).sum(),
            busy,
            queued_tiles: (counts.tiles_left - counts.leases).max(0),
            jobs_queued: counts.jobs_in("queued"),
            jobs_running: counts.jobs_in("running"),
        };
        self.database.write(Durability::Relaxed, move |connection| Box::pin(record(connection, minute))).await
    }

    /// Throughput of the last `seconds`, up to the last full minute, in at most `points` steps of whole minutes.
    pub(crate) async fn history(&self, seconds: u32, points: u32) -> Result<HistoryView> {
        let minutes = seconds.div_ceil(60);
        let step = minutes.div_ceil(points);
        let step_ms = i64::from(step) * MINUTE_MS;
        let end_ms = self.minute_ms();
        let begin_ms = end_ms - step_ms * i64::from(minutes.div_ceil(step));
        let rows = db::query(
            "SELECT at_ms, rays, tiles, frames, workers, busy, queued_tiles, jobs_queued, jobs_running FROM minute
             WHERE at_ms >= ? AND at_ms < ? ORDER BY at_ms",
        )
        .bind(begin_ms)
        .bind(end_ms)
        .fetch_all(self.readers())
        .await?;
        let mut steps = vec![(Minute::default(), 0_u32); minutes.div_ceil(step) as usize];
        for row in &rows {
            let index = usize::try_from((row.get::<i64>("at_ms")? - begin_ms) / step_ms).ok();
            let Some((sum, count)) = index.and_then(|index| steps.get_mut(index)) else { continue };
            *count += 1;
            sum.rendered.add(Rendered { rays: row.get("rays")?, tiles: row.get("tiles")?, frames: row.get("frames")? });
            sum.workers += row.get::<i64>("workers")?;
            sum.busy += row.get::<i64>("busy")?;
            sum.queued_tiles += row.get::<i64>("queued_tiles")?;
            sum.jobs_queued += row.get::<i64>("jobs_queued")?;
            sum.jobs_running += row.get::<i64>("jobs_running")?;
        }
        let points = (0_i64..).zip(&steps).map(|(index, (sum, count))| point(begin_ms + index * step_ms, sum, *count));
        Ok(HistoryView { step_seconds: step * 60, points: points.collect() })
    }
}

/// A step, from the sums of its rows.
fn point(at_ms: i64, sum: &Minute, count: u32) -> HistoryPoint {
    let mean = |value: i64| rounding::fraction(value as f64 / f64::from(count.max(1)));
    HistoryPoint {
        at: rfc3339(at_ms),
        rays: sum.rendered.rays,
        tiles: sum.rendered.tiles,
        frames: sum.rendered.frames,
        workers: mean(sum.workers),
        busy: rounding::fraction(sum.busy as f64 / sum.workers.max(1) as f64),
        queued_tiles: mean(sum.queued_tiles),
        jobs_queued: mean(sum.jobs_queued),
        jobs_running: mean(sum.jobs_running),
    }
}
