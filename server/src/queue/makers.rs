//! Makers of a picture, and the jobs that have it, as far as the rows of leases and workers are still kept.

use std::collections::BTreeMap;

use proto::JobId;
use proto::job::JobPage;
use proto::verify::Maker;

use super::{Queue, Result};
use crate::db;

/// Hash by which a picture is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PictureMark<'a> {
    /// BLAKE3 of its bytes, in hex.
    Bytes(&'a str),
    /// BLAKE3 of the scene that it was made from, in hex.
    Scene(&'a str),
}

impl Queue {
    /// Jobs that have such a picture, newest first; only those of `submitter`, if given.
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
            if let Some(view) = self.job(super::parse_column("job.id", &id, |id| id.parse().ok())?).await? {
                jobs.push(view);
            }
        }
        Ok(JobPage { jobs, next_cursor: None })
    }

    /// Workers that rendered a frame's picture, in this job or in an earlier one that has the same; `None` if none is known.
    pub(crate) async fn makers(&self, id: JobId, frame: u32) -> Result<Option<Vec<Maker>>> {
        let rows = db::query(
            "SELECT worker.id, worker.name, worker.device, tile.x_px, tile.y_px, tile.width_px, tile.height_px
             FROM frame AS shown @join job ON job.number = shown.job
             @join frame AS made ON made.picture = shown.picture
             @join tile ON tile.job = made.job AND tile.frame = made.number
             @join lease ON lease.tile = tile.id
             @join worker ON worker.id = lease.worker
             WHERE job.id = ? AND shown.number = ? AND tile.kind = 'render' AND lease.ended = 'done'
             ORDER BY tile.position, worker.id",
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
