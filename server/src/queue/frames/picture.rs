//! Pictures: delivered for a frame's stitch, or for all tiles of a frame at once.
//!
//! The picture's bytes are durable before its row is written here; a second picture for a frame has no effect.

use crate::db;
use crate::db::DatabaseError;
use crate::queue::events::effects::FramePicture;
use crate::queue::jobs::transitions;
use crate::queue::leases::deliver::{DeliverResult, record_durations};
use crate::queue::leases::ends;
use crate::queue::tiles::results;
use crate::queue::workers::state::UsedLease;
use crate::queue::{Connection, Result, TransitionContext};

/// A picture that a worker has stored.
pub(in crate::queue) struct StoredPicture<'a> {
    /// The job's number.
    pub(in crate::queue) job: i64,
    /// The frame.
    pub(in crate::queue) frame: u32,
    /// BLAKE3 of its bytes, in hex.
    pub(in crate::queue) hash: &'a str,
    /// Its size.
    pub(in crate::queue) size_bytes: u64,
    /// Whether it was made from the blobs of its tiles.
    pub(in crate::queue) stitched: bool,
}

/// Records a frame's picture, delivered under the lease of its stitch, or of every tile of the frame.
pub(in crate::queue) async fn store(
    connection: &mut Connection,
    picture: &StoredPicture<'_>,
    leases: &[UsedLease<'_>],
    context: TransitionContext,
    delivered: &mut DeliverResult,
) -> Result<()> {
    let ids: Vec<i64> = leases.iter().map(|used| used.held.live.tile).collect();
    delivered.woken.add(ends::finish(connection, leases, context).await?);
    let progress = results::finish(connection, &ids).await?;
    let stored = db::query(
        "UPDATE frame SET state = 'stored', picture = ?1, size_bytes = ?2, tiles_done = tiles_total
         WHERE job = ?3 AND number = ?4 AND state = ?5
         RETURNING picture_key, (SELECT hash FROM picture WHERE picture.key = frame.picture_key) AS first",
    )
    .bind(picture.hash)
    .bind(picture.size_bytes.cast_signed())
    .bind(picture.job)
    .bind(picture.frame)
    .bind(if picture.stitched { "stitching" } else { "open" })
    .fetch_optional(&mut *connection)
    .await?;
    let stored = stored.ok_or(DatabaseError::Rows { what: "frame: to stored", expected: 1, changed: 0 })?;
    let (key, first): (String, Option<String>) = (stored.get("picture_key")?, stored.get("first")?);
    delivered.nondeterministic += cache_picture(connection, picture, &key, first, context).await?;
    let stored = FramePicture { frame: picture.frame, hash: picture.hash.to_owned(), size_bytes: picture.size_bytes };
    let progressed = transitions::progress(connection, picture.job, progress.with_picture(stored)).await?;
    if !picture.stitched {
        record_durations(connection, leases, progressed.tiles_done, context).await?;
    }
    if progressed.is_complete {
        transitions::succeed(connection, picture.job, context).await?;
    }
    if picture.stitched {
        let blobs = db::query(BLOBS_SQL).bind(picture.job).bind(picture.frame).fetch_all(connection).await?;
        for row in blobs {
            delivered.orphans.push(row.get("blob")?);
        }
    }
    Ok(())
}

/// Blobs of a frame that nothing needs once its picture is stored: none of a recorded job.
const BLOBS_SQL: &str = "SELECT DISTINCT blob FROM tile WHERE job = ?1 AND frame = ?2 AND blob IS NOT NULL
     AND (SELECT recorded = 0 FROM job WHERE number = ?1)";

/// Adds a picture to the cache, which had `first` under its key. The first one of a cache key is kept, unless the job was to bypass it: its
/// picture replaces the first. Returns the number of pictures that differ from it.
async fn cache_picture(
    connection: &mut Connection,
    picture: &StoredPicture<'_>,
    key: &str,
    first: Option<String>,
    context: TransitionContext,
) -> Result<u64> {
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
    .bind(context.wall_ms)
    .bind(picture.job)
    .execute(&mut *connection)
    .await?;
    let Some(first) = first.filter(|first| first != picture.hash) else { return Ok(0) };
    let job = crate::queue::job_id(connection, picture.job).await?;
    tracing::error!(
        code = "nondeterministic_picture", %job, frame = picture.frame, %first,
        second = picture.hash, "one picture was rendered in two ways; later jobs get the first, unless this job bypasses the cache"
    );
    Ok(1)
}
