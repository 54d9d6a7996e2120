//! Undoes what a worker delivered: its tiles are rendered again, and the pictures made from them are forgotten.
//!
//! It goes back as far as ended leases are kept, which is an hour, and longer for results that wait to be verified.

use crate::db;
use std::collections::{BTreeMap, BTreeSet};

use crate::queue::jobs::transitions;
use crate::queue::leases::ends;
use crate::queue::servers::repair;
use crate::queue::tiles::results;
use crate::queue::{Connection, Result, expect_rows};

/// Undoes all results of a worker under leases that were granted after that of its last confirmed result, or from that of
/// a wrong one on. Returns the hashes of the pictures that are forgotten.
pub(in crate::queue) async fn undo_unconfirmed(
    connection: &mut Connection,
    worker: &str,
    wrong_lease: Option<&str>,
) -> Result<Vec<String>> {
    let rows = db::query(
        "SELECT tile.id, tile.job, tile.frame, tile.kind, tile.state, frame.state AS frame_state, frame.picture
         FROM lease @index(lease_by_worker) JOIN tile ON tile.id = lease.tile
         JOIN frame ON frame.job = tile.job AND frame.number = tile.frame
         WHERE lease.worker = ?1 AND lease.ended = 'done'
           AND (lease.id > coalesce((SELECT verified_lease FROM worker WHERE id = ?1), '') OR lease.id >= ?2)",
    )
    .bind(worker)
    .bind(wrong_lease)
    .fetch_all(&mut *connection)
    .await?;
    let mut pictures = BTreeSet::new();
    let mut frames: BTreeMap<(i64, u32, bool), Vec<i64>> = BTreeMap::new();
    for row in &rows {
        let state: String = row.get("frame_state")?;
        if let Some(picture) = row.get::<Option<String>>("picture")? {
            pictures.insert(picture);
        } else if (state == "open" || state == "stitching")
            && row.get::<String>("kind")? == "render"
            && row.get::<String>("state")? == "done"
        {
            let key = (row.get("job")?, row.get("frame")?, state == "stitching");
            frames.entry(key).or_default().push(row.get("id")?);
        }
    }
    let mut tiles = 0;
    for ((job, frame, is_stitching), ids) in frames {
        tiles += reopen_tiles(connection, job, frame, is_stitching, &ids).await?;
    }
    let pictures: Vec<String> = pictures.into_iter().collect();
    let reopened = repair::forget_pictures(connection, &pictures).await?;
    tracing::error!(
        code = "results_undone",
        worker,
        tiles,
        pictures = pictures.len(),
        frames = reopened.frames,
        "what a quarantined worker delivered since its last confirmed result is rendered again"
    );
    Ok(pictures)
}

/// Makes finished tiles of an unfinished frame ready again; returns their number.
async fn reopen_tiles(
    connection: &mut Connection,
    job: i64,
    frame: u32,
    is_stitching: bool,
    tiles: &[i64],
) -> Result<i64> {
    let progress = results::reopen(connection, tiles).await?;
    ends::void_results(connection, tiles).await?;
    if is_stitching {
        ends::void_stitch(connection, job, frame).await?;
        db::query(
            "UPDATE tile SET state = 'void' WHERE job = ? AND frame = ? AND position = -1 AND state IN ('ready', 'leased')",
        )
        .bind(job)
        .bind(frame)
        .execute(&mut *connection)
        .await?;
    }
    let count = -progress.tiles;
    let opened = db::query(
        "UPDATE frame SET state = 'open', tiles_done = tiles_done - ?
         WHERE job = ? AND number = ? AND state IN ('open', 'stitching')",
    )
    .bind(count)
    .bind(job)
    .bind(frame)
    .execute(&mut *connection)
    .await?;
    expect_rows("frame: tiles undone", 1, opened)?;
    transitions::progress(connection, job, progress).await?;
    Ok(count)
}
