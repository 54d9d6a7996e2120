//! Opening a frame: creates its row and its tiles, or stores it at once from a picture that exists already.

use crate::db;
use proto::Rect;

use crate::queue::events::effects::{FramePicture, Progress};
use crate::queue::jobs::transitions;
use crate::queue::{Connection, Result, TransitionContext, expect_rows, row_count};

/// Data needed to open a frame.
#[derive(Clone, Debug)]
pub(crate) struct FrameOpening {
    /// The job's number.
    pub(crate) job: i64,
    /// Frame, which must be the job's next.
    pub(crate) frame: u32,
    /// Cache key of the frame's picture.
    pub(crate) picture_key: String,
    /// Hash of its scene, by which the picture's file leads here.
    pub(crate) scene: Option<String>,
    /// The frame's tiles.
    pub(crate) tiles: Vec<Rect>,
    /// Rays per pixel.
    pub(crate) samples: u32,
}

/// Outcome of opening a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum OpenOutcome {
    /// The frame was stored from a cached picture.
    Stored,
    /// The frame's tiles must be rendered.
    Open,
    /// The frame is not the job's next: another call opened it, or the job has finished.
    Stale,
}

/// Opens a frame: stores it from the cache if possible, otherwise creates its tiles.
pub(in crate::queue) async fn open(
    connection: &mut Connection,
    opening: &FrameOpening,
    context: TransitionContext,
) -> Result<OpenOutcome> {
    match open_from_cache(connection, opening, context).await? {
        OpenOutcome::Open => {}
        settled @ (OpenOutcome::Stored | OpenOutcome::Stale) => return Ok(settled),
    }
    count_opened(connection, opening).await?;
    db::query("INSERT INTO frame (job, number, state, picture_key, scene, tiles_total) VALUES (?, ?, 'open', ?, ?, ?)")
        .bind(opening.job)
        .bind(opening.frame)
        .bind(&opening.picture_key)
        .bind(&opening.scene)
        .bind(row_count(opening.tiles.len()))
        .execute(&mut *connection)
        .await?;
    create_tiles(connection, opening).await?;
    Ok(OpenOutcome::Open)
}

/// Creates the tiles of a frame.
pub(in crate::queue) async fn create_tiles(connection: &mut Connection, opening: &FrameOpening) -> Result<()> {
    let samples = u64::from(opening.samples);
    let rects = opening.tiles.iter().enumerate();
    let tiles: Vec<_> = rects
        .map(|(position, rect)| (position, rect.x, rect.y, rect.width, rect.height, rect.pixels() * samples))
        .collect();
    let made = db::query(
        "INSERT INTO tile (job, frame, kind, position, x_px, y_px, width_px, height_px, rays, state)
         SELECT ?1, ?2, 'render', CAST(value ->> 0 AS BIGINT), CAST(value ->> 1 AS BIGINT), CAST(value ->> 2 AS BIGINT),
                CAST(value ->> 3 AS BIGINT), CAST(value ->> 4 AS BIGINT), CAST(value ->> 5 AS BIGINT), 'ready'
         FROM @rows(?3)",
    )
    .bind(opening.job)
    .bind(opening.frame)
    .bind(serde_json::json!(tiles).to_string())
    .execute(connection)
    .await?;
    expect_rows("tile: made", opening.tiles.len() as u64, made)
}

/// Whether a job bypasses the cache: because it was asked to, or because its tiles are to be recorded, and there are no
/// earlier ones.
const JOB_SQL: &str = "SELECT fresh = 1 OR (recorded = 1 AND based_on IS NULL) AS fresh, rays_peak FROM job
     WHERE number = ? AND frames_opened = ? AND finished_at_ms IS NULL";

/// Stores a frame from a cached picture, unless the job bypasses the cache.
pub(in crate::queue) async fn open_from_cache(
    connection: &mut Connection,
    opening: &FrameOpening,
    context: TransitionContext,
) -> Result<OpenOutcome> {
    let job = db::query(JOB_SQL).bind(opening.job).bind(opening.frame).fetch_optional(&mut *connection).await?;
    let Some(job) = job else { return Ok(OpenOutcome::Stale) };
    if job.get("fresh")? {
        return Ok(OpenOutcome::Open);
    }
    let stored = db::query(
        "INSERT INTO frame (job, number, state, picture_key, scene, tiles_total, tiles_done, picture, size_bytes)
         SELECT ?1, ?2, 'stored', key, CAST(?5 AS TEXT), ?3, ?3, hash, size_bytes FROM picture WHERE key = ?4
         RETURNING picture, size_bytes",
    )
    .bind(opening.job)
    .bind(opening.frame)
    .bind(row_count(opening.tiles.len()))
    .bind(&opening.picture_key)
    .bind(&opening.scene)
    .fetch_optional(&mut *connection)
    .await?;
    let Some(stored) = stored else { return Ok(OpenOutcome::Open) };
    let picture =
        FramePicture { frame: opening.frame, hash: stored.get("picture")?, size_bytes: stored.get("size_bytes")? };
    count_opened(connection, opening).await?;
    let rays: u64 = opening.tiles.iter().map(|rect| rect.pixels() * u64::from(opening.samples)).sum();
    let (tiles, peak_before) = (row_count(opening.tiles.len()), job.get("rays_peak")?);
    let progress = Progress::of_cached_frame(picture, tiles, rays.cast_signed(), peak_before);
    if transitions::progress(connection, opening.job, progress).await?.is_complete {
        transitions::succeed(connection, opening.job, context).await?;
    }
    Ok(OpenOutcome::Stored)
}

async fn count_opened(connection: &mut Connection, opening: &FrameOpening) -> Result<()> {
    let advanced = db::query("UPDATE job SET frames_opened = frames_opened + 1 WHERE number = ? AND frames_opened = ?")
        .bind(opening.job)
        .bind(opening.frame)
        .execute(connection)
        .await?;
    expect_rows("job: next frame", 1, advanced)
}
