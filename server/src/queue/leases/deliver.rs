//! Results of leases: a tile's blob, a frame's picture, or an error.
//!
//! A result counts only with a live lease. Tile, frame, job and picture change in the transaction that ends the
//! lease, so that an effect happens once or not at all. One statement handles all results of one frame in one
//! call.

use crate::db;
use std::collections::{BTreeMap, HashMap, HashSet};

use proto::LeaseId;
use proto::worker_protocol::{LeaseOutcome, LeaseReport};

use crate::queue::frames::picture::{self, StoredPicture};
use crate::queue::frames::stitch;
use crate::queue::jobs::{fair_share, transitions};
use crate::queue::leases::{self, ends};
use crate::queue::leases::{LeaseEnd, LiveLease};
use crate::queue::tiles::{durations, results};
use crate::queue::verification::{self, Candidate};
use crate::queue::workers::minutes::Rendered;
use crate::queue::workers::state::{UsedLease, WorkerState};
use crate::queue::{Connection, Result, TransitionContext, Wake, row_count};

/// Outcome of a set of results.
#[derive(Clone, Debug, Default)]
pub(in crate::queue) struct DeliverResult {
    /// Leases that had ended: their results had no effect.
    pub(in crate::queue) lost: Vec<LeaseId>,
    /// Leases that ended with a result.
    pub(in crate::queue) ended: HashSet<String>,
    /// Whether there are results of live leases.
    pub(in crate::queue) has_results: bool,
    /// Whether leases ended without a result, and maybe others with them.
    pub(in crate::queue) has_failures: bool,
    /// Number of results that differ from the first result of the same tile.
    pub(in crate::queue) nondeterministic: u64,
    /// Wake signals to send.
    pub(in crate::queue) woken: Wake,
    /// Blobs of frames that have been stored.
    pub(in crate::queue) orphans: Vec<String>,
    /// Number of results that should be verified, but cannot be.
    pub(in crate::queue) unverified: u64,
    /// Results that counted.
    pub(in crate::queue) rendered: Rendered,
}

/// A finished tile.
struct FinishedTile<'a> {
    used: UsedLease<'a>,
    hash: &'a str,
    size_bytes: u64,
}

/// Results of live leases, by what becomes of them.
#[derive(Default)]
struct Results<'a> {
    /// Pictures of frames, each with the leases of its stitch or of all tiles of its frame.
    pictures: Vec<(StoredPicture<'a>, Vec<UsedLease<'a>>)>,
    /// Tiles by job and frame.
    tiles: BTreeMap<(i64, u32), Vec<FinishedTile<'a>>>,
    /// Leases that end without a result, because it is not the one that was asked for.
    misfits: Vec<(UsedLease<'a>, LeaseEnd, &'static str)>,
    /// Leases of jobs that have ended.
    late: Vec<UsedLease<'a>>,
}

/// Records a worker's results.
pub(in crate::queue) async fn deliver(
    connection: &mut Connection,
    worker: &WorkerState,
    reports: &[LeaseReport],
    context: TransitionContext,
) -> Result<DeliverResult> {
    let mut delivered = DeliverResult::default();
    if reports.is_empty() {
        return Ok(delivered);
    }
    let results = sort(connection, worker, reports, context, &mut delivered).await?;
    for (picture, leases) in &results.pictures {
        picture::store(connection, picture, leases, context, &mut delivered).await?;
        delivered.rendered.add(Rendered { frames: 1, ..rendered_by(leases.iter()) });
        let candidate: Vec<Candidate> = Candidate::picture(leases, picture.hash).into_iter().collect();
        choose(connection, worker, &candidate, context, &mut delivered).await?;
    }
    for ((job, frame), tiles) in &results.tiles {
        let candidates: Vec<Candidate> = tiles.iter().map(|tile| Candidate::tile(tile.used.held, tile.hash)).collect();
        choose(connection, worker, &candidates, context, &mut delivered).await?;
        let woken = finish_tiles(connection, *job, *frame, tiles, context).await?;
        delivered.woken.add(woken);
        delivered.rendered.add(rendered_by(tiles.iter().map(|tile| &tile.used)));
    }
    let misfits = results.misfits.iter().map(|(used, _, _)| used);
    let unfinished: Vec<(&str, i64)> =
        misfits.chain(&results.late).map(|used| (used.held.live.lease.as_str(), used.used_us)).collect();
    fair_share::store_used_times(connection, &unfinished).await?;
    for (used, cause, message) in &results.misfits {
        delivered.has_failures = true;
        // The failure of a job, earlier in this loop, may have ended more of these leases.
        let Some(held) = leases::live_lease(connection, &used.held.live.lease).await? else { continue };
        delivered.woken.add(leases::end_without_result(connection, &held, *cause, message, context).await?);
    }
    for report in reports.iter().filter(|report| !is_result(report)) {
        delivered.has_failures = true;
        accept_failure(connection, worker, report, context, &mut delivered).await?;
    }
    Ok(delivered)
}

/// Tiles of leases that ended with a result; a stitch is none.
fn rendered_by<'a>(leases: impl Iterator<Item = &'a UsedLease<'a>>) -> Rendered {
    let mut rendered = Rendered::default();
    for used in leases.filter(|used| !used.held.live.stitch) {
        rendered.add(Rendered { rays: used.held.rays.unsigned_abs(), tiles: 1, frames: 0 });
    }
    rendered
}

fn is_result(report: &LeaseReport) -> bool {
    matches!(report.outcome, LeaseOutcome::Picture { .. } | LeaseOutcome::Blob { .. })
}

/// Sorts results, and compares results of ended leases with the first ones.
async fn sort<'a>(
    connection: &mut Connection,
    worker: &'a WorkerState,
    reports: &'a [LeaseReport],
    context: TransitionContext,
    delivered: &mut DeliverResult,
) -> Result<Results<'a>> {
    let names: HashSet<String> =
        reports.iter().filter(|report| is_result(report)).map(|report| report.lease.to_string()).collect();
    let held: Vec<_> = worker.leases.iter().filter(|held| names.contains(&held.live.lease)).collect();
    delivered.has_results = !held.is_empty();
    let used = fair_share::record_delivery(connection, worker, &held, context).await?;
    let (open, late): (Vec<_>, Vec<_>) = used.into_iter().partition(|used| used.held.is_open);
    let mut results = Results { late, ..Results::default() };
    let mut live: HashMap<&str, UsedLease<'a>> =
        open.into_iter().map(|used| (used.held.live.lease.as_str(), used)).collect();
    let mut pictures: BTreeMap<(&str, u64, i64, u32), Vec<UsedLease<'a>>> = BTreeMap::new();
    let mut blobs = Vec::new();
    for report in reports {
        match &report.outcome {
            LeaseOutcome::Picture { hash, size_bytes } => match live.remove(&*report.lease.to_string()) {
                Some(used) => {
                    let (job, frame) = (used.held.live.job, used.held.live.frame);
                    pictures.entry((hash, *size_bytes, job, frame)).or_default().push(used);
                }
                None => lose(connection, delivered, FIRST_PICTURE_SQL, report.lease, hash).await?,
            },
            LeaseOutcome::Blob { hash, size_bytes } => blobs.push((report.lease, hash.as_str(), *size_bytes)),
            LeaseOutcome::BadBlobs { .. } | LeaseOutcome::Failed { .. } | LeaseOutcome::Released => {}
        }
    }
    for (lease, hash, size_bytes) in blobs {
        match live.remove(&*lease.to_string()) {
            None => lose(connection, delivered, FIRST_BLOB_SQL, lease, hash).await?,
            Some(used) if used.held.live.stitch => {
                results.misfits.push((used, LeaseEnd::Failed, "its worker sent a result that was not requested"));
            }
            Some(used) => {
                let frame = (used.held.live.job, used.held.live.frame);
                results.tiles.entry(frame).or_default().push(FinishedTile { used, hash, size_bytes });
            }
        }
    }
    for ((hash, size_bytes, job, frame), leases) in pictures {
        let stitched = matches!(leases.as_slice(), [used] if used.held.live.stitch);
        let is_complete = leases[0].held.frame_tiles == Some(row_count(leases.len()));
        if stitched || is_complete {
            results.pictures.push((StoredPicture { job, frame, hash, size_bytes, stitched }, leases));
        } else {
            let message = "its worker delivered a picture without leases for all tiles of the frame";
            results.misfits.extend(leases.into_iter().map(|used| (used, LeaseEnd::Released, message)));
        }
    }
    let tiles = results.tiles.values().flatten().map(|tile| tile.used);
    let finished = results.pictures.iter().flat_map(|(_, leases)| leases.iter().copied()).chain(tiles);
    delivered.ended = finished.map(|used| used.held.live.lease.clone()).collect();
    Ok(results)
}

/// Records a result of a lease that had ended.
async fn lose(
    connection: &mut Connection,
    delivered: &mut DeliverResult,
    first: &'static str,
    lease: LeaseId,
    hash: &str,
) -> Result<()> {
    delivered.lost.push(lease);
    delivered.nondeterministic += count_mismatches(connection, first, lease, hash).await?;
    Ok(())
}

/// Chooses among results those that are verified.
async fn choose(
    connection: &mut Connection,
    worker: &WorkerState,
    candidates: &[Candidate],
    context: TransitionContext,
    delivered: &mut DeliverResult,
) -> Result<()> {
    let (unverified, wake) = verification::choose(connection, worker, candidates, context).await?;
    delivered.unverified += unverified;
    delivered.woken.add(wake);
    Ok(())
}

/// Records a result without pixels.
async fn accept_failure(
    connection: &mut Connection,
    worker: &WorkerState,
    report: &LeaseReport,
    context: TransitionContext,
    delivered: &mut DeliverResult,
) -> Result<()> {
    // Read again, because an earlier failure may have ended it.
    let held = leases::live_lease(connection, &report.lease.to_string()).await?;
    let Some(held) = held.filter(|held| held.worker == worker.id) else {
        delivered.lost.push(report.lease);
        return Ok(());
    };
    let woken = match &report.outcome {
        LeaseOutcome::BadBlobs { tiles } if held.stitch => {
            stitch::redo_tiles(connection, &held, tiles, context).await?
        }
        LeaseOutcome::Failed { message } => {
            leases::end_without_result(connection, &held, LeaseEnd::Failed, message, context).await?
        }
        LeaseOutcome::Released => {
            leases::end_without_result(connection, &held, LeaseEnd::Released, "its worker released it", context).await?
        }
        LeaseOutcome::Blob { .. } | LeaseOutcome::BadBlobs { .. } | LeaseOutcome::Picture { .. } => {
            let message = "its worker sent a result that was not requested";
            leases::end_without_result(connection, &held, LeaseEnd::Failed, message, context).await?
        }
    };
    delivered.woken.add(woken);
    Ok(())
}

/// Picture of a lease's frame, if it is stored.
const FIRST_PICTURE_SQL: &str = "SELECT frame.picture FROM lease JOIN tile ON tile.id = lease.tile
     JOIN frame ON frame.job = tile.job AND frame.number = tile.frame WHERE lease.id = ?";

/// Blob of a lease's tile, if the tile is done.
const FIRST_BLOB_SQL: &str = "SELECT tile.blob FROM lease JOIN tile ON tile.id = lease.tile WHERE lease.id = ?";

/// Compares late results with the first result of their tile; returns the number that differ. A late result has
/// no effect.
async fn count_mismatches(
    connection: &mut Connection,
    statement: &'static str,
    lease: LeaseId,
    hash: &str,
) -> Result<u64> {
    let first: Option<Option<String>> =
        db::query_scalar(statement).bind(lease.to_string()).fetch_optional(connection).await?;
    let Some(first) = first.flatten().filter(|first| first != hash) else { return Ok(0) };
    tracing::error!(
        code = "nondeterministic_tile", %lease, %first, second = hash,
        "two workers rendered one tile or frame differently; the first result is kept"
    );
    Ok(1)
}

/// Marks tiles of a frame as done; after the last one, creates the stitch.
async fn finish_tiles(
    connection: &mut Connection,
    job: i64,
    frame: u32,
    tiles: &[FinishedTile<'_>],
    context: TransitionContext,
) -> Result<Wake> {
    let leases: Vec<_> = tiles.iter().map(|tile| tile.used).collect();
    let mut woken = ends::finish(connection, &leases, context).await?;
    let results: Vec<_> = tiles.iter().map(|tile| (tile.used.held.live.tile, tile.hash, tile.size_bytes)).collect();
    let progress = results::store_blobs(connection, &results).await?;
    let number = transitions::progress(connection, job, progress).await?.tiles_done;
    record_durations(connection, &leases, number, context).await?;
    let complete: bool = db::query_scalar(
        "UPDATE frame SET tiles_done = tiles_done + ?1,
                          state = CASE WHEN tiles_done + ?1 = tiles_total THEN 'stitching' ELSE state END
         WHERE job = ?2 AND number = ?3 AND state = 'open' RETURNING tiles_done = tiles_total",
    )
    .bind(row_count(tiles.len()))
    .bind(job)
    .bind(frame)
    .fetch_one(&mut *connection)
    .await?;
    if complete {
        stitch::create(connection, job, frame).await?;
        woken.add(Wake::WORK);
    }
    Ok(woken)
}

/// Records the duration of tiles that were delivered together; `number` is the job's count of finished tiles.
pub(in crate::queue) async fn record_durations(
    connection: &mut Connection,
    leases: &[UsedLease<'_>],
    number: i64,
    context: TransitionContext,
) -> Result<()> {
    let first: Option<&LiveLease> = leases.iter().map(|used| &used.held.live).min_by_key(|held| held.granted_ms);
    match first {
        Some(first) => {
            durations::record_duration(connection, first.job, number, context.now_ms - first.granted_ms).await
        }
        None => Ok(()),
    }
}
