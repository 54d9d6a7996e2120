//! Stitches: created when a frame's last tile is done, removed if its blobs are damaged.

use crate::db;
use crate::queue::jobs::transitions;
use crate::queue::leases::{self, ends};
use crate::queue::leases::{LeaseEnd, LiveLease};
use crate::queue::tiles::results;
use crate::queue::{Connection, Result, TransitionContext, Wake, expect_rows};

/// Makes a frame's stitch ready after its last tile; the frame is stitching.
pub(in crate::queue) async fn create(connection: &mut Connection, job: i64, frame: u32) -> Result<()> {
    let made = db::query(
        "INSERT INTO tile (job, frame, kind, position, x_px, y_px, width_px, height_px, rays, state)
         SELECT number, ?2, 'stitch', -1, 0, 0, width_px, height_px, 0, 'ready' FROM job WHERE number = ?1
         ON CONFLICT (job, frame, position) DO UPDATE SET state = 'ready' WHERE tile.state = 'void'",
    )
    .bind(job)
    .bind(frame)
    .execute(connection)
    .await?;
    expect_rows("tile: stitch made", 1, made)
}

/// Reopens the tiles whose blobs a stitch found missing or damaged; after they are rendered again, the stitch
/// becomes ready again.
pub(in crate::queue) async fn redo_tiles(
    connection: &mut Connection,
    held: &LiveLease,
    positions: &[u32],
    context: TransitionContext,
) -> Result<Wake> {
    let mut woken =
        leases::end_without_result(connection, held, LeaseEnd::Lost, "its blobs were damaged repeatedly", context)
            .await?;
    if !is_stitching(connection, held).await? {
        return Ok(woken);
    }
    let progress = results::reopen_positions(connection, held.job, held.frame, positions).await?;
    if progress.tiles == 0 {
        return Ok(woken);
    }
    woken.add(Wake::WORK);
    woken.add(ends::revoke(connection, std::iter::once(held.tile), context).await?);
    let job = crate::queue::job_id(connection, held.job).await?;
    tracing::warn!(%job, frame = held.frame, tiles = -progress.tiles, "blobs damaged; rendering their tiles again");
    let void = db::query("UPDATE tile SET state = 'void' WHERE id = ? AND state IN ('ready', 'leased')")
        .bind(held.tile)
        .execute(&mut *connection)
        .await?;
    expect_rows("tile: stitch void", 1, void)?;
    let open = db::query(
        "UPDATE frame SET state = 'open', tiles_done = tiles_done - ? WHERE job = ? AND number = ? AND state = 'stitching'",
    )
    .bind(-progress.tiles)
    .bind(held.job)
    .bind(held.frame)
    .execute(&mut *connection)
    .await?;
    expect_rows("frame: stitching to open", 1, open)?;
    transitions::progress(connection, held.job, progress).await?;
    Ok(woken)
}

async fn is_stitching(connection: &mut Connection, held: &LiveLease) -> Result<bool> {
    let stitching: Option<bool> =
        db::query_scalar("SELECT state = 'stitching' FROM frame WHERE job = ? AND number = ?")
            .bind(held.job)
            .bind(held.frame)
            .fetch_optional(connection)
            .await?;
    Ok(stitching == Some(true))
}
