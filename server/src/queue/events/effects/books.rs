//! Books that follow from jobs and leases: the backlog of each submitter, fair shares, and charges.

use std::collections::BTreeMap;

use super::EndedLease;
use crate::db;
use crate::queue::jobs::fair_share::MAX_SERVED_US;
use crate::queue::{Connection, Result};

/// Adds an unfinished job to the backlog, of its submitter and (as `*`) of all.
pub(super) async fn grow_backlog(connection: &mut Connection, submitter: &str, rays: i64) -> Result<()> {
    db::query(
        "INSERT INTO backlog (submitter, jobs, rays) VALUES (?1, 1, ?2), ('*', 1, ?2)
         ON CONFLICT (submitter) DO UPDATE SET jobs = backlog.jobs + 1, rays = backlog.rays + excluded.rays",
    )
    .bind(submitter)
    .bind(rays)
    .execute(connection)
    .await?;
    Ok(())
}

/// Removes a job from the backlog; a submitter without unfinished jobs has no row.
pub(super) async fn shrink_backlog(connection: &mut Connection, submitter: &str, rays: i64) -> Result<()> {
    let rows = db::query(
        "UPDATE backlog SET jobs = jobs - 1, rays = rays - ?1 WHERE submitter IN (?2, '*')
         RETURNING submitter = ?2 AND jobs = 0",
    )
    .bind(rays)
    .bind(submitter)
    .scalar::<bool>()
    .fetch_all(&mut *connection)
    .await?;
    if rows.contains(&true) {
        db::query("DELETE FROM backlog WHERE submitter = ?").bind(submitter).execute(connection).await?;
    }
    Ok(())
}

/// Counts a job whose tiles may be leased in its share. A submitter without another one starts where the submitter
/// stands that was served last.
pub(super) async fn join_share(connection: &mut Connection, submitter: &str, priority: i64) -> Result<()> {
    db::query(
        "INSERT INTO share (submitter, priority, jobs, served_us)
         VALUES (?1, ?2, 1,
                 coalesce((SELECT share_clock.served_us FROM share_clock WHERE share_clock.priority = ?2), 0))
         ON CONFLICT (submitter, priority) DO UPDATE SET
             jobs = share.jobs + 1,
             served_us = CASE WHEN share.jobs = 0 THEN @max(share.served_us, excluded.served_us)
                              ELSE share.served_us END",
    )
    .bind(submitter)
    .bind(priority)
    .execute(connection)
    .await?;
    Ok(())
}

/// Counts a job no more in its share.
pub(super) async fn leave_share(connection: &mut Connection, submitter: &str, priority: i64) -> Result<()> {
    db::query("UPDATE share SET jobs = jobs - 1 WHERE submitter = ? AND priority = ?")
        .bind(submitter)
        .bind(priority)
        .execute(connection)
        .await?;
    Ok(())
}

/// Corrects charges by the time that was used, once for each share.
///
/// Only the sum is clamped. That differs from clamping after each lease only for a share that is within one
/// correction of 0 or of the maximum, where one lease of the list would have clamped what another gives back.
pub(super) async fn correct_charges(connection: &mut Connection, leases: &[EndedLease]) -> Result<()> {
    let mut shares: BTreeMap<(&str, i64), i64> = BTreeMap::new();
    for lease in leases {
        let by_us = lease.used_us.map_or(0, |used_us| used_us - lease.charged_us);
        *shares.entry((&lease.submitter, lease.priority)).or_default() += by_us;
    }
    let rows: Vec<(&str, i64, i64)> =
        shares.into_iter().filter(|(_, by_us)| *by_us != 0).map(|(key, by_us)| (key.0, key.1, by_us)).collect();
    if rows.is_empty() {
        return Ok(());
    }
    db::query(
        "UPDATE share
         SET served_us = @max(0, @min(CAST(?1 AS BIGINT), share.served_us + CAST(listed.value ->> 2 AS BIGINT)))
         FROM @rows(?2)
         WHERE share.submitter = listed.value ->> 0 AND share.priority = CAST(listed.value ->> 1 AS BIGINT)",
    )
    .bind(MAX_SERVED_US)
    .bind(serde_json::json!(rows).to_string())
    .execute(connection)
    .await?;
    Ok(())
}
