//! Durations of a job's tiles from lease to result, to detect stragglers.

use crate::db;
use crate::queue::{Connection, Result};

/// Number of recorded deliveries of a job.
const WINDOW: i64 = 15;

/// Records the duration of a delivery of a job; `number` is the job's count of finished tiles.
pub(in crate::queue) async fn record_duration(
    connection: &mut Connection,
    job: i64,
    number: i64,
    took_ms: i64,
) -> Result<()> {
    db::query(
        "INSERT INTO pace (job, slot, took_ms) SELECT number, ?2, ?3 FROM job WHERE number = ?1 AND finished_at_ms IS NULL
         ON CONFLICT (job, slot) DO UPDATE SET took_ms = excluded.took_ms",
    )
    .bind(job)
    .bind(number.rem_euclid(WINDOW))
    .bind(took_ms.max(0))
    .execute(connection)
    .await?;
    Ok(())
}

/// Median of the recorded durations, in milliseconds.
pub(in crate::queue) async fn median_ms(connection: &mut Connection, job: i64) -> Result<Option<i64>> {
    db::query_scalar(
        "SELECT took_ms FROM pace WHERE job = ?1 ORDER BY took_ms
         LIMIT 1 OFFSET (SELECT count(*) / 2 FROM pace WHERE job = ?1)",
    )
    .bind(job)
    .fetch_optional(connection)
    .await
}
