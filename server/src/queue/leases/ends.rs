//! The only statements that end leases, each with its effects: charges are corrected by the time that was used.
//!
//! The tiles of the leases are the callers'.

use crate::db::{self, Statement};
use crate::queue::events::effects::{self, EndedLease, ended_lease_columns};
use crate::queue::workers::state::UsedLease;
use crate::queue::{Connection, Result, TransitionContext, Wake, expect_rows, expect_rows_in, json_numbers};

/// Runs a statement that ends leases.
async fn end(connection: &mut Connection, statement: Statement) -> Result<Vec<EndedLease>> {
    let ended = run(connection, statement).await?;
    effects::leases_ended(connection, &ended).await?;
    Ok(ended)
}

/// The same without the effects.
async fn run(connection: &mut Connection, statement: Statement) -> Result<Vec<EndedLease>> {
    statement.fetch_all(connection).await?.iter().map(EndedLease::read).collect()
}

/// Ends leases with a result, and the other leases of their tiles, because their workers were slower: nothing is
/// charged for those.
pub(in crate::queue) async fn finish(
    connection: &mut Connection,
    leases: &[UsedLease<'_>],
    context: TransitionContext,
) -> Result<Wake> {
    let rows: Vec<(&str, i64)> = leases.iter().map(|used| (used.held.live.lease.as_str(), used.used_us)).collect();
    let done = db::query(
        "UPDATE lease SET ended = 'done', used_us = CAST(listed.value ->> 1 AS BIGINT), ended_at_ms = ?2,
                          took_ms = @max(CAST(?3 AS BIGINT) - granted_ms, 0)
         FROM @rows(?1) WHERE lease.id = listed.value ->> 0 AND @unindexed(lease.ended) IS NULL",
    )
    .bind(serde_json::json!(rows).to_string())
    .bind(context.wall_ms)
    .bind(context.now_ms)
    .execute(&mut *connection)
    .await?;
    expect_rows("lease: live to ended", leases.len() as u64, done)?;
    let mut ended: Vec<EndedLease> = leases.iter().map(|used| EndedLease::with_result(*used)).collect();
    let duplicated: Vec<i64> =
        leases.iter().filter(|used| used.held.has_duplicate).map(|used| used.held.live.tile).collect();
    if !duplicated.is_empty() {
        ended.extend(run(connection, revocation(duplicated.into_iter(), context)).await?);
    }
    effects::leases_ended(connection, &ended).await?;
    Ok(if ended.len() > leases.len() { Wake::UPDATES } else { Wake::default() })
}

/// Statement that ends the leases of tiles; nothing is charged for them.
fn revocation(tiles: impl Iterator<Item = i64>, context: TransitionContext) -> Statement {
    let statement = db::query(concat!(
        "UPDATE lease SET ended = 'void', used_us = 0, ended_at_ms = ?2,
                          took_ms = @max(CAST(?3 AS BIGINT) - granted_ms, 0)
         WHERE ended IS NULL AND tile IN (SELECT value FROM @numbers(?1)) RETURNING ",
        ended_lease_columns!()
    ));
    statement.bind(json_numbers(tiles)).bind(context.wall_ms).bind(context.now_ms)
}

/// Ends the leases of tiles that need no result any more; nothing is charged for them.
pub(in crate::queue) async fn revoke(
    connection: &mut Connection,
    tiles: impl Iterator<Item = i64>,
    context: TransitionContext,
) -> Result<Wake> {
    let ended = end(connection, revocation(tiles, context)).await?;
    Ok(if ended.is_empty() { Wake::default() } else { Wake::UPDATES })
}

/// Ends one live lease without a result; it is charged at most its estimate.
pub(in crate::queue) async fn give_up(
    connection: &mut Connection,
    lease: &str,
    ended: &str,
    used_us: i64,
    context: TransitionContext,
) -> Result<()> {
    let statement = db::query(concat!(
        "UPDATE lease SET ended = ?1, used_us = @min(charged_us, coalesce(used_us, ?2)), ended_at_ms = ?4,
                          took_ms = @max(CAST(?5 AS BIGINT) - granted_ms, 0)
         WHERE id = ?3 AND @unindexed(ended) IS NULL RETURNING ",
        ended_lease_columns!()
    ));
    let ended =
        end(connection, statement.bind(ended).bind(used_us).bind(lease).bind(context.wall_ms).bind(context.now_ms))
            .await?;
    expect_rows_in("lease: live to ended", 1, ended.len())
}

/// Ends leases of a job that ended; their used time is stored.
pub(in crate::queue) async fn void(
    connection: &mut Connection,
    leases: &str,
    context: TransitionContext,
) -> Result<()> {
    let statement = db::query(concat!(
        "UPDATE lease SET ended = 'void', ended_at_ms = ?2, took_ms = @max(CAST(?3 AS BIGINT) - granted_ms, 0)
         WHERE @unindexed(ended) IS NULL AND id IN (SELECT value FROM @texts(?1)) RETURNING ",
        ended_lease_columns!()
    ));
    end(connection, statement.bind(leases).bind(context.wall_ms).bind(context.now_ms)).await.map(drop)
}

/// Ends all leases of the pool, whose workers exited with the last server; returns their tiles. How long they lasted is
/// unknown.
pub(in crate::queue) async fn interrupt_pool(connection: &mut Connection, wall_ms: i64) -> Result<Vec<i64>> {
    let statement = db::query(concat!(
        "UPDATE lease SET ended = 'interrupted', ended_at_ms = ?
         WHERE ended IS NULL AND worker IN (
             SELECT id FROM worker WHERE pool = 1
             AND NOT EXISTS (SELECT 1 FROM server WHERE server.generation = worker.generation)) RETURNING ",
        ended_lease_columns!()
    ));
    Ok(end(connection, statement.bind(wall_ms)).await?.iter().map(|lease| lease.tile).collect())
}

/// Ends the leases of a frame's stitch, which is made again.
pub(in crate::queue) async fn void_stitch(connection: &mut Connection, job: i64, frame: u32) -> Result<()> {
    let statement = db::query(concat!(
        "UPDATE lease SET ended = 'void' WHERE ended IS NULL
         AND tile IN (SELECT id FROM tile WHERE job = ? AND frame = ? AND position = -1) RETURNING ",
        ended_lease_columns!()
    ));
    end(connection, statement.bind(job).bind(frame)).await.map(drop)
}

/// Voids the leases under which tiles were delivered that are rendered again. They had ended, so that this has no
/// effects: what was used was used.
pub(in crate::queue) async fn void_results(connection: &mut Connection, tiles: &[i64]) -> Result<()> {
    db::query("UPDATE lease SET ended = 'void' WHERE ended = 'done' AND tile IN (SELECT value FROM @numbers(?))")
        .bind(json_numbers(tiles.iter().copied()))
        .execute(connection)
        .await?;
    Ok(())
}
