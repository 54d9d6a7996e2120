//! Makers of tiles and of pictures, and the jobs that have a picture. Leases are kept for an hour; the last one of each tile
//! with a result is recorded before it is deleted.

use std::collections::BTreeMap;

use proto::JobId;
use proto::job::JobPage;
use proto::verify::Maker;

use crate::db;
use crate::queue::{Connection, Queue, Result};

/// Hash by which a picture is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PictureMark<'a> {
    /// BLAKE3 of its bytes, in hex.
    Bytes(&'a str),
    /// BLAKE3 of the scene that it was made from, in hex.
    Scene(&'a str),
}

/// Records the makers of the tiles of ended leases, given as a list, that are to be deleted.
pub(in crate::queue) async fn record(connection: &mut Connection, leases: &str) -> Result<()> {
    db::query(
        "INSERT INTO maker (worker, name, device)
         SELECT DISTINCT worker.id, worker.name, worker.device
         FROM @texts(?) @join lease ON lease.id = listed.value @join worker ON worker.id = lease.worker
         WHERE lease.ended = 'done'
         ON CONFLICT (worker) DO NOTHING",
    )
    .bind(leases)
    .execute(&mut *connection)
    .await?;
    db::query(
        "INSERT INTO tile_maker (tile, maker, ended_at_ms, took_ms, used_us)
         SELECT lease.tile, maker.number, lease.ended_at_ms, lease.took_ms, lease.used_us
         FROM @texts(?) @join lease ON lease.id = listed.value @join maker ON maker.worker = lease.worker
         WHERE lease.ended = 'done' AND lease.ended_at_ms IS NOT NULL AND lease.took_ms IS NOT NULL AND NOT EXISTS (
             SELECT 1 FROM lease AS later
             WHERE later.tile = lease.tile AND later.epoch > lease.epoch AND later.ended = 'done')
         ON CONFLICT (tile) DO UPDATE SET maker = excluded.maker, ended_at_ms = excluded.ended_at_ms,
                                          took_ms = excluded.took_ms, used_us = excluded.used_us",
    )
    .bind(leases)
    .execute(connection)
    .await?;
    Ok(())
}

/// Deletes makers without remaining tiles.
pub(in crate::queue) async fn tidy(connection: &mut Connection) -> Result<()> {
    db::query("DELETE FROM maker WHERE NOT EXISTS (SELECT 1 FROM tile_maker WHERE tile_maker.maker = maker.number)")
        .execute(connection)
        .await?;
    Ok(())
}

impl Queue {
    /// Jobs that have such a picture, newest first; only the jobs of `submitter`, if given.
    pub(crate) async fn jobs_of_picture(
        &self,
        submitter: Option<&str>,
        mark: PictureMark<'_>,
        limit: u32,
    ) -> Result<JobPage> {
        let (query, hash) = match mark {
            PictureMark::Bytes(hash) => (
                db::query(
                    "SELECT DISTINCT job.id, job.number FROM frame @join job ON job.number = frame.job
                     WHERE frame.picture = ?1 AND (?2 IS NULL OR submitter = ?2) ORDER BY job.number DESC LIMIT ?3",
                ),
                hash,
            ),
            PictureMark::Scene(hash) => (
                db::query(
                    "SELECT DISTINCT job.id, job.number FROM frame @join job ON job.number = frame.job
                     WHERE frame.scene = ?1 AND (?2 IS NULL OR submitter = ?2) ORDER BY job.number DESC LIMIT ?3",
                ),
                hash,
            ),
        };
        let rows = query.bind(hash).bind(submitter).bind(limit).fetch_all(self.readers()).await?;
        let mut jobs = Vec::with_capacity(rows.len());
        for row in rows {
            let id: String = row.get("id")?;
            // A job may have been deleted in the meantime.
            if let Some(view) = self.job(crate::queue::parse_column("job.id", &id, |id| id.parse().ok())?).await? {
                jobs.push(view);
            }
        }
        Ok(JobPage { jobs, next_cursor: None })
    }

    /// Workers that rendered a frame's picture, in this job or in an earlier one that has the same; `None` if none is known.
    pub(crate) async fn makers(&self, id: JobId, frame: u32) -> Result<Option<Vec<Maker>>> {
        let rows = db::query(
            "WITH made AS (
                 SELECT tile.id AS tile, tile.position, tile.x_px, tile.y_px, tile.width_px, tile.height_px
                 FROM job @join frame AS shown ON shown.job = job.number
                 @join frame AS made ON made.picture = shown.picture
                 @join tile ON tile.job = made.job AND tile.frame = made.number
                 WHERE job.id = ? AND shown.number = ? AND tile.kind = 'render')
             SELECT worker.id, worker.name, worker.device, made.position, x_px, y_px, width_px, height_px
             FROM made @join lease ON lease.tile = made.tile @join worker ON worker.id = lease.worker
             WHERE lease.ended = 'done'
             UNION ALL
             SELECT maker.worker AS id, maker.name, maker.device, made.position, x_px, y_px, width_px, height_px
             FROM made @join tile_maker ON tile_maker.tile = made.tile @join maker ON maker.number = tile_maker.maker
             ORDER BY 4, 1",
        )
        .bind(id.to_string())
        .bind(frame)
        .fetch_all(self.readers())
        .await?;
        let mut makers: BTreeMap<String, Maker> = BTreeMap::new();
        for row in &rows {
            let id: String = row.get("id")?;
            let rect = [row.get("x_px")?, row.get("y_px")?, row.get("width_px")?, row.get("height_px")?];
            let (worker, device) = (row.get("name")?, row.get("device")?);
            let maker = makers.entry(id.clone()).or_insert(Maker { worker, id, device, tiles: Vec::new() });
            if !maker.tiles.contains(&rect) {
                maker.tiles.push(rect);
            }
        }
        Ok(Some(makers.into_values().collect::<Vec<_>>()).filter(|makers| !makers.is_empty()))
    }

    /// Scene of a frame, as its picture's file has it; `None` if it was not recorded.
    pub(crate) async fn scene_of(&self, id: JobId, frame: u32) -> Result<Option<String>> {
        let scene: Option<Option<String>> = db::query_scalar(
            "SELECT scene FROM frame JOIN job ON job.number = frame.job WHERE job.id = ? AND frame.number = ?",
        )
        .bind(id.to_string())
        .bind(frame)
        .fetch_optional(self.readers())
        .await?;
        Ok(scene.flatten())
    }

    /// Width and height of a job's pictures, in pixels.
    pub(crate) async fn picture_size(&self, id: JobId) -> Result<Option<[u32; 2]>> {
        let row = db::query("SELECT width_px, height_px FROM job WHERE id = ?")
            .bind(id.to_string())
            .fetch_optional(self.readers())
            .await?;
        row.map(|row| Ok([row.get("width_px")?, row.get("height_px")?])).transpose()
    }
}
