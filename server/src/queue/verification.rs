//! Verification: a share of what remote workers deliver is rendered again by another worker. All workers give the
//! same bytes, so two different hashes show that one of them is wrong; a worker of the pool, or a third one, decides.
//! The wrong one is quarantined, and what it delivered since its last confirmed result is undone (see `undo`).
//!
//! Workers of one key are one witness: while a worker of another owner is ready, none verifies a result of its own key. A
//! result that no worker could verify yet waits until one can, behind all other work once it is old.
//!
//! A result counts at once, whether it is chosen or not. The leases of verifications are in a table of their own, so
//! that they change no tile.

mod leases;
mod verdict;

use crate::db;
use proto::LeaseId;
use proto::worker_protocol::{Batch, BatchWork};

pub(super) use leases::{expire, release_of, renew, reset_after_restart};
pub(super) use verdict::{VerifierLease, deliver, live_leases, reject};

use crate::queue::leases::claim::{self, ClaimRequest};
use crate::queue::leases::jitter;
use crate::queue::workers::state::{HeldLease, UsedLease, WorkerState};
use crate::queue::{Connection, Result, TransitionContext, Wake, expect_rows, json_numbers, parse_column};

/// Position of the picture of a stitched frame.
const STITCH: i64 = -1;
/// Position of the picture of a frame that was rendered as a whole.
const WHOLE_FRAME: i64 = -2;
/// Maximum number of results that wait for a verification; beyond it none is chosen.
const MAX_PENDING: i64 = 1000;
/// Maximum number of tiles that are verified together.
const MAX_TILES_TOGETHER: i64 = 8;

/// Which results of remote workers are verified.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct VerificationPolicy {
    /// Fraction of their results.
    pub(crate) share: f64,
    /// Time after a worker's registration in which all its results are verified, in milliseconds.
    pub(crate) new_worker_ms: i64,
}

/// Changes of verifications in one transition.
#[derive(Clone, Debug, Default)]
pub(crate) struct VerificationOutcome {
    /// Results that were confirmed.
    pub(crate) agreed: u64,
    /// Results that were not.
    pub(crate) differed: u64,
    /// Results that were chosen, but not verified, for example because there is no other worker.
    pub(crate) skipped: u64,
    /// Hashes of pictures that were forgotten.
    pub(crate) forgotten: Vec<String>,
}

/// A result that counts, and may be chosen.
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    job: i64,
    frame: u32,
    /// Of its tile, or [`STITCH`], or [`WHOLE_FRAME`].
    position: i64,
    lease: String,
    hash: String,
}

impl Candidate {
    /// A tile's blob.
    pub(super) fn tile(held: &HeldLease, hash: &str) -> Self {
        let (lease, hash) = (held.live.lease.clone(), hash.to_owned());
        Self { job: held.live.job, frame: held.live.frame, position: held.position, lease, hash }
    }

    /// A frame's picture, delivered under these leases.
    pub(super) fn picture(leases: &[UsedLease<'_>], hash: &str) -> Option<Self> {
        let last = leases.iter().map(|used| &used.held.live).max_by_key(|held| &held.lease)?;
        let position = if last.stitch { STITCH } else { WHOLE_FRAME };
        Some(Self { job: last.job, frame: last.frame, position, lease: last.lease.clone(), hash: hash.to_owned() })
    }
}

/// Chooses among a worker's results of one frame those that are verified. Returns how many cannot be, and wakes
/// verifiers.
pub(super) async fn choose(
    connection: &mut Connection,
    worker: &WorkerState,
    candidates: &[Candidate],
    context: TransitionContext,
) -> Result<(u64, Wake)> {
    let policy = context.verification;
    if policy == VerificationPolicy::default() || worker.is_pool {
        return Ok((0, Wake::default()));
    }
    let is_new = context.now_ms - worker.registered_ms < policy.new_worker_ms;
    let mut chosen: Vec<&Candidate> = candidates.iter().filter(|_| is_new || jitter() < policy.share).collect();
    let Some(first) = chosen.first() else { return Ok((0, Wake::default())) };
    let (job, frame) = (first.job, first.frame);
    let row = db::query(
        "SELECT (SELECT count(*) FROM verification) AS pending,
                EXISTS (SELECT 1 FROM verification WHERE job = ?1 AND frame = ?2) AS has_others_of_frame",
    )
    .bind(job)
    .bind(frame)
    .fetch_one(&mut *connection)
    .await?;
    let wanted = chosen.len();
    let room = (MAX_PENDING - row.get::<i64>("pending")?).max(0);
    chosen.truncate(usize::try_from(room).unwrap_or(usize::MAX));
    let skipped = (wanted - chosen.len()) as u64;
    if chosen.is_empty() {
        return Ok((skipped, Wake::default()));
    }
    if row.get("has_others_of_frame")? {
        // A result that was delivered again, because the first was lost, is verified instead of it.
        db::query(
            "DELETE FROM verification WHERE job = ? AND frame = ? AND position IN (SELECT value FROM @numbers(?))",
        )
        .bind(job)
        .bind(frame)
        .bind(json_numbers(chosen.iter().map(|candidate| candidate.position)))
        .execute(&mut *connection)
        .await?;
    }
    let rows: Vec<(i64, &str, &str)> = chosen
        .iter()
        .map(|candidate| (candidate.position, candidate.lease.as_str(), candidate.hash.as_str()))
        .collect();
    let made = db::query(
        "INSERT INTO verification (job, frame, position, worker, lease, hash, created_ms)
         SELECT CAST(?1 AS BIGINT), CAST(?2 AS BIGINT), CAST(value ->> 0 AS BIGINT), CAST(?3 AS TEXT), value ->> 1,
                value ->> 2, CAST(?4 AS BIGINT)
         FROM @rows(?5)",
    )
    .bind(job)
    .bind(frame)
    .bind(&worker.id)
    .bind(context.now_ms)
    .bind(serde_json::json!(rows).to_string())
    .execute(connection)
    .await?;
    expect_rows("verification: waiting", rows.len() as u64, made)?;
    Ok((skipped, Wake::WORK))
}

/// Oldest result that this worker may verify: not its own; if a worker of the pool could verify it, only by the pool; one of
/// its own key only if all who have spoken are of this key, and no worker of another is ready. Old ones are apart.
const NEXT_SQL: &str = "
    SELECT verification.number, verification.job, frame, position, job.id, job.tile_seconds
    FROM verification JOIN job ON job.number = verification.job
    JOIN worker AS me ON me.id = ?1
    JOIN worker AS first ON first.id = verification.worker
    LEFT JOIN worker AS second ON second.id = second_worker
    WHERE verifier IS NULL AND verification.worker <> ?1 AND second_worker IS DISTINCT FROM ?1
      AND (verification.created_ms > ?3) = (?4 = 0) AND failed_by IS DISTINCT FROM ?1
      AND (me.pool = 1
           OR (first.owner IS DISTINCT FROM me.owner AND (second_worker IS NULL OR second.owner IS DISTINCT FROM me.owner))
           OR (first.owner IS NOT DISTINCT FROM me.owner
               AND (second_worker IS NULL OR second.owner IS NOT DISTINCT FROM me.owner)
               AND NOT EXISTS (SELECT 1 FROM worker AS other
                   WHERE other.state <> 'gone' AND other.state = 'ready' AND other.owner IS DISTINCT FROM me.owner)))
      AND (position = -1 OR job.nodes <= ?2)
      AND (position <> -1 OR NOT EXISTS (SELECT 1 FROM tile WHERE tile.job = verification.job
           AND tile.frame = verification.frame AND tile.kind = 'render' AND tile.blob IS NULL))
      AND (me.pool = 1 OR NOT EXISTS (
           SELECT 1 FROM worker AS own WHERE own.state <> 'gone' AND own.state = 'ready' AND own.pool = 1
           AND own.id IS DISTINCT FROM failed_by
           AND (position = -1 OR coalesce(own.max_nodes, job.nodes) >= job.nodes)))
      AND (SELECT value = 0 FROM meta WHERE name = 'paused')
    ORDER BY verification.number LIMIT 1";

/// Tiles of the same frame that this worker may verify: of the same workers as the first of them.
const TOGETHER_SQL: &str = "
    SELECT verification.number, tile.id, tile.position, tile.x_px, tile.y_px, tile.width_px, tile.height_px
    FROM verification @join tile ON tile.job = verification.job AND tile.frame = verification.frame
                                AND tile.position = verification.position
    JOIN verification AS next ON next.number = ?1 AND verification.worker = next.worker
        AND verification.second_worker IS NOT DISTINCT FROM next.second_worker
        AND verification.failed_by IS NOT DISTINCT FROM next.failed_by
    WHERE verification.job = ?2 AND verification.frame = ?3 AND verification.position >= 0
      AND verification.verifier IS NULL
    ORDER BY verification.position LIMIT ?4";

/// Tiles of a frame.
const TILES_SQL: &str = "
    SELECT id, position, x_px, y_px, width_px, height_px FROM tile
    WHERE job = ? AND frame = ? AND kind = 'render' ORDER BY position";

/// Which verifications a worker claims.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Age {
    /// Recent results, before other work.
    Recent,
    /// Results that have waited for long, if there is no other work.
    Old,
}

/// Claims a verification for a worker.
pub(super) async fn claim(
    connection: &mut Connection,
    claimant: ClaimRequest,
    age: Age,
    context: TransitionContext,
) -> Result<Option<Batch>> {
    let worker = claimant.worker.to_string();
    let next = db::query(NEXT_SQL)
        .bind(&worker)
        .bind(claimant.max_nodes)
        .bind(context.now_ms - leases::MAX_RECENT_MS)
        .bind(age == Age::Old)
        .fetch_optional(&mut *connection)
        .await?;
    let Some(next) = next else { return Ok(None) };
    let (number, job): (i64, i64) = (next.get("number")?, next.get("job")?);
    let (frame, position): (u32, i64) = (next.get("frame")?, next.get("position")?);
    let id: String = next.get("id")?;
    let work = match position {
        STITCH => {
            let lease = LeaseId::new();
            leases::grant(connection, &worker, &[(number, lease, STITCH)], context).await?;
            claim::stitch_work(connection, job, frame, lease).await?
        }
        WHOLE_FRAME => {
            let rows = db::query(TILES_SQL).bind(job).bind(frame).fetch_all(&mut *connection).await?;
            let (tiles, _) = claim::new_leases(&rows)?;
            let granted: Vec<_> = tiles.iter().map(|tile| (number, tile.lease, i64::from(tile.index))).collect();
            leases::grant(connection, &worker, &granted, context).await?;
            BatchWork::Render { tiles, whole_frame: true }
        }
        _ => {
            let together = db::query(TOGETHER_SQL)
                .bind(number)
                .bind(job)
                .bind(frame)
                .bind(MAX_TILES_TOGETHER)
                .fetch_all(&mut *connection)
                .await?;
            let (tiles, _) = claim::new_leases(&together)?;
            let mut granted = Vec::with_capacity(tiles.len());
            for (row, tile) in together.iter().zip(&tiles) {
                granted.push((row.get("number")?, tile.lease, i64::from(tile.index)));
            }
            leases::grant(connection, &worker, &granted, context).await?;
            BatchWork::Render { tiles, whole_frame: false }
        }
    };
    let job = parse_column("job.id", &id, |id| id.parse().ok())?;
    // A verification renders what was kept.
    Ok(Some(Batch { job, frame, tile_seconds: Some(next.get("tile_seconds")?), work, recording: None }))
}
