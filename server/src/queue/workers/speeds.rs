//! Speed of each worker in each job, measured by the server from grants to results: a worker is fast in one scene
//! and slow in another.
//!
//! A worker's own report, its speed over all scenes lately, counts only where nothing was measured in the job.

use crate::db;
use crate::queue::{Connection, Result, TransitionContext};

/// Measurements older than about this have almost no weight.
const DECAY_SECONDS: f64 = 16.0;
/// A measurement older than this is not used.
pub(in crate::queue) const MAX_AGE_MS: i64 = 600_000;
/// A worker is slow if another one is this many times as fast.
const SLOW_RATIO: f64 = 4.0;
/// A shorter time is not measured: the server's clock has milliseconds.
const MIN_SECONDS: f64 = 0.001;
/// Maximum number of rays in a measurement.
const MAX_RAYS: f64 = 1e18;
/// Maximum time in a measurement, in seconds.
const MAX_SECONDS: f64 = 1e6;

/// Speed of a worker, in camera rays per second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::queue) enum JobSpeed {
    /// Measured in the job.
    Measured(f64),
    /// The worker's own report, over all scenes lately.
    Overall(f64),
}

impl JobSpeed {
    /// Camera rays per second.
    pub(in crate::queue) fn get(self) -> f64 {
        match self {
            Self::Measured(speed) | Self::Overall(speed) => speed,
        }
    }
}

/// A measured speed, as SQL over a row of `speed`: bounded, and 50 ms are added to the measured time, so that one
/// very short batch does not produce a huge speed.
macro_rules! measured_sql {
    () => {
        "CASE WHEN speed.rays IS NOT NULL THEN @min(1e15, @max(1.0, speed.rays / (speed.seconds + 0.05))) END"
    };
}
pub(in crate::queue) use measured_sql;

/// Records rays that a worker rendered in a job, and the time it used for them.
pub(in crate::queue) async fn record(
    connection: &mut Connection,
    worker: &str,
    job: i64,
    rays: f64,
    seconds: f64,
    context: TransitionContext,
) -> Result<()> {
    if rays <= 0.0 || seconds < MIN_SECONDS {
        return Ok(());
    }
    db::query(
        "INSERT INTO speed (job, worker, rays, seconds, at_ms)
         SELECT number, ?2, ?3, ?4, ?5 FROM job WHERE number = ?1 AND finished_at_ms IS NULL
         ON CONFLICT (job, worker) DO UPDATE SET
             rays = @min(?7, speed.rays * ?6 + excluded.rays),
             seconds = @min(?8, speed.seconds * ?6 + excluded.seconds),
             at_ms = excluded.at_ms",
    )
    .bind(job)
    .bind(worker)
    .bind(rays.min(MAX_RAYS))
    .bind(seconds.clamp(0.0, MAX_SECONDS))
    .bind(context.now_ms)
    .bind((1.0 - seconds / DECAY_SECONDS).max(0.0))
    .bind(MAX_RAYS)
    .bind(MAX_SECONDS)
    .execute(connection)
    .await?;
    Ok(())
}

/// Speed of a lease's holder in a job, for the estimate of a straggler: measured in the job, of this worker or of the
/// fastest other one; otherwise reported.
pub(in crate::queue) async fn of_holder(
    connection: &mut Connection,
    worker: &str,
    job: i64,
    context: TransitionContext,
) -> Result<Option<JobSpeed>> {
    let row = db::query(concat!(
        "SELECT max(",
        measured_sql!(),
        ") FILTER (WHERE speed.worker = ?2) AS own, max(",
        measured_sql!(),
        ") AS fastest, (SELECT rays_per_second FROM worker WHERE id = ?2) AS overall
         FROM speed WHERE job = ?1 AND at_ms > ?3"
    ))
    .bind(job)
    .bind(worker)
    .bind(context.now_ms - MAX_AGE_MS)
    .fetch_one(connection)
    .await?;
    let measured = row.get::<Option<f64>>("own")?.or(row.get("fastest")?);
    let overall: Option<f64> = row.get("overall")?;
    Ok(measured.map(JobSpeed::Measured).or(overall.map(JobSpeed::Overall)))
}

/// Whether a worker is far slower in a job than another ready one that was measured in it, or not measured itself; the
/// holder of a straggler does not count as the other one.
pub(in crate::queue) async fn is_slow(
    connection: &mut Connection,
    worker: &str,
    holder: &str,
    job: i64,
    context: TransitionContext,
) -> Result<bool> {
    let row = db::query(concat!(
        "SELECT max(",
        measured_sql!(),
        ") FILTER (WHERE speed.worker = ?2) AS own, max(",
        measured_sql!(),
        ") FILTER (WHERE speed.worker NOT IN (?2, ?3)) AS other
         FROM speed @join worker ON worker.id = speed.worker
         WHERE speed.job = ?1 AND at_ms > ?4 AND worker.state = 'ready'"
    ))
    .bind(job)
    .bind(worker)
    .bind(holder)
    .bind(context.now_ms - MAX_AGE_MS)
    .fetch_one(connection)
    .await?;
    let (own, other): (Option<f64>, Option<f64>) = (row.get("own")?, row.get("other")?);
    Ok(other.is_some_and(|other| own.is_none_or(|own| own * SLOW_RATIO < other)))
}

/// Restarts the ages at startup, because the server's clock starts at zero.
pub(in crate::queue) async fn recover(connection: &mut Connection, now_ms: i64) -> Result<()> {
    db::query("UPDATE speed SET at_ms = ?").bind(now_ms).execute(&mut *connection).await?;
    db::query("UPDATE worker SET delivered_ms = ? WHERE state <> 'gone'").bind(now_ms).execute(connection).await?;
    Ok(())
}
