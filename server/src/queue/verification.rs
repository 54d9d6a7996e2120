//! Verification: a share of what remote workers deliver is rendered again by another worker. All workers give the
//! same bytes, so two different hashes show that one of them is wrong; a worker of the pool, or a third one, decides.
//! The wrong one is quarantined, and what it delivered since its last confirmed result is undone (see `undo`).
//!
//! A result counts at once, whether it is chosen or not. The leases of verifications are in a table of their own, so
//! that they change no tile.

mod leases;
mod verdict;

use crate::db;
use proto::LeaseId;
use proto::worker_protocol::{Batch, BatchWork};

pub(super) use leases::{discard_expired, live_lease_ids, release_of, renew, reset_after_restart};
pub(super) use verdict::{deliver, reject};

use super::claim::{self, ClaimRequest};
use super::lease::{LiveLease, jitter};
use super::worker_state::UsedLease;
use super::{Connection, Result, TransitionContext, Wake};

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
    part: DeliveredPart,
    lease: String,
    hash: String,
}

/// Part of a frame that a result covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum DeliveredPart {
    /// The tile with this row.
    Tile(i64),
    /// A frame's picture, made from the blobs of its tiles.
    Stitch,
    /// A frame's picture, rendered as a whole.
    WholeFrame,
}

impl Candidate {
    /// A tile's blob.
    pub(super) fn tile(held: &LiveLease, hash: &str) -> Self {
        let (lease, hash) = (held.lease.clone(), hash.to_owned());
        Self { job: held.job, frame: held.frame, part: DeliveredPart::Tile(held.tile), lease, hash }
    }

    /// A frame's picture, delivered under these leases.
    pub(super) fn picture(leases: &[UsedLease<'_>], hash: &str) -> Option<Self> {
        let last = leases.iter().map(|used| &used.held.live).max_by_key(|held| &held.lease)?;
        let part = if last.stitch { DeliveredPart::Stitch } else { DeliveredPart::WholeFrame };
        Some(Self { job: last.job, frame: last.frame, part, lease: last.lease.clone(), hash: hash.to_owned() })
    }
}

/// Chooses among results of a worker those that are verified. Returns how many cannot be, and wakes verifiers.
pub(super) async fn choose(
    connection: &mut Connection,
    worker: &str,
    candidates: &[Candidate],
    moment: TransitionContext,
) -> Result<(u64, Wake)> {
    let policy = moment.verification;
    let (mut skipped, mut ring) = (0, Wake::default());
    if candidates.is_empty() || policy == VerificationPolicy::default() {
        return Ok((skipped, ring));
    }
    let row = db::query(
        "SELECT pool, registered_ms, (SELECT count(*) FROM verification) AS pending,
                EXISTS (SELECT 1 FROM worker AS other WHERE other.state <> 'gone' AND other.state = 'ready'
                        AND other.id <> worker.id) AS has_other
         FROM worker WHERE id = ?",
    )
    .bind(worker)
    .fetch_one(&mut *connection)
    .await?;
    if row.get("pool")? {
        return Ok((skipped, ring));
    }
    let is_new = moment.now_ms - row.get::<i64>("registered_ms")? < policy.new_worker_ms;
    let (mut pending, has_other): (i64, bool) = (row.get("pending")?, row.get("has_other")?);
    for candidate in candidates {
        if !is_new && jitter() >= policy.share {
            continue;
        }
        if !has_other || pending >= MAX_PENDING {
            skipped += 1;
            continue;
        }
        insert(connection, worker, candidate, moment).await?;
        pending += 1;
        ring.add(Wake::WORK);
    }
    Ok((skipped, ring))
}

async fn insert(
    connection: &mut Connection,
    worker: &str,
    candidate: &Candidate,
    moment: TransitionContext,
) -> Result<()> {
    let position = match candidate.part {
        DeliveredPart::Tile(tile) => {
            db::query_scalar("SELECT position FROM tile WHERE id = ?").bind(tile).fetch_one(&mut *connection).await?
        }
        DeliveredPart::Stitch => STITCH,
        DeliveredPart::WholeFrame => WHOLE_FRAME,
    };
    // A result that was delivered again, because the first was lost, is verified instead of it.
    db::query("DELETE FROM verification WHERE job = ? AND frame = ? AND position = ?")
        .bind(candidate.job)
        .bind(candidate.frame)
        .bind(position)
        .execute(&mut *connection)
        .await?;
    db::query(
        "INSERT INTO verification (job, frame, position, worker, lease, hash, created_ms)
         VALUES (?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(candidate.job)
    .bind(candidate.frame)
    .bind(position)
    .bind(worker)
    .bind(&candidate.lease)
    .bind(&candidate.hash)
    .bind(moment.now_ms)
    .execute(connection)
    .await?;
    Ok(())
}

/// Oldest result that this worker may verify: not its own; if a worker of the pool could verify it, only by the pool.
const NEXT_SQL: &str = "
    SELECT verification.number, verification.job, frame, position
    FROM verification JOIN job ON job.number = verification.job
    WHERE verifier IS NULL AND verification.worker <> ?1 AND second_worker IS DISTINCT FROM ?1
      AND (position = -1 OR job.nodes <= ?2)
      AND (position <> -1 OR NOT EXISTS (SELECT 1 FROM tile WHERE tile.job = verification.job
           AND tile.frame = verification.frame AND tile.kind = 'render' AND tile.blob IS NULL))
      AND ((SELECT pool = 1 FROM worker WHERE id = ?1) OR NOT EXISTS (
           SELECT 1 FROM worker AS own WHERE own.state <> 'gone' AND own.state = 'ready' AND own.pool = 1
           AND (position = -1 OR coalesce(own.max_nodes, job.nodes) >= job.nodes)))
      AND (SELECT value = 0 FROM meta WHERE name = 'paused')
    ORDER BY verification.number LIMIT 1";

/// Other tiles of the same frame that this worker may verify.
const TOGETHER_SQL: &str = "
    SELECT number, position FROM verification
    WHERE job = ?2 AND frame = ?3 AND position >= 0 AND verifier IS NULL AND worker <> ?1 AND second_worker IS DISTINCT FROM ?1
    ORDER BY position LIMIT ?4";

/// Claims a verification for a worker.
pub(super) async fn claim(
    connection: &mut Connection,
    claimant: ClaimRequest,
    moment: TransitionContext,
) -> Result<Option<Batch>> {
    let worker = claimant.worker.to_string();
    let next = db::query(NEXT_SQL).bind(&worker).bind(claimant.max_nodes).fetch_optional(&mut *connection).await?;
    let Some(next) = next else { return Ok(None) };
    let (number, job): (i64, i64) = (next.get("number")?, next.get("job")?);
    let (frame, position): (u32, i64) = (next.get("frame")?, next.get("position")?);
    let work = match position {
        STITCH => {
            let lease = LeaseId::new();
            leases::grant(connection, &worker, &[(number, lease, STITCH)], moment).await?;
            claim::stitch_work(connection, job, frame, lease).await?
        }
        WHOLE_FRAME => {
            let rows = tiles(connection, job, frame, None).await?;
            let (tiles, _) = claim::new_leases(&rows)?;
            let granted: Vec<_> = tiles.iter().map(|tile| (number, tile.lease, i64::from(tile.index))).collect();
            leases::grant(connection, &worker, &granted, moment).await?;
            BatchWork::Render { tiles, whole_frame: true }
        }
        _ => {
            let together = db::query(TOGETHER_SQL)
                .bind(&worker)
                .bind(job)
                .bind(frame)
                .bind(MAX_TILES_TOGETHER)
                .fetch_all(&mut *connection)
                .await?;
            let (mut all, mut granted) = (Vec::new(), Vec::new());
            for row in together {
                let (number, position): (i64, i64) = (row.get("number")?, row.get("position")?);
                let rows = tiles(connection, job, frame, Some(position)).await?;
                let (tiles, _) = claim::new_leases(&rows)?;
                granted.extend(tiles.iter().map(|tile| (number, tile.lease, position)));
                all.extend(tiles);
            }
            leases::grant(connection, &worker, &granted, moment).await?;
            BatchWork::Render { tiles: all, whole_frame: false }
        }
    };
    let job = claim::job(connection, job).await?;
    Ok(Some(Batch { job: job.id, frame, tile_seconds: Some(job.tile_seconds), work }))
}

/// Tiles of a frame, or one of them.
async fn tiles(connection: &mut Connection, job: i64, frame: u32, position: Option<i64>) -> Result<Vec<db::Row>> {
    db::query(
        "SELECT id, position, x_px, y_px, width_px, height_px FROM tile
         WHERE job = ?1 AND frame = ?2 AND kind = 'render' AND (?3 IS NULL OR position = ?3) ORDER BY position",
    )
    .bind(job)
    .bind(frame)
    .bind(position)
    .fetch_all(connection)
    .await
}
