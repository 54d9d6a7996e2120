//! Results before they count: the tiles they are for, and the results that were rejected because their bytes are
//! not what was asked for.

use std::collections::{BTreeMap, HashMap};

use proto::{LeaseId, Rect, WorkerId};

use crate::blobs::ContentKind;
use crate::db;
use crate::queue::leases::{self, LeaseEnd};
use crate::queue::workers::exclusion;
use crate::queue::{
    Connection, Queue, Result, TransitionContext, Wake, json_list, json_numbers, parse_column, verification, workers,
};

/// Tile of a live lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ReportedTile {
    /// The job's number.
    pub(crate) job: i64,
    /// The frame.
    pub(crate) frame: u32,
    /// Its pixels; for a picture the frame's.
    pub(crate) rect: Rect,
    /// Bytes of finished data per pixel.
    pub(crate) pixel_bytes: u32,
}

impl ReportedTile {
    /// The tile as a result of this kind covers it: all tiles of a frame share its picture.
    pub(crate) fn as_delivered(&self, kind: ContentKind) -> Self {
        match kind {
            ContentKind::Blob => *self,
            ContentKind::Picture => Self { rect: Rect::full(0, 0), ..*self },
        }
    }
}

/// Result with bytes that are not what was asked for.
#[derive(Clone, Debug)]
pub(crate) struct RejectedResult {
    /// Its lease.
    pub(crate) lease: LeaseId,
    /// Its name, as the worker sent it.
    pub(crate) hash: String,
    /// Reason of the rejection.
    pub(crate) reason: String,
    /// Whether no correct worker delivers it; otherwise it is only missing.
    pub(crate) is_wrong: bool,
}

impl Queue {
    /// Tiles of those leases that are live and this worker's.
    pub(crate) async fn reported_tiles(
        &self,
        worker: WorkerId,
        leases: &[LeaseId],
    ) -> Result<HashMap<LeaseId, ReportedTile>> {
        let rows = db::query(
            "SELECT lease.id, tile.job, tile.frame, tile.x_px, tile.y_px, tile.width_px, tile.height_px, pixel_bytes
             FROM lease JOIN tile ON tile.id = lease.tile JOIN job ON job.number = tile.job
             WHERE @unindexed(lease.ended) IS NULL AND @unindexed(lease.worker) = ?1
               AND lease.id IN (SELECT value FROM @texts(?2))
             UNION ALL
             SELECT verification_lease.id, tile.job, tile.frame, tile.x_px, tile.y_px, tile.width_px, tile.height_px,
                    pixel_bytes
             FROM verification_lease JOIN verification ON verification.number = verification_lease.verification
             JOIN job ON job.number = verification.job
             JOIN tile ON tile.job = verification.job AND tile.frame = verification.frame
                      AND tile.position = verification_lease.position
             WHERE verifier = ?1 AND verification_lease.id IN (SELECT value FROM @texts(?2))",
        )
        .bind(worker.to_string())
        .bind(json_list(leases))
        .fetch_all(self.readers())
        .await?;
        let tiles = rows.iter().map(|row| {
            let id: String = row.get("id")?;
            let tile = ReportedTile {
                job: row.get("job")?,
                frame: row.get("frame")?,
                rect: Rect {
                    x: row.get("x_px")?,
                    y: row.get("y_px")?,
                    width: row.get("width_px")?,
                    height: row.get("height_px")?,
                },
                pixel_bytes: row.get("pixel_bytes")?,
            };
            Ok((parse_column("lease.id", &id, |id| id.parse().ok())?, tile))
        });
        tiles.collect()
    }
}

impl Queue {
    /// Positions and blobs of these tiles of a frame, if the lease is a live one of this worker for the frame's stitch.
    pub(crate) async fn stitch_blobs(
        &self,
        worker: WorkerId,
        lease: LeaseId,
        positions: &[u32],
    ) -> Result<Vec<(u32, String)>> {
        let rows = db::query(
            "SELECT input.position, input.blob FROM lease JOIN tile ON tile.id = lease.tile
             JOIN tile AS input ON input.job = tile.job AND input.frame = tile.frame AND input.kind = 'render'
             WHERE lease.ended IS NULL AND lease.worker = ?1 AND lease.id = ?2 AND tile.kind = 'stitch'
               AND input.blob IS NOT NULL AND input.position IN (SELECT value FROM @numbers(?3))",
        )
        .bind(worker.to_string())
        .bind(lease.to_string())
        .bind(json_numbers(positions.iter().map(|position| i64::from(*position))))
        .fetch_all(self.readers())
        .await?;
        rows.iter().map(|row| Ok((row.get("position")?, row.get("blob")?))).collect()
    }
}

/// Ends the leases of rejected results, whose tiles go to other workers, and counts them as errors of the worker.
/// Returns the leases that had ended already, and whether the worker is quarantined now.
pub(in crate::queue) async fn reject(
    connection: &mut Connection,
    worker: WorkerId,
    rejected: &[RejectedResult],
    context: TransitionContext,
) -> Result<(Vec<LeaseId>, bool, Wake)> {
    let (mut lost, mut woken) = (Vec::new(), Wake::default());
    // All tiles of a frame share a picture, which counts once.
    let mut hashes: BTreeMap<&str, bool> = BTreeMap::new();
    let (verifications, wake) = verification::reject(connection, &worker.to_string(), rejected).await?;
    woken.add(wake);
    for result in rejected {
        if verifications.contains(&result.lease) {
            hashes.insert(&result.hash, result.is_wrong);
            continue;
        }
        let Some(held) = leases::live_leases_among(connection, worker, &[result.lease]).await?.pop() else {
            lost.push(result.lease);
            continue;
        };
        if hashes.insert(&result.hash, result.is_wrong).is_none() {
            let job = crate::queue::job_id(connection, held.job).await?;
            tracing::warn!(
                code = "wrong_result", %worker, %job, frame = held.frame, hash = ?result.hash, reason = %result.reason,
                "a worker delivered something else than was asked for; another renders it"
            );
        }
        woken.add(leases::end_without_result(connection, &held, LeaseEnd::Rejected, &result.reason, context).await?);
    }
    let wrong = hashes.values().filter(|is_wrong| **is_wrong).count();
    let is_quarantined = exclusion::record_wrong_results(connection, worker, wrong).await?;
    if is_quarantined {
        let reason = "its worker is quarantined";
        woken.add(workers::end_leases(connection, &worker.to_string(), LeaseEnd::Released, reason, context).await?);
    }
    Ok((lost, is_quarantined, woken))
}
