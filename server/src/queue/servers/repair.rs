//! Repair after lost bytes, which deletes the rows of missing pictures and renders their frames again, and of books
//! that cannot be right: absurd shares.

use db::Row;

use crate::db;
use crate::db::Durability;
use crate::queue::frames::open;
use crate::queue::jobs::finish::job_state;
use crate::queue::jobs::transitions;
use crate::queue::{Connection, FrameOpening, Queue, Result, Wake, expect_rows, json_list, row_count};
use crate::tile_plan::TilePlan;

/// Most that a share can be ahead of the submitter served last, in microseconds of a worker: 100 days, more than
/// everything that is leased at one time can cost.
const MAX_LEAD_US: i64 = 100 * 24 * 3_600_000_000;

/// Outcome for the frames of missing pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Reopened {
    /// Number of frames that are rendered again.
    pub(crate) frames: u64,
    /// Number of frames of cancelled or failed jobs, which stay without a picture.
    pub(crate) void: u64,
}

/// Result of forgetting a picture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Forgotten {
    /// Outcome for the frames that showed it.
    pub(crate) reopened: Reopened,
    /// Whether a row named it.
    pub(crate) is_known: bool,
}

impl Queue {
    /// Forgets a picture, and wakes workers for the frames that are rendered again.
    pub(crate) async fn forget_picture(&self, hash: &str) -> Result<Forgotten> {
        let hashes = vec![hash.to_owned()];
        let forgotten = self
            .database
            .write(Durability::Full, move |connection| {
                Box::pin(async move {
                    let cached: Option<i64> = db::query_scalar("SELECT 1 FROM picture WHERE hash = ? LIMIT 1")
                        .bind(&hashes[0])
                        .fetch_optional(&mut *connection)
                        .await?;
                    let reopened = forget_pictures(connection, &hashes).await?;
                    let is_known = cached.is_some() || reopened != Reopened::default();
                    Ok(Forgotten { reopened, is_known })
                })
            })
            .await?;
        self.wake(Wake::WORK);
        Ok(forgotten)
    }
}

/// Frame whose picture is missing.
struct LostFrame {
    job: i64,
    frame: u32,
    picture_key: String,
    tiles: i64,
    plan: TilePlan,
    is_rerenderable: bool,
}

impl LostFrame {
    fn read(row: &Row) -> Result<Self> {
        use proto::job::JobState::{Cancelled, Failed, Queued, Running, Succeeded};
        Ok(Self {
            job: row.get("job")?,
            frame: row.get("frame")?,
            picture_key: row.get("picture_key")?,
            tiles: row.get("tiles_total")?,
            plan: TilePlan {
                width_px: row.get("width_px")?,
                height_px: row.get("height_px")?,
                samples: row.get("samples")?,
                pixel_bytes: row.get("pixel_bytes")?,
                edge_px: row.get("edge_px")?,
                frames: row.get("frames_total")?,
            },
            is_rerenderable: match job_state(&row.get::<String>("state")?)? {
                Queued | Running | Succeeded => true,
                Failed | Cancelled => false,
            },
        })
    }
}

/// Number of shares that cannot be right: so far ahead that their submitter would never be served.
const ABSURD_SHARES_SQL: &str = "
    SELECT count(*) FROM share WHERE served_us - coalesce(
        (SELECT served_us FROM share_clock WHERE share_clock.priority = share.priority), 0) > ?";

/// Number of submitters' shares that cannot be right.
pub(crate) async fn absurd_shares(connection: &mut Connection) -> Result<i64> {
    db::query_scalar(ABSURD_SHARES_SQL).bind(MAX_LEAD_US).fetch_one(connection).await
}

/// Starts all shares again from zero: they only decide who is next.
pub(crate) async fn reset_shares(connection: &mut Connection) -> Result<()> {
    db::query("UPDATE share SET served_us = 0").execute(&mut *connection).await?;
    db::query("DELETE FROM share_clock").execute(connection).await?;
    Ok(())
}

/// Deletes the rows of pictures whose bytes are missing. Frames that use them are reopened, and their jobs run
/// again.
pub(crate) async fn forget_pictures(connection: &mut Connection, hashes: &[String]) -> Result<Reopened> {
    let hashes = json_list(hashes);
    let lost = db::query(
        "SELECT frame.job, frame.number AS frame, frame.picture_key, frame.tiles_total, job.state, job.width_px,
                job.height_px, job.samples, job.pixel_bytes, job.edge_px, job.frames_total
         FROM frame JOIN job ON job.number = frame.job
         WHERE frame.picture IS NOT NULL AND frame.picture IN (SELECT value FROM @texts(?))",
    )
    .bind(&hashes)
    .fetch_all(&mut *connection)
    .await?;
    let mut reopened = Reopened::default();
    for row in &lost {
        let lost = LostFrame::read(row)?;
        if lost.is_rerenderable {
            reopen(connection, &lost).await?;
            reopened.frames += 1;
        } else {
            void(connection, &lost).await?;
            reopened.void += 1;
        }
    }
    db::query("DELETE FROM picture WHERE hash IN (SELECT value FROM @texts(?))")
        .bind(&hashes)
        .execute(connection)
        .await?;
    Ok(reopened)
}

async fn reopen(connection: &mut Connection, lost: &LostFrame) -> Result<()> {
    db::query("DELETE FROM verification WHERE job = ? AND frame = ?")
        .bind(lost.job)
        .bind(lost.frame)
        .execute(&mut *connection)
        .await?;
    db::query("DELETE FROM tile WHERE job = ? AND frame = ?")
        .bind(lost.job)
        .bind(lost.frame)
        .execute(&mut *connection)
        .await?;
    let opened = db::query(
        "UPDATE frame SET state = 'open', picture = NULL, size_bytes = NULL, tiles_done = 0, tiles_total = ?
         WHERE job = ? AND number = ? AND state = 'stored'",
    )
    .bind(row_count(lost.plan.tiles().len()))
    .bind(lost.job)
    .bind(lost.frame)
    .execute(&mut *connection)
    .await?;
    expect_rows("frame: stored to open", 1, opened)?;
    transitions::reopen(connection, lost.job, lost.tiles, lost.plan.frame_rays().cast_signed()).await?;
    let opening = FrameOpening {
        job: lost.job,
        frame: lost.frame,
        picture_key: lost.picture_key.clone(),
        scene: None,
        tiles: lost.plan.tiles(),
        samples: lost.plan.samples,
    };
    open::create_tiles(connection, &opening).await
}

async fn void(connection: &mut Connection, lost: &LostFrame) -> Result<()> {
    let voided = db::query(
        "UPDATE frame SET state = 'void', picture = NULL, size_bytes = NULL
         WHERE job = ? AND number = ? AND state = 'stored'",
    )
    .bind(lost.job)
    .bind(lost.frame)
    .execute(&mut *connection)
    .await?;
    expect_rows("frame: stored to void", 1, voided)?;
    let counters = db::query("UPDATE job SET frames_stored = frames_stored - 1 WHERE number = ?")
        .bind(lost.job)
        .execute(connection)
        .await?;
    expect_rows("job: counters", 1, counters)
}
