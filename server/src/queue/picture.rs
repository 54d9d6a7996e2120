//! Pictures: delivered for a frame's stitch, or for all tiles of a frame at once.
//!
//! The picture's bytes are durable before its row is written here; a second picture for a frame has no effect.

use std::collections::BTreeMap;

use proto::{LeaseId, WorkerId};

use super::deliver::{DeliverResult, count_mismatches, record_durations};
use super::effects::FramePicture;
use super::lease::{self, LeaseEnd, LiveLease};
use super::verification::{self, Candidate};
use super::{Connection, Result, TransitionContext, job_transitions, lease_ends, row_count, tile_results};
use crate::db;
use crate::db::DatabaseError;

/// Records a frame's picture: for its stitch, or for every tile of the frame at once.
pub(super) async fn accept_picture(
    connection: &mut Connection,
    worker: WorkerId,
    leases: &[LeaseId],
    hash: &str,
    size_bytes: u64,
    moment: TransitionContext,
    delivered: &mut DeliverResult,
) -> Result<()> {
    let held = lease::live_leases_among(connection, worker, leases).await?;
    let live: Vec<&str> = held.iter().map(|held| held.lease.as_str()).collect();
    for lease in leases.iter().filter(|lease| !live.contains(&lease.to_string().as_str())) {
        delivered.lost.push(*lease);
        delivered.nondeterministic += count_mismatches(connection, FIRST_PICTURE_SQL, *lease, hash).await?;
    }
    let mut frames: BTreeMap<(i64, u32), Vec<LiveLease>> = BTreeMap::new();
    for held in held {
        frames.entry((held.job, held.frame)).or_default().push(held);
    }
    for ((job, frame), held) in frames {
        let stitched = matches!(held.as_slice(), [held] if held.stitch);
        if stitched || is_every_tile(connection, job, frame, held.len()).await? {
            let picture = StoredPicture { job, frame, hash, size_bytes };
            store_frame(connection, &held, stitched, &picture, moment, delivered).await?;
            let candidate: Vec<Candidate> = Candidate::picture(&held, hash).into_iter().collect();
            let (unverified, wake) = verification::choose(connection, &worker.to_string(), &candidate, moment).await?;
            delivered.unverified += unverified;
            delivered.ring.add(wake);
            continue;
        }
        for held in held {
            let message = "its worker delivered a picture without leases for all tiles of the frame";
            let ring = lease::end_without_result(connection, &held, LeaseEnd::Released, message, moment).await?;
            delivered.ring.add(ring);
        }
    }
    Ok(())
}

/// Whether these leased tiles are all tiles of a frame.
async fn is_every_tile(connection: &mut Connection, job: i64, frame: u32, tiles: usize) -> Result<bool> {
    let total: Option<i64> =
        db::query_scalar("SELECT tiles_total FROM frame WHERE job = ? AND number = ? AND state = 'open'")
            .bind(job)
            .bind(frame)
            .fetch_optional(connection)
            .await?;
    Ok(total == Some(row_count(tiles)))
}

struct StoredPicture<'a> {
    job: i64,
    frame: u32,
    hash: &'a str,
    size_bytes: u64,
}

async fn store_frame(
    connection: &mut Connection,
    held: &[LiveLease],
    stitched: bool,
    picture: &StoredPicture<'_>,
    moment: TransitionContext,
    delivered: &mut DeliverResult,
) -> Result<()> {
    let ids: Vec<i64> = held.iter().map(|held| held.tile).collect();
    let leases = held.iter().map(|held| &held.lease);
    delivered.ring.add(lease_ends::finish(connection, leases, ids.iter().copied()).await?);
    let progress = tile_results::finish(connection, &ids).await?;
    let key: Option<String> = db::query_scalar(
        "UPDATE frame SET state = 'stored', picture = ?1, size_bytes = ?2, tiles_done = tiles_total
         WHERE job = ?3 AND number = ?4 AND state = ?5 RETURNING picture_key",
    )
    .bind(picture.hash)
    .bind(picture.size_bytes.cast_signed())
    .bind(picture.job)
    .bind(picture.frame)
    .bind(if stitched { "stitching" } else { "open" })
    .fetch_optional(&mut *connection)
    .await?;
    let key = key.ok_or(DatabaseError::Rows { what: "frame: to stored", expected: 1, changed: 0 })?;
    delivered.nondeterministic += cache_picture(connection, picture, &key, moment).await?;
    let stored = FramePicture { frame: picture.frame, hash: picture.hash.to_owned(), size_bytes: picture.size_bytes };
    let progressed = job_transitions::progress(connection, picture.job, progress.with_picture(stored)).await?;
    if !stitched {
        record_durations(connection, held, progressed.tiles_done, moment).await?;
    }
    if progressed.is_complete {
        job_transitions::succeed(connection, picture.job, moment).await?;
    }
    if stitched {
        let blobs = db::query("SELECT DISTINCT blob FROM tile WHERE job = ? AND frame = ? AND blob IS NOT NULL")
            .bind(picture.job)
            .bind(picture.frame)
            .fetch_all(connection)
            .await?;
        for row in blobs {
            delivered.leftovers.push(row.get("blob")?);
        }
    }
    Ok(())
}

/// Picture of a lease's frame, if it is stored.
const FIRST_PICTURE_SQL: &str = "SELECT frame.picture FROM lease JOIN tile ON tile.id = lease.tile
     JOIN frame ON frame.job = tile.job AND frame.number = tile.frame WHERE lease.id = ?";

/// Adds a picture to the cache. The first one of a cache key is kept, unless the job was to bypass it: its
/// picture replaces the first. Returns the number of pictures that differ from it.
async fn cache_picture(
    connection: &mut Connection,
    picture: &StoredPicture<'_>,
    key: &str,
    moment: TransitionContext,
) -> Result<u64> {
    let first: Option<String> =
        db::query_scalar("SELECT hash FROM picture WHERE key = ?").bind(key).fetch_optional(&mut *connection).await?;
    db::query(
        "INSERT INTO picture (key, hash, size_bytes, media_type, stored_at_ms)
         SELECT ?1, ?2, ?3, media_type, ?4 FROM job WHERE number = ?5
         ON CONFLICT (key) DO UPDATE SET hash = excluded.hash, size_bytes = excluded.size_bytes,
             stored_at_ms = excluded.stored_at_ms
         WHERE (SELECT fresh = 1 FROM job WHERE number = ?5)",
    )
    .bind(key)
    .bind(picture.hash)
    .bind(picture.size_bytes.cast_signed())
    .bind(moment.wall_ms)
    .bind(picture.job)
    .execute(&mut *connection)
    .await?;
    let Some(first) = first.filter(|first| first != picture.hash) else { return Ok(0) };
    let job = super::job_id(connection, picture.job).await?;
    tracing::error!(
        code = "nondeterministic_picture", %job, frame = picture.frame, %first,
        second = picture.hash, "one picture was rendered in two ways; later jobs get the first, unless this job bypasses the cache"
    );
    Ok(1)
}
