//! The table of keys: one function is one statement.
//!
//! Secrets never reach this module, only their hashes.

use crate::db;
use crate::db::{Connection, Row};
use proto::api_key::Scope;

use super::MAX_LIVE_OF_A_NAME;
use super::key::{KeyRow, KeySpec, Scopes};
use crate::db::DatabaseError;

/// Inserts a key's row, unless its name has two live keys already; returns whether it did.
pub(super) async fn insert(
    connection: &mut Connection,
    id: &str,
    digest: &[u8; 32],
    order: &KeySpec,
) -> Result<bool, DatabaseError> {
    let done = db::query(
        "INSERT INTO key (id, name, digest, may_submit, may_read, may_work, may_administer, max_jobs, max_rays,
                          requests_per_second, created_at_ms, expires_at_ms, max_priority)
         SELECT ?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?14
         WHERE (SELECT count(*) FROM key WHERE name = ?2 AND revoked_at_ms IS NULL
                AND (expires_at_ms IS NULL OR expires_at_ms > ?11)) < ?13",
    )
    .bind(id)
    .bind(&order.name)
    .bind(digest.as_slice())
    .bind(order.scopes.has(Scope::Submit))
    .bind(order.scopes.has(Scope::Read))
    .bind(order.scopes.has(Scope::Worker))
    .bind(order.scopes.has(Scope::Admin))
    .bind(order.max_jobs)
    .bind(order.max_rays)
    .bind(order.requests_per_second)
    .bind(order.created_at_ms)
    .bind(order.expires_at_ms)
    .bind(MAX_LIVE_OF_A_NAME)
    .bind(order.max_priority)
    .execute(connection)
    .await?;
    Ok(done.rows_affected() == 1)
}

/// Revokes the key with this id, or every key of this name; returns their ids.
pub(super) async fn revoke(
    connection: &mut Connection,
    id_or_name: &str,
    now_ms: i64,
) -> Result<Vec<String>, DatabaseError> {
    let ids = db::query_scalar(
        "UPDATE key SET revoked_at_ms = ?2 WHERE (id = ?1 OR name = ?1) AND revoked_at_ms IS NULL RETURNING id",
    )
    .bind(id_or_name)
    .bind(now_ms)
    .fetch_all(connection)
    .await?;
    Ok(ids)
}

/// Stores the time of a key's last use.
pub(super) async fn set_last_used(connection: &mut Connection, number: i64, used_ms: i64) -> Result<(), DatabaseError> {
    // No row is not an error: the key may have been deleted in the meantime.
    db::query("UPDATE key SET last_used_at_ms = ? WHERE number = ?")
        .bind(used_ms)
        .bind(number)
        .execute(connection)
        .await?;
    Ok(())
}

/// Every key, newest first.
pub(super) async fn all<'e>(connection: impl Into<db::Target<'e>>) -> Result<Vec<KeyRow>, DatabaseError> {
    let rows = db::query(
        "SELECT number, id, name, digest, may_submit, may_read, may_work, may_administer, max_jobs, max_rays,
                requests_per_second, max_priority, created_at_ms, expires_at_ms, revoked_at_ms, last_used_at_ms
         FROM key ORDER BY number DESC",
    )
    .fetch_all(connection)
    .await?;
    rows.iter().map(read).collect()
}

fn read(row: &Row) -> Result<KeyRow, DatabaseError> {
    let digest: Vec<u8> = row.get("digest")?;
    let may: [bool; 4] =
        [row.get("may_submit")?, row.get("may_read")?, row.get("may_work")?, row.get("may_administer")?];
    let may = |scope| match scope {
        Scope::Submit => may[0],
        Scope::Read => may[1],
        Scope::Worker => may[2],
        Scope::Admin => may[3],
    };
    Ok(KeyRow {
        number: row.get("number")?,
        id: row.get("id")?,
        name: row.get("name")?,
        digest: digest
            .try_into()
            .map_err(|_| DatabaseError::Value { column: "key.digest", value: "other than 32 bytes".to_owned() })?,
        scopes: Scopes::from_fn(may),
        max_jobs: row.get("max_jobs")?,
        max_rays: row.get("max_rays")?,
        requests_per_second: row.get("requests_per_second")?,
        max_priority: row.get("max_priority")?,
        created_at_ms: row.get("created_at_ms")?,
        expires_at_ms: row.get("expires_at_ms")?,
        revoked_at_ms: row.get("revoked_at_ms")?,
        last_used_at_ms: row.get("last_used_at_ms")?,
    })
}
