//! Stragglers: if no tile is ready, a tile that takes far longer than others of its job, or than its estimate, gets a
//! duplicate lease; its first lease stays live. The first result counts; `deliver` ends the other leases. Workers of one key
//! are one witness: two leases of other keys, which may be one's, do not keep a worker from a third.

use crate::db;
use std::collections::HashMap;

use proto::LeaseId;
use proto::bounded::RaysPerSecond;
use proto::worker_protocol::{Batch, BatchWork};

use crate::queue::jobs::fair_share;
use crate::queue::leases::batch_size::{self, WorkerShare};
use crate::queue::leases::claim::{self, ClaimFilter, ClaimRequest, NewLease};
use crate::queue::tiles::{durations, recorded};
use crate::queue::workers::speeds::{self, JobSpeed};
use crate::queue::{Connection, Result, TransitionContext, expect_rows, row_count};

/// A lease older than this many times the job's median tile duration, or its estimate, is a straggler's.
const MAX_RATIO: i64 = 3;
/// Minimum age of a straggler's lease.
const MIN_AGE_MS: i64 = 500;
/// Minimum age of a stitch that counts as a straggler: tile durations do not predict a stitch's.
const MIN_STITCH_AGE_MS: i64 = 10_000;
/// Minimum age of a straggler's lease if no speed was measured in its job, so that its estimate is a guess.
const MIN_GUESSED_AGE_MS: i64 = 5_000;
/// After this time without its result a lease is not exclusive any more, whatever the estimate and the median: both
/// depend on what workers report.
const MAX_EXCLUSIVE_MS: i64 = 120_000;
/// Number of the oldest leases that are checked.
const MAX_CANDIDATES: i64 = 256;

/// Oldest leases of other workers whose tile this worker can render, and may have as well.
const OLDEST_LEASES_SQL: &str = include_str!("stragglers.sql");

/// Tiles of a frame that a worker has leased for long, and that another may have as well.
const STRAGGLER_TILES_SQL: &str = "SELECT tile.id, position, x_px, y_px, width_px, height_px, rays, lost
     FROM lease @index(lease_live_by_worker) JOIN tile ON tile.id = lease.tile
     WHERE lease.worker = ?1 AND lease.ended IS NULL AND lease.granted_ms <= ?2
       AND tile.job = ?3 AND tile.frame = ?4 AND tile.kind = 'render'
       AND (SELECT count(*) FROM lease AS live WHERE live.tile = tile.id AND live.ended IS NULL) <=
       CASE WHEN EXISTS (
           SELECT 1 FROM lease AS live JOIN worker AS holder ON holder.id = live.worker
           WHERE live.tile = tile.id AND live.ended IS NULL
             AND (holder.pool = 1 OR holder.owner IS NOT DISTINCT FROM (SELECT owner FROM worker WHERE id = ?5)))
       THEN 1 ELSE 2 END
     ORDER BY position";

/// Result of the search for a straggler.
pub(in crate::queue) enum StragglerOutcome {
    /// A batch with duplicate leases.
    Run(Batch),
    /// No straggler now; check again in this many milliseconds.
    Nothing(Option<i64>),
}

struct OldLease {
    job: i64,
    frame: u32,
    stitch: bool,
    worker: String,
    granted_ms: i64,
}

impl OldLease {
    /// Time at which it becomes a straggler's.
    async fn overdue_ms(
        &self,
        connection: &mut Connection,
        median_ms: Option<i64>,
        context: TransitionContext,
    ) -> Result<i64> {
        let ends_ms = match median_ms {
            _ if self.stitch => {
                let longest_ms = MAX_RATIO.saturating_mul(median_ms.unwrap_or_default());
                self.granted_ms.saturating_add(longest_ms.max(MIN_STITCH_AGE_MS))
            }
            Some(median_ms) => self.granted_ms.saturating_add(MAX_RATIO.saturating_mul(median_ms).max(MIN_AGE_MS)),
            None => {
                let speed = speeds::of_holder(connection, &self.worker, self.job, context).await?;
                let rays: i64 =
                    db::query_scalar(HELD_RAYS_SQL).bind(&self.worker).bind(self.job).fetch_one(connection).await?;
                let rays_per_second = speed.map_or(fair_share::DEFAULT_RAYS_PER_SECOND, JobSpeed::get);
                let estimate_ms = (rays as f64 / rays_per_second * 1e3) as i64;
                let least_ms = match speed {
                    Some(JobSpeed::Measured(_)) => MIN_AGE_MS,
                    Some(JobSpeed::Overall(_)) | None => MIN_GUESSED_AGE_MS,
                };
                self.granted_ms.saturating_add(MAX_RATIO.saturating_mul(estimate_ms).max(least_ms))
            }
        };
        Ok(ends_ms.min(self.granted_ms.saturating_add(MAX_EXCLUSIVE_MS)))
    }
}

/// Camera rays of the tiles of a job that a worker holds.
const HELD_RAYS_SQL: &str = "SELECT CAST(coalesce(sum(tile.rays), 0) AS BIGINT) FROM lease @index(lease_live_by_worker)
     @join tile ON tile.id = lease.tile
     WHERE lease.worker = ? AND lease.ended IS NULL AND tile.job = ?";

/// Grants a duplicate lease on the oldest straggler.
pub(in crate::queue) async fn claim(
    connection: &mut Connection,
    view: &ClaimFilter,
    claimant: ClaimRequest,
    context: TransitionContext,
) -> Result<StragglerOutcome> {
    let found = view.bind(OLDEST_LEASES_SQL).bind(MAX_CANDIDATES).fetch_all(&mut *connection).await?;
    let mut medians: HashMap<i64, Option<i64>> = HashMap::new();
    let mut again_ms: Option<i64> = None;
    for row in &found {
        let old = OldLease {
            job: row.get("job")?,
            frame: row.get("frame")?,
            stitch: row.get::<String>("kind")? == "stitch",
            worker: row.get("worker")?,
            granted_ms: row.get("granted_ms")?,
        };
        let median_ms = match medians.get(&old.job) {
            Some(known) => *known,
            None => *medians.entry(old.job).or_insert(durations::median_ms(connection, old.job).await?),
        };
        let mut ends_ms = old.overdue_ms(connection, median_ms, context).await?;
        if ends_ms <= context.now_ms && speeds::is_slow(connection, &view.worker, &old.worker, old.job, context).await?
        {
            // A faster worker is soon idle; if it is not, any worker may help.
            ends_ms = old.granted_ms.saturating_add(MAX_EXCLUSIVE_MS);
        }
        let left_ms = ends_ms - context.now_ms;
        if left_ms > 0 {
            again_ms = Some(again_ms.map_or(left_ms, |again_ms| again_ms.min(left_ms)));
            continue;
        }
        let job = crate::queue::job_id(connection, old.job).await?;
        tracing::info!(%job, frame = old.frame, holder = %old.worker, "granted a duplicate lease on a straggler");
        return Ok(StragglerOutcome::Run(duplicate_leases(connection, &old, view, claimant, context).await?));
    }
    Ok(StragglerOutcome::Nothing(again_ms))
}

async fn duplicate_leases(
    connection: &mut Connection,
    old: &OldLease,
    view: &ClaimFilter,
    claimant: ClaimRequest,
    context: TransitionContext,
) -> Result<Batch> {
    let job = claim::job(connection, old.job).await?;
    if old.stitch {
        let tile = claim::stitch_tile(connection, job.number, old.frame).await?;
        let lease = LeaseId::new();
        grant(connection, &[NewLease::free(tile, lease)], view, context).await?;
        let work = claim::stitch_work(connection, job.number, old.frame, lease).await?;
        return Ok(Batch {
            job: job.id,
            frame: old.frame,
            tile_seconds: Some(job.tile_seconds),
            work,
            recording: None,
        });
    }
    let held = db::query(STRAGGLER_TILES_SQL)
        .bind(&old.worker)
        .bind(old.granted_ms)
        .bind(old.job)
        .bind(old.frame)
        .bind(&view.worker)
        .fetch_all(&mut *connection)
        .await?;
    let whole = claim::frame_load(&job);
    let length = if !job.recorded && batch_size::is_whole_frame(held.len(), whole) {
        // The holder encodes a complete picture, so the second worker must do the same: otherwise neither could
        // finish before the other.
        held.len()
    } else {
        let ready = held.iter().map(claim::read_ready).collect::<Result<Vec<_>>>()?;
        let speed = claimant.rays_per_second.map(RaysPerSecond::get).map(JobSpeed::Overall);
        batch_size::batch_len(&ready, whole, WorkerShare::alone(speed))
    };
    let (tiles, grants) = claim::new_leases(&held[..length])?;
    grant(connection, &grants, view, context).await?;
    let whole_frame = !job.recorded && batch_size::is_whole_frame(length, whole);
    let work = BatchWork::Render { whole_frame, tiles };
    let recording = recorded::recording(connection, &job, old.frame, &work).await?;
    Ok(Batch { job: job.id, frame: old.frame, tile_seconds: Some(job.tile_seconds), work, recording })
}

/// Leases tiles that are leased already, each with its next epoch.
async fn grant(
    connection: &mut Connection,
    grants: &[NewLease],
    view: &ClaimFilter,
    context: TransitionContext,
) -> Result<()> {
    let again =
        db::query("UPDATE tile SET epoch = epoch + 1 WHERE state = 'leased' AND id IN (SELECT value FROM @numbers(?))")
            .bind(crate::queue::json_numbers(grants.iter().map(|grant| grant.tile)))
            .execute(&mut *connection)
            .await?;
    expect_rows("tile: leased to leased twice", row_count(grants.len()).unsigned_abs(), again)?;
    claim::make_leases(connection, grants, &view.worker, context).await
}
