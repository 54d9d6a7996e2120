//! Fair share between submitters: what each was served, in a worker's time, so that the least served is next.
//!
//! Start-time fair queueing (Goyal, Vin, Cheng, "Start-time Fair Queuing", SIGCOMM 1996): a submitter that
//! comes back starts where the one stood that was served last. Triggers keep which submitters take part.

use super::{Connection, Result, counted};

/// Credit that a submitter may save up while its jobs wait for something else than their turn.
const MAX_CREDIT_US: i64 = 60_000_000;
/// What a worker is taken for whose speed is not known, in camera rays a second.
const UNKNOWN_RAYS_PER_SECOND: f64 = 1e6;

/// Whom a run is for.
#[derive(Clone, Debug)]
pub(super) struct Share {
    /// Who handed the job in.
    pub(super) submitter: String,
    /// The job's priority.
    pub(super) priority: i64,
}

/// Charges a run to its submitter.
pub(super) async fn charge(
    connection: &mut Connection,
    share: &Share,
    rays: u64,
    rays_per_second: Option<f64>,
) -> Result<()> {
    let served_us = (rays as f64 / rays_per_second.unwrap_or(UNKNOWN_RAYS_PER_SECOND) * 1e6).ceil() as i64;
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
    counted("share: charged", 1, &charged)
}

/// Drops the shares of submitters that have nothing to do and would start anew anyway.
pub(super) async fn tidy(connection: &mut Connection) -> Result<()> {
    sqlx::query(
        "DELETE FROM share WHERE jobs = 0
         AND served_us <= (SELECT served_us FROM share_clock WHERE share_clock.priority = share.priority)",
    )
    .execute(connection)
    .await?;
    Ok(())
}
