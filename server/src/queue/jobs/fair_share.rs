//! Fair share between submitters: the worker time that each has been served, so that the least served is next.
//!
//! Start-time fair queueing (Goyal, Vin, Cheng, "Start-time Fair Queuing", SIGCOMM 1996): a submitter that
//! returns starts at the virtual time of the one served last. `effects` records which submitters have jobs that may be
//! leased. A batch is charged by an estimate when it is granted. When its leases end, `effects` corrects the charge by
//! the time that was used (`lease.used_us`).

use crate::db;
use std::collections::BTreeMap;

use crate::queue::workers::speeds::{self, JobSpeed};
use crate::queue::workers::state::{HeldLease, UsedLease, WorkerState};
use crate::queue::{Connection, Result, TransitionContext, expect_rows, row_count};

/// Maximum credit of a submitter whose jobs wait for something other than a worker.
const MAX_CREDIT_US: i64 = 60_000_000;
/// Maximum that a submitter can have been served: 146,000 years of a worker. The next charge does not overflow it.
pub(in crate::queue) const MAX_SERVED_US: i64 = 1 << 62;
/// Maximum charge for one lease: an hour.
pub(in crate::queue) const MAX_CHARGE_US: i64 = 3_600_000_000;
/// Maximum charge for a batch whose speed was not measured in its job, until its results correct the charge.
const MAX_GUESS_US: i64 = 10_000_000;
/// Assumed speed of a worker without a measurement, in camera rays per second.
pub(in crate::queue) const DEFAULT_RAYS_PER_SECOND: f64 = 1e6;

/// Submitter and cost of a batch.
#[derive(Clone, Debug)]
pub(in crate::queue) struct FairShare {
    /// Submitter of the job.
    pub(in crate::queue) submitter: String,
    /// The job's priority.
    pub(in crate::queue) priority: i64,
}

/// Charges for leases on tiles of these numbers of rays, in microseconds.
pub(in crate::queue) fn estimates_us(rays: &[u64], speed: Option<JobSpeed>) -> Vec<i64> {
    let guess_us = MAX_GUESS_US / row_count(rays.len()).max(1);
    let (rays_per_second, limit_us) = match speed {
        Some(JobSpeed::Measured(speed)) => (speed, MAX_CHARGE_US),
        Some(JobSpeed::Overall(speed)) => (speed, guess_us),
        None => (DEFAULT_RAYS_PER_SECOND, guess_us),
    };
    rays.iter().map(|&rays| ((rays as f64 / rays_per_second * 1e6).ceil() as i64).clamp(0, limit_us)).collect()
}

/// Charges a batch to its submitter.
pub(in crate::queue) async fn charge(connection: &mut Connection, share: &FairShare, charged_us: i64) -> Result<()> {
    let clock_us: i64 = db::query_scalar(
        "INSERT INTO share_clock (priority, served_us)
         SELECT priority, served_us FROM share WHERE submitter = ? AND priority = ?
         ON CONFLICT (priority) DO UPDATE SET served_us = @max(share_clock.served_us, excluded.served_us)
         RETURNING served_us",
    )
    .bind(&share.submitter)
    .bind(share.priority)
    .fetch_one(&mut *connection)
    .await?;
    let charged =
        db::query("UPDATE share SET served_us = @min(?, @max(served_us, ?) + ?) WHERE submitter = ? AND priority = ?")
            .bind(MAX_SERVED_US)
            .bind(clock_us - MAX_CREDIT_US)
            .bind(charged_us)
            .bind(&share.submitter)
            .bind(share.priority)
            .execute(connection)
            .await?;
    expect_rows("share: charged", 1, charged)
}

/// Times that were used for leases of one worker: the time since their grant, or since the worker's previous delivery if
/// that is later, divided among them by their charges.
fn divide(since_ms: impl Iterator<Item = i64>, charged_us: &[i64], context: TransitionContext) -> Vec<i64> {
    let since_ms = since_ms.min().unwrap_or(context.now_ms);
    let time_us = (context.now_ms - since_ms).max(0) as f64 * 1e3;
    // Stitches and duplicate leases have no estimate, but some weight.
    let weight = |charged_us: i64| charged_us.max(1) as f64;
    let weights: f64 = charged_us.iter().map(|charged_us| weight(*charged_us)).sum();
    let used_us = |charged_us: &i64| (time_us * weight(*charged_us) / weights) as i64;
    charged_us.iter().map(|charged_us| used_us(charged_us).clamp(0, MAX_CHARGE_US)).collect()
}

/// Times that a worker used for the leases that it delivers results for, and its speed in their jobs.
pub(in crate::queue) async fn record_delivery<'a>(
    connection: &mut Connection,
    worker: &WorkerState,
    delivered: &[&'a HeldLease],
    context: TransitionContext,
) -> Result<Vec<UsedLease<'a>>> {
    let since_ms = delivered.iter().map(|held| held.live.granted_ms.max(worker.delivered_ms));
    let charged_us: Vec<i64> = delivered.iter().map(|held| held.charged_us).collect();
    let times_us = divide(since_ms, &charged_us, context);
    let mut jobs: BTreeMap<i64, (f64, i64)> = BTreeMap::new();
    for (held, used_us) in delivered.iter().zip(&times_us) {
        let (rays, time_us) = jobs.entry(held.live.job).or_default();
        if held.rays > 0 {
            *rays += held.rays as f64;
            *time_us += used_us;
        }
    }
    for (job, (rays, time_us)) in jobs {
        speeds::record(connection, &worker.id, job, rays, time_us as f64 / 1e6, context).await?;
    }
    Ok(delivered.iter().zip(times_us).map(|(held, used_us)| UsedLease { held, used_us }).collect())
}

/// Live leases of a list, with the data that their used time depends on.
const USED_SQL: &str = "SELECT lease.id, lease.worker, lease.charged_us,
        @max(lease.granted_ms, worker.delivered_ms) AS since_ms
     FROM @texts(?) @join lease ON lease.id = listed.value @join worker ON worker.id = lease.worker
     WHERE @unindexed(lease.ended) IS NULL";

/// Stores the time that was used for live leases, which are about to end: the time since their grant, or since their
/// worker's previous delivery, divided among them by their estimates.
pub(in crate::queue) async fn store_used_time_of(
    connection: &mut Connection,
    leases: &str,
    context: TransitionContext,
) -> Result<()> {
    let rows = db::query(USED_SQL).bind(leases).fetch_all(&mut *connection).await?;
    let mut workers: BTreeMap<String, Vec<(String, i64, i64)>> = BTreeMap::new();
    for row in rows {
        let lease = (row.get("id")?, row.get("charged_us")?, row.get("since_ms")?);
        workers.entry(row.get("worker")?).or_default().push(lease);
    }
    let mut used = Vec::new();
    for leases in workers.values() {
        let charged_us: Vec<i64> = leases.iter().map(|(_, charged_us, _)| *charged_us).collect();
        let times_us = divide(leases.iter().map(|(_, _, since_ms)| *since_ms), &charged_us, context);
        used.extend(leases.iter().zip(times_us).map(|((lease, _, _), used_us)| (lease.as_str(), used_us)));
    }
    store_used_times(connection, &used).await
}

/// Stores the time that was used for live leases.
pub(in crate::queue) async fn store_used_times(connection: &mut Connection, used: &[(&str, i64)]) -> Result<()> {
    if used.is_empty() {
        return Ok(());
    }
    let stored = db::query(
        "UPDATE lease SET used_us = CAST(listed.value ->> 1 AS BIGINT) FROM @rows(?)
         WHERE lease.id = listed.value ->> 0 AND @unindexed(lease.ended) IS NULL",
    )
    .bind(serde_json::json!(used).to_string())
    .execute(connection)
    .await?;
    expect_rows("lease: time used", used.len() as u64, stored)
}

/// Deletes the shares of submitters without work that would start at the current virtual time anyway.
pub(in crate::queue) async fn tidy(connection: &mut Connection) -> Result<()> {
    db::query(
        "DELETE FROM share WHERE jobs = 0
         AND served_us <= (SELECT served_us FROM share_clock WHERE share_clock.priority = share.priority)",
    )
    .execute(connection)
    .await?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn charges_have_bounds() {
        let rays = [1 << 44, 1000, 0];
        assert_eq!(estimates_us(&rays, Some(JobSpeed::Measured(1.0))), [MAX_CHARGE_US, 1_000_000_000, 0]);
        assert_eq!(estimates_us(&rays, Some(JobSpeed::Overall(1.0))), [3_333_333, 3_333_333, 0]);
        assert_eq!(estimates_us(&rays, Some(JobSpeed::Measured(1e15))), [17_593, 1, 0]);
        assert_eq!(estimates_us(&[1_000_000], None), [1_000_000]);
    }
}
