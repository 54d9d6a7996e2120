//! Content that the leases of an owner's workers need: what its keys may get and send.

use proto::JobId;
use proto::worker_protocol::MAX_RECORD_BYTES;

use crate::db;
use crate::delivery_check;
use crate::queue::{Queue, Result};

/// Tiles of a recorded job for which an owner may have sent records, before any is reported.
const MAX_UNREPORTED_RECORDS: u64 = 8;

/// Tiles that workers of the owner `?1` hold, or verify.
macro_rules! leased_tiles {
    () => {
        "SELECT lease.tile FROM worker @join lease ON lease.worker = worker.id AND lease.ended IS NULL
         WHERE worker.owner = ?1 AND worker.state <> 'gone'
         UNION ALL
         SELECT tile.id AS tile FROM verification
         @join worker ON worker.id = verification.verifier
         @join verification_lease ON verification_lease.verification = verification.number
         @join tile ON tile.job = verification.job AND tile.frame = verification.frame
                   AND tile.position = verification_lease.position
         WHERE verification.verifier IS NOT NULL AND worker.owner = ?1 AND worker.state <> 'gone'"
    };
}

/// Content that a lease gives access to.
#[derive(Clone, Copy, Debug)]
pub(crate) enum LeaseNeed<'a> {
    /// The file of the lease's job, or of a recorded one if that is based on another.
    JobFile(JobId),
    /// A blob of the lease's job, by its hash, or of a recorded tile if the job is based on another.
    Blob(&'a str),
}

/// Bytes that the leases of an owner need to send.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(clippy::struct_field_names, reason = "units come last in names")]
pub(crate) struct UploadNeed {
    /// Largest blob.
    pub(crate) blob_bytes: u64,
    /// Largest picture.
    pub(crate) picture_bytes: u64,
    /// All blobs and pictures together.
    pub(crate) total_bytes: u64,
}

/// Leases of a frame.
struct FrameLeases {
    tiles: u64,
    /// Pixels of all tiles, and of the largest.
    pixels: u64,
    largest_pixels: u64,
    frame_px: [u32; 2],
    pixel_bytes: u32,
    is_recorded: bool,
}

impl UploadNeed {
    fn add(&mut self, frame: &FrameLeases) {
        let pixel_bytes = u64::from(frame.pixel_bytes);
        let header_bytes = delivery_check::BLOB_HEADER_BYTES as u64;
        let record_bytes = if frame.is_recorded { MAX_RECORD_BYTES } else { 0 };
        let picture_bytes = delivery_check::max_picture_bytes(pixel_bytes, frame.frame_px[0], frame.frame_px[1]);
        self.blob_bytes = self.blob_bytes.max(header_bytes + frame.largest_pixels * pixel_bytes).max(record_bytes);
        self.picture_bytes = self.picture_bytes.max(picture_bytes);
        self.total_bytes += frame.tiles * header_bytes + frame.pixels * pixel_bytes + picture_bytes;
        self.total_bytes += record_bytes * frame.tiles.min(MAX_UNREPORTED_RECORDS);
    }
}

impl Queue {
    /// Whether a worker of this owner holds a lease that needs the given content.
    pub(crate) async fn has_lease(&self, owner: &str, needs: LeaseNeed<'_>) -> Result<bool> {
        let (job, blob) = match needs {
            LeaseNeed::JobFile(job) => (Some(job.to_string()), None),
            LeaseNeed::Blob(hash) => (None, Some(hash)),
        };
        let found: Option<i64> = db::query_scalar(concat!(
            "SELECT 1 FROM (",
            leased_tiles!(),
            ") AS held @join tile ON tile.id = held.tile
             WHERE (?2 IS NULL OR tile.job = (SELECT number FROM job WHERE id = ?2)
                    OR ((SELECT based_on FROM job WHERE number = tile.job) IS NOT NULL
                        AND (SELECT recorded = 1 FROM job WHERE id = ?2)))
               AND (?3 IS NULL OR EXISTS (SELECT 1 FROM tile AS input WHERE input.blob = ?3 AND input.job = tile.job)
                    OR ((SELECT based_on FROM job WHERE number = tile.job) IS NOT NULL
                        AND EXISTS (SELECT 1 FROM tile AS kept WHERE (kept.record IS NOT NULL AND kept.record = ?3)
                            OR (kept.blob = ?3 AND kept.record IS NOT NULL))))
             LIMIT 1"
        ))
        .bind(owner)
        .bind(job)
        .bind(blob)
        .fetch_optional(self.readers())
        .await?;
        Ok(found.is_some())
    }

    /// Bytes that the leases of this owner's workers need to send; nothing without a lease.
    pub(crate) async fn upload_need(&self, owner: &str) -> Result<UploadNeed> {
        let rows = db::query(concat!(
            "SELECT count(*) AS tiles, CAST(sum(tile.width_px * tile.height_px) AS BIGINT) AS pixels,
                    max(tile.width_px * tile.height_px) AS largest_pixels, job.width_px, job.height_px, job.pixel_bytes,
                    job.recorded
             FROM (",
            leased_tiles!(),
            ") AS held @join tile ON tile.id = held.tile @join job ON job.number = tile.job
             GROUP BY job.number, tile.frame, job.width_px, job.height_px, job.pixel_bytes, job.recorded"
        ))
        .bind(owner)
        .fetch_all(self.readers())
        .await?;
        let mut need = UploadNeed::default();
        for row in &rows {
            need.add(&FrameLeases {
                tiles: row.get("tiles")?,
                pixels: row.get("pixels")?,
                largest_pixels: row.get("largest_pixels")?,
                frame_px: [row.get("width_px")?, row.get("height_px")?],
                pixel_bytes: row.get("pixel_bytes")?,
                is_recorded: row.get("recorded")?,
            });
        }
        Ok(need)
    }
}
