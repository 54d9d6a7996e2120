//! Recorded jobs: each tile keeps its blob, and a record of what its rays asked for, as long as the job. A job that is
//! based on one keeps the pixels of tiles that can't differ; workers find out which.
//!
//! Records are hints: without one, or with one whose bytes are gone, a tile is rendered.

use std::collections::HashSet;

use proto::worker_protocol::{BatchWork, EarlierFrame, EarlierTile, Recording, TileRecord};

use crate::blobs::ContentHash;
use crate::db;
use crate::queue::leases::claim::{self, ClaimableJob};
use crate::queue::{Connection, Result, parse_column};

/// Number of jobs, each based on the next, among which recorded tiles are looked for.
const MAX_EARLIER_JOBS: usize = 8;

/// How the tiles of a job's batch are recorded; `None` if they are not.
pub(in crate::queue) async fn recording(
    connection: &mut Connection,
    job: &ClaimableJob,
    frame: u32,
    work: &BatchWork,
) -> Result<Option<Recording>> {
    let BatchWork::Render { tiles, .. } = work else { return Ok(None) };
    if !job.recorded {
        return Ok(None);
    }
    let positions: Vec<u32> = tiles.iter().map(|tile| tile.index).collect();
    let mut based_on = job.based_on.clone();
    for _ in 0..MAX_EARLIER_JOBS {
        let Some(id) = based_on else { break };
        let earlier = db::query("SELECT number, based_on FROM job WHERE id = ?")
            .bind(&id)
            .fetch_optional(&mut *connection)
            .await?;
        let Some(earlier) = earlier else { break };
        let tiles = recorded_tiles(connection, earlier.get("number")?, frame, &positions).await?;
        if !tiles.is_empty() {
            let job = parse_column("job.id", &id, |id| id.parse().ok())?;
            return Ok(Some(Recording { earlier: Some(EarlierFrame { job, tiles }) }));
        }
        // Its pictures were stored before, so nothing was rendered for it.
        based_on = earlier.get("based_on")?;
    }
    Ok(Some(Recording { earlier: None }))
}

/// A frame's tiles at these positions that are done and have records.
async fn recorded_tiles(
    connection: &mut Connection,
    job: i64,
    frame: u32,
    positions: &[u32],
) -> Result<Vec<EarlierTile>> {
    let rows = db::query(
        "SELECT position, x_px, y_px, width_px, height_px, blob, blob_bytes, record, record_bytes FROM tile
         WHERE job = ? AND frame = ? AND record IS NOT NULL AND position IN (SELECT value FROM @numbers(?))",
    )
    .bind(job)
    .bind(frame)
    .bind(crate::queue::json_numbers(positions.iter().map(|position| i64::from(*position))))
    .fetch_all(connection)
    .await?;
    let tile = |row: &db::Row| {
        Ok(EarlierTile {
            pixels: claim::read_part(row)?,
            record: row.get("record")?,
            record_bytes: row.get("record_bytes")?,
        })
    };
    rows.iter().map(tile).collect()
}

/// Stores the records of tiles that have just been delivered, under leases that ended with a result.
pub(in crate::queue) async fn store(
    connection: &mut Connection,
    records: &[TileRecord],
    ended: &HashSet<String>,
) -> Result<()> {
    let listed: Vec<_> = records
        .iter()
        .map(|record| (record.lease.to_string(), &record.hash, record.size_bytes, i64::from(record.kept)))
        .filter(|(lease, hash, ..)| ended.contains(lease) && ContentHash::parse(hash).is_some())
        .collect();
    if listed.is_empty() {
        return Ok(());
    }
    db::query(
        "UPDATE tile SET record = listed.value ->> 1, record_bytes = CAST(listed.value ->> 2 AS BIGINT),
                         kept = CAST(listed.value ->> 3 AS BIGINT)
         FROM @rows(?) @join lease ON lease.id = listed.value ->> 0
         WHERE tile.id = lease.tile AND tile.blob IS NOT NULL
           AND (SELECT recorded = 1 FROM job WHERE job.number = tile.job)",
    )
    .bind(serde_json::json!(listed).to_string())
    .execute(connection)
    .await?;
    Ok(())
}
