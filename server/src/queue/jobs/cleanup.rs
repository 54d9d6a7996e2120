//! Large changes of a job, made in pieces so that no transaction is long: the open work of a job that ended is voided,
//! that of a retried job is requeued, and a deleted job is removed row by row.
//!
//! A change begins in the transaction that decides it, with the first piece. `job.cleanup` records that pieces are
//! left, so that the next server continues. The maintenance task makes them; users see the complete change from the
//! first piece on.

use crate::db;
use crate::db::{DatabaseError, Durability};
use crate::queue::jobs::{fair_share, transitions};
use crate::queue::leases::ends;
use crate::queue::{
    Connection, Queue, Result, TransitionContext, Wake, expect_rows, json_list, json_numbers, row_count,
};

/// Maximum number of tiles, frames or events that one piece changes; a frame's tiles are requeued together.
pub(in crate::queue) const PIECE_ROWS: i64 = 100;

/// Hashes that may be orphans after a change.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct RemovedContent {
    /// Hashes of pictures.
    pub(crate) pictures: Vec<String>,
    /// Hashes of tiles' blobs.
    pub(crate) blobs: Vec<String>,
}

/// The next job with a change that is not finished; deletions come last, because no client waits for them.
const NEXT_SQL: &str = "SELECT number FROM job @index(job_to_clean_up) WHERE cleanup IS NOT NULL
     ORDER BY cleanup = 'delete', number LIMIT 1";

impl Queue {
    /// Makes one piece of the changes that are left; `None` if nothing is left.
    pub(crate) async fn clean_up_piece(&self) -> Result<Option<RemovedContent>> {
        let left: Option<i64> = db::query_scalar(NEXT_SQL).fetch_optional(self.readers()).await?;
        if left.is_none() {
            return Ok(None);
        }
        let context = self.context();
        let removed = self
            .database
            .write(Durability::Relaxed, move |connection| {
                Box::pin(async move {
                    let next: Option<i64> = db::query_scalar(NEXT_SQL).fetch_optional(&mut *connection).await?;
                    let Some(job) = next else { return Ok(None) };
                    let adds_work = cleanup_of(connection, job).await?.as_deref() == Some("requeue");
                    Ok(Some((adds_work, piece(connection, job, context).await?)))
                })
            })
            .await?;
        Ok(removed.map(|(adds_work, removed)| {
            if adds_work {
                self.wake(Wake::WORK);
            }
            removed
        }))
    }

    /// Makes the pieces that are left of one job's change.
    pub(in crate::queue) async fn finish_cleanup(&self, job: i64) -> Result<()> {
        loop {
            let context = self.context();
            let is_done = self
                .database
                .write(Durability::Relaxed, move |connection| {
                    Box::pin(async move {
                        piece(connection, job, context).await?;
                        Ok(cleanup_of(connection, job).await?.is_none())
                    })
                })
                .await?;
            if is_done {
                return Ok(());
            }
        }
    }
}

/// The change of a job that is not finished.
pub(in crate::queue) async fn cleanup_of(connection: &mut Connection, job: i64) -> Result<Option<String>> {
    let cleanup: Option<Option<String>> =
        db::query_scalar("SELECT cleanup FROM job WHERE number = ?").bind(job).fetch_optional(connection).await?;
    Ok(cleanup.flatten())
}

/// Makes one piece of a job's change.
pub(in crate::queue) async fn piece(
    connection: &mut Connection,
    job: i64,
    context: TransitionContext,
) -> Result<RemovedContent> {
    let Some(cleanup) = cleanup_of(connection, job).await? else { return Ok(RemovedContent::default()) };
    let (is_done, removed) = match cleanup.as_str() {
        "void" => void_piece(connection, job, context).await?,
        "requeue" => (requeue_piece(connection, job, context).await?, RemovedContent::default()),
        "delete" => (false, delete_piece(connection, job, context).await?),
        _ => return Err(DatabaseError::Value { column: "job.cleanup", value: cleanup }),
    };
    if is_done {
        let done = db::query("UPDATE job SET cleanup = NULL WHERE number = ?").bind(job).execute(connection).await?;
        expect_rows("job: cleaned up", 1, done)?;
    }
    Ok(removed)
}

/// Next frame of a job in one of some states.
async fn next_frame(connection: &mut Connection, statement: &'static str, job: i64) -> Result<Option<u32>> {
    db::query_scalar(statement).bind(job).fetch_optional(connection).await
}

/// Voids open frames and tiles of a job that ended; returns whether none is left, and the frames' blobs.
async fn void_piece(
    connection: &mut Connection,
    job: i64,
    context: TransitionContext,
) -> Result<(bool, RemovedContent)> {
    const NEXT_OPEN_SQL: &str = "SELECT number FROM frame @index(frame_unfinished)
         WHERE job = ? AND state IN ('open', 'stitching') ORDER BY number LIMIT 1";
    let mut removed = RemovedContent::default();
    let mut left = context.piece_rows;
    while left > 0 {
        let Some(frame) = next_frame(connection, NEXT_OPEN_SQL, job).await? else { return Ok((true, removed)) };
        let voided = void_tiles(connection, job, frame, left, context).await?;
        left -= voided;
        if left <= 0 {
            break;
        }
        let blobs: Vec<String> =
            db::query_scalar("SELECT DISTINCT blob FROM tile WHERE job = ? AND frame = ? AND blob IS NOT NULL")
                .bind(job)
                .bind(frame)
                .fetch_all(&mut *connection)
                .await?;
        removed.blobs.extend(blobs);
        let void = db::query("UPDATE frame SET state = 'void' WHERE job = ? AND number = ?")
            .bind(job)
            .bind(frame)
            .execute(&mut *connection)
            .await?;
        expect_rows("frame: void", 1, void)?;
        left -= 1;
    }
    Ok((false, removed))
}

/// Voids at most `limit` tiles of a frame, with their leases; returns their number.
async fn void_tiles(
    connection: &mut Connection,
    job: i64,
    frame: u32,
    limit: i64,
    context: TransitionContext,
) -> Result<i64> {
    let tiles: Vec<i64> = db::query_scalar(
        "SELECT id FROM tile WHERE job = ? AND frame = ? AND state IN ('ready', 'leased') ORDER BY position LIMIT ?",
    )
    .bind(job)
    .bind(frame)
    .bind(limit)
    .fetch_all(&mut *connection)
    .await?;
    let count = row_count(tiles.len());
    let tiles = json_numbers(tiles);
    let leases: Vec<String> = db::query_scalar(
        "SELECT lease.id FROM @numbers(?) @join lease ON lease.tile = listed.value
         WHERE lease.ended IS NULL",
    )
    .bind(&tiles)
    .fetch_all(&mut *connection)
    .await?;
    if !leases.is_empty() {
        let leases = json_list(leases);
        fair_share::store_used_time_of(connection, &leases, context).await?;
        ends::void(connection, &leases, context).await?;
    }
    let voided = db::query("UPDATE tile SET state = 'void' WHERE id IN (SELECT value FROM @numbers(?))")
        .bind(&tiles)
        .execute(connection)
        .await?;
    expect_rows("tile: void", count.unsigned_abs(), voided)?;
    Ok(count)
}

/// Opens void frames of a retried job, whose dead and void tiles become ready; returns whether none is left.
async fn requeue_piece(connection: &mut Connection, job: i64, context: TransitionContext) -> Result<bool> {
    const NEXT_VOID_SQL: &str = "SELECT number FROM frame @index(frame_void)
         WHERE job = ? AND state = 'void' ORDER BY number LIMIT 1";
    let mut left = context.piece_rows;
    while left > 0 {
        let Some(frame) = next_frame(connection, NEXT_VOID_SQL, job).await? else { return Ok(true) };
        let state: String = db::query_scalar(
            "UPDATE frame SET state = CASE WHEN tiles_done = tiles_total THEN 'stitching' ELSE 'open' END
             WHERE job = ? AND number = ? RETURNING state",
        )
        .bind(job)
        .bind(frame)
        .fetch_one(&mut *connection)
        .await?;
        let rows = db::query(
            "SELECT id, state = 'dead' AS is_dead FROM tile
             WHERE job = ? AND frame = ? AND state IN ('dead', 'void') AND (kind = 'render' OR ? = 'stitching')",
        )
        .bind(job)
        .bind(frame)
        .bind(state)
        .fetch_all(&mut *connection)
        .await?;
        let tiles =
            rows.iter().map(|row| Ok((row.get("id")?, row.get("is_dead")?))).collect::<Result<Vec<(i64, bool)>>>()?;
        let dead = row_count(tiles.iter().filter(|(_, is_dead)| *is_dead).count());
        db::query(
            "UPDATE tile SET state = 'ready', not_before_ms = 0, avoid = NULL, errors = 0, crashes = 0, lost = 0,
                             interrupts = 0, blamed_by = NULL, blob = NULL, blob_bytes = NULL, record = NULL, record_bytes = NULL, kept = 0
             WHERE id IN (SELECT value FROM @numbers(?))",
        )
        .bind(json_numbers(tiles.iter().map(|(tile, _)| *tile)))
        .execute(&mut *connection)
        .await?;
        db::query("UPDATE job SET tiles_dead = tiles_dead - ? WHERE number = ?")
            .bind(dead)
            .bind(job)
            .execute(&mut *connection)
            .await?;
        left -= row_count(tiles.len()) + 1;
    }
    Ok(false)
}

/// Deletes tiles, then frames, then events of a deleted job, and at last the job itself.
async fn delete_piece(connection: &mut Connection, job: i64, context: TransitionContext) -> Result<RemovedContent> {
    let tiles =
        db::query("DELETE FROM tile WHERE id IN (SELECT id FROM tile WHERE job = ? LIMIT ?) RETURNING blob, record")
            .bind(job)
            .bind(context.piece_rows)
            .fetch_all(&mut *connection)
            .await?;
    let mut blobs: Vec<Option<String>> = Vec::with_capacity(2 * tiles.len());
    for tile in &tiles {
        blobs.extend([tile.get("blob")?, tile.get("record")?]);
    }
    let mut left = context.piece_rows - row_count(tiles.len());
    let mut removed = RemovedContent { pictures: Vec::new(), blobs: distinct(blobs) };
    if left <= 0 {
        return Ok(removed);
    }
    let pictures: Vec<Option<String>> = db::query_scalar(
        "DELETE FROM frame WHERE job = ?1 AND number IN (SELECT number FROM frame WHERE job = ?1 LIMIT ?2)
         RETURNING picture",
    )
    .bind(job)
    .bind(left)
    .fetch_all(&mut *connection)
    .await?;
    left -= row_count(pictures.len());
    removed.pictures = distinct(pictures);
    db::query(
        "DELETE FROM picture WHERE hash IN (SELECT value FROM @texts(?))
         AND NOT EXISTS (SELECT 1 FROM frame WHERE frame.picture = picture.hash)",
    )
    .bind(json_list(&removed.pictures))
    .execute(&mut *connection)
    .await?;
    if left <= 0 {
        return Ok(removed);
    }
    let events = db::query("DELETE FROM outbox WHERE number IN (SELECT number FROM outbox WHERE job = ? LIMIT ?)")
        .bind(job)
        .bind(left)
        .execute(&mut *connection)
        .await?;
    if row_count(events.rows_affected() as usize) < left {
        transitions::delete(connection, job).await?;
    }
    Ok(removed)
}

fn distinct(hashes: Vec<Option<String>>) -> Vec<String> {
    let mut hashes: Vec<String> = hashes.into_iter().flatten().collect();
    hashes.sort_unstable();
    hashes.dedup();
    hashes
}

/// Hides a job and marks it for deletion: its id is no job's id from now on, and nothing of it is leased.
pub(in crate::queue) async fn mark_deleted(connection: &mut Connection, job: i64) -> Result<()> {
    transitions::hide(connection, job).await?;
    for statement in ["DELETE FROM webhook WHERE job = ?", "DELETE FROM idempotency WHERE job = ?"] {
        db::query(statement).bind(job).execute(&mut *connection).await?;
    }
    Ok(())
}
