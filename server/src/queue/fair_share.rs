//! Fair share between submitters: the worker time that each has been served, so that the least served is next.
//!
//! Start-time fair queueing (Goyal, Vin, Cheng, "Start-time Fair Queuing", SIGCOMM 1996): a submitter that
//! returns starts at the virtual time of the one served last. `effects` records which submitters have jobs that may be
//! leased. A batch is charged by an estimate when it is granted. When its leases end, `effects` corrects the charge by
//! the time that was used (`lease.used_us`).

use crate::db;
use std::collections::BTreeMap;

use proto::WorkerId;

use super::speeds::{self, JobSpeed};
use super::{Connection, Result, TransitionContext, expect_rows, row_count};

/// Maximum credit of a submitter whose jobs wait for something other than a worker.
const MAX_CREDIT_US: i64 = 60_000_000;
/// Maximum that a submitter can have been served: 146,000 years of a worker. The next charge does not overflow it.
pub(super) const MAX_SERVED_US: i64 = 1 << 62;
/// Maximum charge for one lease: an hour.
pub(super) const MAX_CHARGE_US: i64 = 3_600_000_000;
/// Maximum charge for a batch whose speed was not measured in its job, until its results correct the charge.
const MAX_GUESS_US: i64 = 10_000_000;
/// Assumed speed of a worker without a measurement, in camera rays per second.
pub(super) const DEFAULT_RAYS_PER_SECOND: f64 = 1e6;

/// Submitter and cost of a batch.
#[derive(Clone, Debug)]
pub(super) struct FairShare {
    /// Submitter of the job.
    pub(super) submitter: String,
    /// The job's priority.
    pub(super) priority: i64,
}

/// Charges for leases on tiles of these numbers of rays, in microseconds.
pub(super) fn estimates_us(rays: &[u64], speed: Option<JobSpeed>) -> Vec<i64> {
    let guess_us = MAX_GUESS_US / row_count(rays.len()).max(1);
    let (rays_per_second, limit_us) = match speed {
        Some(JobSpeed::Measured(speed)) => (speed, MAX_CHARGE_US),
        Some(JobSpeed::Overall(speed)) => (speed, guess_us),
        None => (DEFAULT_RAYS_PER_SECOND, guess_us),
    };
    rays.iter().map(|&rays| ((rays as f64 / rays_per_second * 1e6).ceil() as i64).clamp(0, limit_us)).collect()
}

/// Charges a batch to its submitter.
pub(super) async fn charge(connection: &mut Connection, share: &FairShare, charged_us: i64) -> Result<()> {
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

/// Live lease whose used time becomes known.
struct UsedLease {
    lease: String,
    worker: String,
    job: i64,
    /// Camera rays; 0 for a stitch.
    rays: f64,
    charged_us: i64,
    /// Time of its grant, or of its worker's previous delivery if that is later.
    since_ms: i64,
}

/// Live leases of a list, with the data that their used time depends on.
const USED_SQL: &str = "SELECT lease.id, lease.worker, tile.job, tile.rays, lease.charged_us,
        @max(lease.granted_ms, worker.delivered_ms) AS since_ms
     FROM @texts(?) @join lease ON lease.id = listed.value
     @join worker ON worker.id = lease.worker @join tile ON tile.id = lease.tile
     WHERE @unindexed(lease.ended) IS NULL AND (?2 IS NULL OR lease.worker = ?2)";

/// Stores the time that a worker used for results, before they end their leases, and its speed in their jobs.
pub(super) async fn record_delivery(
    connection: &mut Connection,
    worker: WorkerId,
    leases: &str,
    moment: TransitionContext,
) -> Result<()> {
    let worker = worker.to_string();
    let mut jobs: BTreeMap<i64, (f64, i64)> = BTreeMap::new();
    for (lease, used_us) in store_used_time(connection, leases, Some(&worker), moment).await? {
        let (rays, time_us) = jobs.entry(lease.job).or_default();
        if lease.rays > 0.0 {
            *rays += lease.rays;
            *time_us += used_us;
        }
    }
    if jobs.is_empty() {
        return Ok(());
    }
    for (job, (rays, time_us)) in jobs {
        speeds::record(connection, &worker, job, rays, time_us as f64 / 1e6, moment).await?;
    }
    let delivered = db::query("UPDATE worker SET delivered_ms = ? WHERE id = ?")
        .bind(moment.now_ms)
        .bind(&worker)
        .execute(connection)
        .await?;
    expect_rows("worker: delivered", 1, delivered)
}

/// Stores the time that was used for live leases, which are about to end: the time since their grant, or since their
/// worker's previous delivery, divided among them by their estimates.
pub(super) async fn store_used_time_of(
    connection: &mut Connection,
    leases: &str,
    moment: TransitionContext,
) -> Result<()> {
    store_used_time(connection, leases, None, moment).await.map(drop)
}

async fn store_used_time(
    connection: &mut Connection,
    leases: &str,
    worker: Option<&str>,
    moment: TransitionContext,
) -> Result<Vec<(UsedLease, i64)>> {
    let rows = db::query(USED_SQL).bind(leases).bind(worker).fetch_all(&mut *connection).await?;
    let mut workers: BTreeMap<String, Vec<UsedLease>> = BTreeMap::new();
    for row in rows {
        let lease = UsedLease {
            lease: row.get("id")?,
            worker: row.get("worker")?,
            job: row.get("job")?,
            rays: row.get::<i64>("rays")? as f64,
            charged_us: row.get("charged_us")?,
            since_ms: row.get("since_ms")?,
        };
        workers.entry(lease.worker.clone()).or_default().push(lease);
    }
    let mut used = Vec::new();
    for leases in workers.into_values() {
        let since_ms = leases.iter().map(|lease| lease.since_ms).min().unwrap_or(moment.now_ms);
        let time_us = (moment.now_ms - since_ms).max(0) as f64 * 1e3;
        // Stitches and duplicate leases have no estimate, but some weight.
        let weight = |lease: &UsedLease| lease.charged_us.max(1) as f64;
        let weights: f64 = leases.iter().map(weight).sum();
        for lease in leases {
            let used_us = (time_us * weight(&lease) / weights) as i64;
            used.push((lease, used_us.clamp(0, MAX_CHARGE_US)));
        }
    }
    if used.is_empty() {
        return Ok(used);
    }
    let pairs: Vec<(&str, i64)> = used.iter().map(|(lease, used_us)| (lease.lease.as_str(), *used_us)).collect();
    let stored = db::query(
        "UPDATE lease SET used_us = CAST(listed.value ->> 1 AS BIGINT) FROM @rows(?)
         WHERE lease.id = listed.value ->> 0 AND @unindexed(lease.ended) IS NULL",
    )
    .bind(serde_json::json!(pairs).to_string())
    .execute(connection)
    .await?;
    expect_rows("lease: time used", used.len() as u64, stored)?;
    Ok(used)
}

/// Deletes the shares of submitters without work that would start at the current virtual time anyway.
pub(super) async fn tidy(connection: &mut Connection) -> Result<()> {
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
