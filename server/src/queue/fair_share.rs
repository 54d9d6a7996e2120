//! Fair share between submitters: the worker time that each has been served, so that the least served is next.
//!
//! Start-time fair queueing (Goyal, Vin, Cheng, "Start-time Fair Queuing", SIGCOMM 1996): a submitter that
//! returns starts at the virtual time of the one served last. Triggers record which submitters have ready work.

use super::{Connection, Result, expect_rows};

/// Maximum credit of a submitter whose jobs wait for something other than a worker.
const MAX_CREDIT_US: i64 = 60_000_000;
/// Assumed speed of a worker without a measurement, in camera rays per second.
const DEFAULT_RAYS_PER_SECOND: f64 = 1e6;

/// Submitter and cost of a batch.
#[derive(Clone, Debug)]
pub(super) struct FairShare {
    /// Submitter of the job.
    pub(super) submitter: String,
    /// The job's priority.
    pub(super) priority: i64,
}

/// Charges a batch to its submitter.
pub(super) async fn charge(
    connection: &mut Connection,
    share: &FairShare,
    rays: u64,
    rays_per_second: Option<f64>,
) -> Result<()> {
    let served_us = (rays as f64 / rays_per_second.unwrap_or(DEFAULT_RAYS_PER_SECOND) * 1e6).ceil() as i64;
    let clock_us: i64 = sqlx::query_scalar(
        "INSERT INTO share_clock (priority, served_us)
         SELECT priority, served_us FROM share WHERE submitter = ? AND priority = ?
         ON CONFLICT (priority) DO UPDATE SET served_us = max(served_us, excluded.served_us)
         RETURNING served_us",
    )
    .bind(&share.submitter)
    .bind(share.priority)
    .fetch_one(&mut *connection)
    .await?;
    let charged =
        sqlx::query("UPDATE share SET served_us = max(served_us, ?) + ? WHERE submitter = ? AND priority = ?")
            .bind(clock_us - MAX_CREDIT_US)
            .bind(served_us)
            .bind(&share.submitter)
            .bind(share.priority)
            .execute(connection)
            .await?;
    expect_rows("share: charged", 1, &charged)
}

/// Deletes the shares of submitters without work that would start at the current virtual time anyway.
pub(super) async fn tidy(connection: &mut Connection) -> Result<()> {
    sqlx::query(
        "DELETE FROM share WHERE jobs = 0
         AND served_us <= (SELECT served_us FROM share_clock WHERE share_clock.priority = share.priority)",
    )
    .execute(connection)
    .await?;
    Ok(())
}
