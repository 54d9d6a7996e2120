//! Recovery at startup: repairs the state that the last server left, and prunes old rows.

use crate::db;
use crate::queue::events::gaps;
use crate::queue::frames::makers;
use crate::queue::jobs::fair_share;
use crate::queue::workers::{exclusion, speeds};
use crate::queue::{Connection, Result, json_list, row_count, servers, verification};

/// Retention of ended leases, to recognize late results.
const LEASE_RETENTION_MS: u64 = 3_600_000;

/// State left by the last server.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Recovery {
    /// Boot generation of the server.
    pub(crate) generation: i64,
    /// Number of unfinished jobs.
    pub(crate) jobs: i64,
    /// Number of leases of the old pool that were ended.
    pub(crate) leases: i64,
}

/// A server that starts.
#[derive(Clone, Debug)]
pub(in crate::queue) struct StartingServer {
    /// Name of its data folder.
    pub(in crate::queue) name: String,
    /// Whether other servers may use the database: then the times in it last.
    pub(in crate::queue) may_have_others: bool,
    /// The time.
    pub(in crate::queue) now_ms: i64,
    /// The wall clock.
    pub(in crate::queue) wall_ms: i64,
    /// Length of a lease.
    pub(in crate::queue) lease_ms: i64,
}

/// Repairs the state at startup. A server that has ended took its pool with it, so its pool's leases end at once. If no
/// other server runs, no worker could renew a lease: remote workers' leases last for one more lease length from now, on
/// a clock that may have started now.
pub(in crate::queue) async fn recover(connection: &mut Connection, start: &StartingServer) -> Result<Recovery> {
    let &StartingServer { now_ms, lease_ms, .. } = start;
    let generation: i64 =
        db::query_scalar("UPDATE meta SET value = value + 1 WHERE name = 'boot_generation' RETURNING value")
            .fetch_one(&mut *connection)
            .await?;
    gaps::check_restored(connection).await?;
    gaps::check_identity(connection).await?;
    let others = servers::begin(connection, start, generation).await?;
    let leases = servers::hand_back(connection, start.wall_ms).await?;
    if others == 0 {
        db::query("UPDATE lease SET granted_ms = ?, expires_ms = ? WHERE ended IS NULL")
            .bind(now_ms)
            .bind(now_ms + lease_ms)
            .execute(&mut *connection)
            .await?;
        db::query("UPDATE worker SET seen_ms = ? WHERE state <> 'gone'").bind(now_ms).execute(&mut *connection).await?;
        db::query("UPDATE tile SET not_before_ms = 0 WHERE state = 'ready' AND not_before_ms > 0")
            .execute(&mut *connection)
            .await?;
        exclusion::recover(connection, now_ms).await?;
        speeds::recover(connection, now_ms).await?;
        verification::reset_after_restart(connection, now_ms).await?;
    }
    let jobs = db::query("SELECT count(*) AS jobs FROM job WHERE finished_at_ms IS NULL").fetch_one(connection).await?;
    Ok(Recovery { generation, jobs: jobs.get("jobs")?, leases })
}

/// Deletes leases that ended long ago, after the makers of their tiles are recorded, and workers that are gone and have
/// none: at most `limit` of each. Returns whether there may be more.
pub(in crate::queue) async fn tidy(connection: &mut Connection, limit: i64) -> Result<bool> {
    let old: Vec<String> = db::query_scalar(
        "SELECT id FROM lease WHERE ended IS NOT NULL AND id < ? AND id NOT IN (SELECT lease FROM verification)
             ORDER BY id LIMIT ?",
    )
    .bind(min_kept_id(uuid::Uuid::now_v7()))
    .bind(limit)
    .fetch_all(&mut *connection)
    .await?;
    let leases = row_count(old.len());
    let old = json_list(old);
    makers::record(connection, &old).await?;
    db::query("DELETE FROM lease WHERE id IN (SELECT value FROM @texts(?))")
        .bind(old)
        .execute(&mut *connection)
        .await?;
    let workers = db::query(
        "DELETE FROM worker WHERE id IN (SELECT id FROM worker WHERE state = 'gone'
             AND NOT EXISTS (SELECT 1 FROM lease WHERE lease.worker = worker.id) LIMIT ?)",
    )
    .bind(limit)
    .execute(&mut *connection)
    .await?;
    fair_share::tidy(connection).await?;
    let is_more = leases >= limit || workers.rows_affected() >= limit.unsigned_abs();
    if !is_more {
        makers::tidy(connection).await?;
    }
    Ok(is_more)
}

/// Smallest lease id that is kept; ids contain their time.
pub(in crate::queue) fn min_kept_id(now: uuid::Uuid) -> String {
    let now_ms = now.as_u128() >> 80;
    let kept_ms = now_ms.saturating_sub(u128::from(LEASE_RETENTION_MS));
    uuid::Uuid::from_u128(kept_ms << 80).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leases_of_the_last_hour_are_kept() {
        let now = uuid::Uuid::now_v7();
        let oldest = min_kept_id(now);
        assert!(oldest < now.to_string());
        assert_eq!((now.as_u128() >> 80) - (oldest.parse::<uuid::Uuid>().expect("an id").as_u128() >> 80), 3_600_000);
    }
}
