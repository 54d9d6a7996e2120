//! The only statements that make tiles done, or done no more. They return the progress of the job, which
//! `transitions::progress` adds to its counters and makes events of.

use proto::event::TileEvent;

use crate::db::{self, Statement};
use crate::queue::events::effects::{ChangedTile, Progress};
use crate::queue::{Connection, Result, expect_rows_in, json_numbers};

/// Columns of a [`ChangedTile`], and its job's `rays_peak`, because the statement that changes that returns only the
/// new one.
macro_rules! changed_tile_columns {
    () => {
        " RETURNING id, kind = 'render' AS is_render, frame, x_px, y_px, width_px, height_px, rays,
          state = 'done' AS is_done, (SELECT rays_peak FROM job WHERE job.number = tile.job) AS peak_before"
    };
}

/// Tiles that a statement has changed.
struct Changed {
    /// Number of them, with stitches.
    count: usize,
    /// Progress by those that are rendered.
    progress: Progress,
}

/// Runs a statement that changes tiles.
async fn change(connection: &mut Connection, statement: Statement) -> Result<Changed> {
    let rows = statement.fetch_all(connection).await?;
    let mut rendered = Vec::with_capacity(rows.len());
    let mut peak_before = None;
    for row in &rows {
        if row.get("is_render")? {
            let event = TileEvent {
                frame: row.get("frame")?,
                x: row.get("x_px")?,
                y: row.get("y_px")?,
                width: row.get("width_px")?,
                height: row.get("height_px")?,
                done: row.get("is_done")?,
            };
            peak_before = Some(row.get("peak_before")?);
            rendered.push((row.get::<i64>("id")?, ChangedTile { event, rays: row.get("rays")? }));
        }
    }
    // An engine may return rows in any order.
    rendered.sort_unstable_by_key(|(id, _)| *id);
    let rendered = rendered.into_iter().map(|(_, tile)| tile).collect();
    Ok(Changed { count: rows.len(), progress: Progress::of_tiles(rendered, peak_before) })
}

/// Stores the blobs of leased tiles: the id, hash and size of each.
pub(in crate::queue) async fn store_blobs(
    connection: &mut Connection,
    results: &[(i64, &str, u64)],
) -> Result<Progress> {
    let statement = db::query(concat!(
        "UPDATE tile SET state = 'done', blob = listed.value ->> 1, blob_bytes = CAST(listed.value ->> 2 AS BIGINT)
         FROM @rows(?) WHERE tile.id = CAST(listed.value ->> 0 AS BIGINT) AND tile.state = 'leased'",
        changed_tile_columns!()
    ));
    let done = change(connection, statement.bind(serde_json::json!(results).to_string())).await?;
    expect_rows_in("tile: leased to done", results.len(), done.count)?;
    Ok(done.progress)
}

/// Marks leased tiles as done without a blob: all tiles of a frame that is stored, or its stitch.
pub(in crate::queue) async fn finish(connection: &mut Connection, tiles: &[i64]) -> Result<Progress> {
    let statement = db::query(concat!(
        "UPDATE tile SET state = 'done' WHERE state = 'leased' AND id IN (SELECT value FROM @numbers(?))",
        changed_tile_columns!()
    ));
    let done = change(connection, statement.bind(json_numbers(tiles.iter().copied()))).await?;
    expect_rows_in("tile: leased to done", tiles.len(), done.count)?;
    Ok(done.progress)
}

/// Makes a frame's finished tiles at the listed positions ready again.
pub(in crate::queue) async fn reopen_positions(
    connection: &mut Connection,
    job: i64,
    frame: u32,
    positions: &[u32],
) -> Result<Progress> {
    let statement = db::query(concat!(
        "UPDATE tile SET state = 'ready', blob = NULL, blob_bytes = NULL, record = NULL, record_bytes = NULL, kept = 0
         WHERE job = ? AND frame = ? AND kind = 'render' AND state = 'done'
           AND position IN (SELECT value FROM @numbers(?))",
        changed_tile_columns!()
    ));
    let positions = json_numbers(positions.iter().map(|position| i64::from(*position)));
    Ok(change(connection, statement.bind(job).bind(frame).bind(positions)).await?.progress)
}

/// Makes the tiles that are done ready again.
pub(in crate::queue) async fn reopen(connection: &mut Connection, tiles: &[i64]) -> Result<Progress> {
    let statement = db::query(concat!(
        "UPDATE tile SET state = 'ready', blob = NULL, blob_bytes = NULL, record = NULL, record_bytes = NULL, kept = 0
         WHERE state = 'done' AND id IN (SELECT value FROM @numbers(?))",
        changed_tile_columns!()
    ));
    Ok(change(connection, statement.bind(json_numbers(tiles.iter().copied()))).await?.progress)
}
