//! Results of leases: a tile's blob, a frame's picture, or an error.
//!
//! A result counts only with a live lease. Tile, frame, job and picture change in the transaction that ends the
//! lease, so that an effect happens once or not at all. One statement handles all results of one frame in one
//! call.

use crate::db;
use std::collections::{BTreeMap, HashMap};

use proto::worker_protocol::{LeaseOutcome, LeaseReport};
use proto::{LeaseId, WorkerId};

use super::lease::{self, LeaseEnd, LiveLease};
use super::verification::{self, Candidate};
use super::{
    Connection, Result, TransitionContext, Wake, durations, fair_share, job_transitions, lease_ends, picture,
    row_count, stitch, tile_results,
};

/// Outcome of a set of results.
#[derive(Clone, Debug, Default)]
pub(super) struct DeliverResult {
    /// Leases that had ended: their results had no effect.
    pub(super) lost: Vec<LeaseId>,
    /// Number of results that differ from the first result of the same tile.
    pub(super) nondeterministic: u64,
    /// Wake signals to send.
    pub(super) ring: Wake,
    /// Blobs of frames that have been stored.
    pub(super) leftovers: Vec<String>,
    /// Number of results that should be verified, but cannot be.
    pub(super) unverified: u64,
}

/// A finished tile.
struct FinishedTile<'a> {
    held: LiveLease,
    hash: &'a str,
    size_bytes: u64,
}

/// Records a worker's results.
pub(super) async fn deliver(
    connection: &mut Connection,
    worker: WorkerId,
    reports: &[LeaseReport],
    moment: TransitionContext,
) -> Result<DeliverResult> {
    let mut delivered = DeliverResult::default();
    let results = reports
        .iter()
        .filter(|report| matches!(report.outcome, LeaseOutcome::Picture { .. } | LeaseOutcome::Blob { .. }));
    let results: Vec<LeaseId> = results.map(|report| report.lease).collect();
    if !results.is_empty() {
        fair_share::record_delivery(connection, worker, &super::json_list(results), moment).await?;
    }
    let mut pictures: BTreeMap<(&str, u64), Vec<LeaseId>> = BTreeMap::new();
    let (mut blobs, mut others) = (Vec::new(), Vec::new());
    for report in reports {
        match &report.outcome {
            LeaseOutcome::Picture { hash, size_bytes } => {
                pictures.entry((hash, *size_bytes)).or_default().push(report.lease);
            }
            LeaseOutcome::Blob { hash, size_bytes } => blobs.push((report.lease, hash.as_str(), *size_bytes)),
            LeaseOutcome::BadBlobs { .. } | LeaseOutcome::Failed { .. } | LeaseOutcome::Released => others.push(report),
        }
    }
    for ((hash, size_bytes), leases) in pictures {
        picture::accept_picture(connection, worker, &leases, hash, size_bytes, moment, &mut delivered).await?;
    }
    accept_blobs(connection, worker, &blobs, moment, &mut delivered).await?;
    for report in others {
        accept_failure(connection, worker, report, moment, &mut delivered).await?;
    }
    Ok(delivered)
}

/// Records finished tiles, frame by frame.
async fn accept_blobs(
    connection: &mut Connection,
    worker: WorkerId,
    blobs: &[(LeaseId, &str, u64)],
    moment: TransitionContext,
    delivered: &mut DeliverResult,
) -> Result<()> {
    if blobs.is_empty() {
        return Ok(());
    }
    let leases: Vec<LeaseId> = blobs.iter().map(|(lease, _, _)| *lease).collect();
    let held = lease::live_leases_among(connection, worker, &leases).await?;
    let mut live: HashMap<String, LiveLease> = held.into_iter().map(|held| (held.lease.clone(), held)).collect();
    let mut frames: BTreeMap<(i64, u32), Vec<FinishedTile<'_>>> = BTreeMap::new();
    for &(lease, hash, size_bytes) in blobs {
        match live.remove(&lease.to_string()) {
            None => {
                delivered.lost.push(lease);
                delivered.nondeterministic += count_mismatches(connection, FIRST_BLOB_SQL, lease, hash).await?;
            }
            Some(held) if held.stitch => {
                let message = "its worker sent a result that was not requested";
                delivered
                    .ring
                    .add(lease::end_without_result(connection, &held, LeaseEnd::Failed, message, moment).await?);
            }
            Some(held) => {
                frames.entry((held.job, held.frame)).or_default().push(FinishedTile { held, hash, size_bytes });
            }
        }
    }
    for ((job, frame), tiles) in frames {
        let candidates: Vec<Candidate> = tiles.iter().map(|tile| Candidate::tile(&tile.held, tile.hash)).collect();
        let (unverified, wake) = verification::choose(connection, &worker.to_string(), &candidates, moment).await?;
        delivered.unverified += unverified;
        delivered.ring.add(wake);
        delivered.ring.add(finish_tiles(connection, job, frame, &tiles, moment).await?);
    }
    Ok(())
}

/// Records a result without pixels.
async fn accept_failure(
    connection: &mut Connection,
    worker: WorkerId,
    report: &LeaseReport,
    moment: TransitionContext,
    delivered: &mut DeliverResult,
) -> Result<()> {
    let Some(held) = lease::live_leases_among(connection, worker, &[report.lease]).await?.pop() else {
        delivered.lost.push(report.lease);
        return Ok(());
    };
    let ring = match &report.outcome {
        LeaseOutcome::BadBlobs { tiles } if held.stitch => stitch::redo_tiles(connection, &held, tiles, moment).await?,
        LeaseOutcome::Failed { message } => {
            lease::end_without_result(connection, &held, LeaseEnd::Failed, message, moment).await?
        }
        LeaseOutcome::Released => {
            lease::end_without_result(connection, &held, LeaseEnd::Released, "its worker released it", moment).await?
        }
        LeaseOutcome::Blob { .. } | LeaseOutcome::BadBlobs { .. } | LeaseOutcome::Picture { .. } => {
            let message = "its worker sent a result that was not requested";
            lease::end_without_result(connection, &held, LeaseEnd::Failed, message, moment).await?
        }
    };
    delivered.ring.add(ring);
    Ok(())
}

/// Blob of a lease's tile, if the tile is done.
const FIRST_BLOB_SQL: &str = "SELECT tile.blob FROM lease JOIN tile ON tile.id = lease.tile WHERE lease.id = ?";

/// Compares late results with the first result of their tile; returns the number that differ. A late result has
/// no effect.
pub(super) async fn count_mismatches(
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
    moment: TransitionContext,
) -> Result<Wake> {
    let ids = tiles.iter().map(|tile| tile.held.tile);
    let mut ring = lease_ends::finish(connection, tiles.iter().map(|tile| &tile.held.lease), ids).await?;
    let results: Vec<_> = tiles.iter().map(|tile| (tile.held.tile, tile.hash, tile.size_bytes)).collect();
    let progress = tile_results::store_blobs(connection, &results).await?;
    let number = job_transitions::progress(connection, job, progress).await?.tiles_done;
    record_durations(connection, tiles.iter().map(|tile| &tile.held), number, moment).await?;
    let complete: bool = db::query_scalar(
        "UPDATE frame SET tiles_done = tiles_done + ? WHERE job = ? AND number = ? AND state = 'open'
         RETURNING tiles_done = tiles_total",
    )
    .bind(row_count(tiles.len()))
    .bind(job)
    .bind(frame)
    .fetch_one(&mut *connection)
    .await?;
    if complete {
        stitch::create(connection, job, frame).await?;
        ring.add(Wake::WORK);
    }
    Ok(ring)
}

/// Records the duration of tiles that were delivered together; `number` is the job's count of finished tiles.
pub(super) async fn record_durations<'a>(
    connection: &mut Connection,
    held: impl IntoIterator<Item = &'a LiveLease>,
    number: i64,
    moment: TransitionContext,
) -> Result<()> {
    let first = held.into_iter().min_by_key(|held| held.granted_ms);
    match first {
        Some(first) => {
            durations::record_duration(connection, first.job, number, moment.now_ms - first.granted_ms).await
        }
        None => Ok(()),
    }
}
