//! Leases of verifications: granted, renewed, released. None of them changes a tile.

use crate::db;
use std::collections::HashSet;

use proto::LeaseId;

use crate::queue::leases::batch_size;
use crate::queue::{Connection, Result, TransitionContext, Wake, expect_rows, json_list, json_numbers};

/// A lease granted in a response that the worker never received is released after this time.
const UNHEARD_LEASE_MS: i64 = 2000;
/// A result that no worker could verify for this long is old.
pub(super) const MAX_RECENT_MS: i64 = 600_000;

/// A result whose verification failed this many times is given up.
const MAX_FAILURES: i64 = 3;

/// Leases results to a verifier: number of the verification, lease, and position of the tile.
pub(super) async fn grant(
    connection: &mut Connection,
    worker: &str,
    granted: &[(i64, LeaseId, i64)],
    context: TransitionContext,
) -> Result<()> {
    db::query(
        "UPDATE verification SET verifier = ?, granted_ms = ?, expires_ms = ?
         WHERE verifier IS NULL AND number IN (SELECT value FROM @numbers(?))",
    )
    .bind(worker)
    .bind(context.now_ms)
    .bind(context.now_ms + context.lease_ms)
    .bind(json_numbers(granted.iter().map(|(number, _, _)| *number)))
    .execute(&mut *connection)
    .await?;
    let rows: Vec<_> = granted.iter().map(|(number, lease, position)| (lease.to_string(), number, position)).collect();
    let made = db::query(
        "INSERT INTO verification_lease (id, verification, position)
         SELECT value ->> 0, CAST(value ->> 1 AS BIGINT), CAST(value ->> 2 AS BIGINT) FROM @rows(?)",
    )
    .bind(serde_json::json!(rows).to_string())
    .execute(connection)
    .await?;
    expect_rows("verification: leased", granted.len() as u64, made)
}

/// Live leases of a worker on verifications.
pub(super) async fn live_lease_ids(connection: &mut Connection, worker: &str) -> Result<HashSet<String>> {
    let ids: Vec<String> = db::query_scalar(
        "SELECT id FROM verification JOIN verification_lease ON verification = number WHERE verifier = ?",
    )
    .bind(worker)
    .fetch_all(connection)
    .await?;
    Ok(ids.into_iter().collect())
}

/// Renews the verifications of the leases that a worker lists, and releases those that it never received.
pub(in crate::queue) async fn renew(
    connection: &mut Connection,
    worker: &str,
    held: &[String],
    context: TransitionContext,
) -> Result<Wake> {
    db::query(
        "UPDATE verification SET expires_ms = ?1 WHERE verifier = ?2 AND EXISTS (
             SELECT 1 FROM verification_lease
             WHERE verification = number AND id IN (SELECT value FROM @texts(?3)))",
    )
    .bind(context.now_ms + context.lease_ms)
    .bind(worker)
    .bind(json_list(held))
    .execute(&mut *connection)
    .await?;
    let unheard: Vec<i64> = db::query_scalar(
        "SELECT number FROM verification WHERE verifier = ?1 AND granted_ms <= ?2 AND NOT EXISTS (
             SELECT 1 FROM verification_lease
             WHERE verification = number AND id IN (SELECT value FROM @texts(?3)))",
    )
    .bind(worker)
    .bind(context.now_ms - UNHEARD_LEASE_MS)
    .bind(json_list(held))
    .fetch_all(&mut *connection)
    .await?;
    release(connection, &unheard).await
}

/// Makes verifications wait for another worker.
pub(super) async fn release(connection: &mut Connection, numbers: &[i64]) -> Result<Wake> {
    if numbers.is_empty() {
        return Ok(Wake::default());
    }
    for statement in [
        "DELETE FROM verification_lease WHERE verification IN (SELECT value FROM @numbers(?))",
        "UPDATE verification SET verifier = NULL, granted_ms = NULL, expires_ms = NULL
         WHERE number IN (SELECT value FROM @numbers(?))",
    ] {
        db::query(statement).bind(json_numbers(numbers.iter().copied())).execute(&mut *connection).await?;
    }
    Ok(Wake::WORK)
}

/// Releases all verifications of a worker that is leaving.
pub(in crate::queue) async fn release_of(connection: &mut Connection, worker: &str) -> Result<Wake> {
    let numbers: Vec<i64> = db::query_scalar("SELECT number FROM verification WHERE verifier = ?")
        .bind(worker)
        .fetch_all(&mut *connection)
        .await?;
    release(connection, &numbers).await
}

/// Releases the verification of each of these leases.
pub(super) async fn release_all(connection: &mut Connection, leases: &[String]) -> Result<Wake> {
    let numbers: Vec<i64> = db::query_scalar(
        "SELECT DISTINCT verification FROM verification_lease WHERE id IN (SELECT value FROM @texts(?))",
    )
    .bind(json_list(leases))
    .fetch_all(&mut *connection)
    .await?;
    release(connection, &numbers).await
}

/// Releases overdue verifications. Old pictures of stitches are verified by rendering their frames again, because their
/// blobs are not kept for longer; pictures of frames too large for it are given up, and their number returned.
pub(in crate::queue) async fn expire(connection: &mut Connection, context: TransitionContext) -> Result<(u64, Wake)> {
    let expired: Vec<i64> = db::query_scalar("SELECT number FROM verification WHERE expires_ms <= ?")
        .bind(context.now_ms)
        .fetch_all(&mut *connection)
        .await?;
    let old_ms = context.now_ms - MAX_RECENT_MS;
    db::query(
        "UPDATE verification SET position = -2 WHERE position = -1 AND verifier IS NULL AND created_ms <= ?
         AND (SELECT width_px * height_px * pixel_bytes <= ? FROM job WHERE job.number = verification.job)",
    )
    .bind(old_ms)
    .bind(crate::queue::row_count(batch_size::MAX_WHOLE_FRAME_BYTES as usize))
    .execute(&mut *connection)
    .await?;
    let given_up = db::query("DELETE FROM verification WHERE position = -1 AND verifier IS NULL AND created_ms <= ?")
        .bind(old_ms)
        .execute(&mut *connection)
        .await?
        .rows_affected();
    if given_up > 0 {
        tracing::warn!(
            count = given_up,
            "pictures of large frames could not be verified: no other worker stitched them again in time"
        );
    }
    Ok((given_up, release(connection, &expired).await?))
}

/// Records that a verifier failed: another is asked. A result whose verification fails again and again is given up; returns
/// the number of those.
pub(super) async fn fail(connection: &mut Connection, numbers: &[i64], worker: &str) -> Result<(u64, Wake)> {
    if numbers.is_empty() {
        return Ok((0, Wake::default()));
    }
    let woken = release(connection, numbers).await?;
    db::query(
        "UPDATE verification SET failures = failures + 1, failed_by = ? WHERE number IN (SELECT value FROM @numbers(?))",
    )
    .bind(worker)
    .bind(json_numbers(numbers.iter().copied()))
    .execute(&mut *connection)
    .await?;
    let given_up =
        db::query("DELETE FROM verification WHERE failures >= ?").bind(MAX_FAILURES).execute(connection).await?;
    Ok((given_up.rows_affected(), woken))
}

/// Releases all verifications at startup, because the clock starts at zero; every remote worker counts as new.
pub(in crate::queue) async fn reset_after_restart(connection: &mut Connection, now_ms: i64) -> Result<()> {
    db::query("DELETE FROM verification_lease WHERE verification IN (SELECT number FROM verification)")
        .execute(&mut *connection)
        .await?;
    db::query("UPDATE verification SET verifier = NULL, granted_ms = NULL, expires_ms = NULL, created_ms = ?")
        .bind(now_ms)
        .execute(&mut *connection)
        .await?;
    db::query("UPDATE worker SET registered_ms = ? WHERE state <> 'gone'").bind(now_ms).execute(connection).await?;
    Ok(())
}
