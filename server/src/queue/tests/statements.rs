//! The number of statements of typical turns and submissions stays low: each is a round trip to PostgreSQL, and two
//! switches between threads with a file. The beginning of a transaction and its end count too.

use std::time::Duration;

use proto::worker_protocol::{Batch, BatchWork, LeaseOutcome, LeaseReport};
use proto::{LeaseId, WorkerId};

use super::{Fixture, leases, new_job, speed, turn};
use crate::db::sent;
use crate::queue::{BacklogLimits, NewJob, NextWork, SubmitOptions, SyncInput, VerificationPolicy};
use crate::tile_plan::TilePlan;

/// Asserts how many statements were sent since the last call.
fn assert_sent(action: &str, most: usize) {
    let sent = sent::take();
    let texts: Vec<String> = sent.iter().map(|text| text.split_whitespace().collect::<Vec<_>>().join(" ")).collect();
    assert!(texts.len() <= most, "{action} takes {} statements, not {most}:\n{}", texts.len(), texts.join("\n"));
}

async fn sync(bench: &Fixture, input: SyncInput) -> Option<Batch> {
    match bench.turn(input).await.expect("known").next {
        NextWork::Run(batch) => Some(batch),
        NextWork::Nothing(_) => None,
        NextWork::OpenFrame { .. } => panic!("a frame is left to open"),
    }
}

fn results(batch: &Batch, outcome: impl Fn(LeaseId) -> LeaseOutcome) -> Vec<LeaseReport> {
    leases(batch).map(|lease| LeaseReport { lease, outcome: outcome(lease) }).collect()
}

fn blobs(batch: &Batch) -> Vec<LeaseReport> {
    assert!(matches!(batch.work, BatchWork::Render { whole_frame: false, .. }), "{batch:?}");
    let hash = |lease: LeaseId| blake3::hash(lease.to_string().as_bytes()).to_hex().to_string();
    results(batch, |lease| LeaseOutcome::Blob { hash: hash(lease), size_bytes: 1 })
}

fn picture(batch: &Batch) -> Vec<LeaseReport> {
    let hash = blake3::hash(format!("{} {}", batch.job, batch.frame).as_bytes()).to_hex().to_string();
    results(batch, |_| LeaseOutcome::Picture { hash: hash.clone(), size_bytes: 1 })
}

/// Worker with a speed at which it gets about ten of a hundred tiles.
fn asks(worker: WorkerId) -> SyncInput {
    SyncInput { wants_work: true, rays_per_second: speed(80.0 * 1024.0), ..turn(worker) }
}

#[tokio::test]
async fn a_submission_has_few_statements() {
    let bench = Fixture::new().await;
    let limits = BacklogLimits { farm_jobs: Some(100), jobs: Some(100), rays: Some(1 << 40), leaves_half: true };
    sent::take();
    let options = SubmitOptions { limits, ..SubmitOptions::default() };
    bench.queue.submit_with(new_job(1), options).await.expect("accepted");
    assert_sent("a submission with limits", 8);
}

#[tokio::test]
async fn a_turn_with_tiles_has_few_statements() {
    let bench = Fixture::new().await;
    let (worker, _other) = (bench.worker(None).await, bench.worker(None).await);
    let plan = TilePlan { width_px: 320, height_px: 320, samples: 1, pixel_bytes: 16, edge_px: Some(32), frames: 1 };
    bench.queue.submit(NewJob { plan, ..new_job(1) }).await.expect("accepted");
    sent::take();
    let first = sync(&bench, asks(worker)).await.expect("work");
    assert_sent("a claim that opens a frame and starts its job", 24);
    assert_eq!(leases(&first).count(), 10);
    bench.hand.advance(Duration::from_millis(100));
    sync(&bench, SyncInput { held_leases: leases(&first).collect(), ..turn(worker) }).await;
    assert_sent("a renewal", 5);
    let second = sync(&bench, SyncInput { reports: blobs(&first), ..asks(worker) }).await.expect("work");
    assert_sent("a delivery of ten tiles and a claim", 20);
    sync(&bench, SyncInput { reports: blobs(&second), ..turn(worker) }).await;
    assert_sent("a delivery of tiles", 12);
    sync(&bench, asks(worker)).await.expect("work");
    assert_sent("a claim of tiles", 12);
}

#[tokio::test]
async fn a_turn_with_pictures_has_few_statements() {
    let bench = Fixture::new().await;
    let worker = bench.worker(None).await;
    bench.submit(3, 1).await;
    let asks = SyncInput { rays_per_second: speed(1e9), ..asks(worker) };
    let first = sync(&bench, asks.clone()).await.expect("work");
    bench.hand.advance(Duration::from_millis(100));
    sent::take();
    sync(&bench, SyncInput { reports: picture(&first), ..turn(worker) }).await;
    assert_sent("a delivery of a whole frame", 13);
    let second = sync(&bench, asks.clone()).await.expect("work");
    assert_sent("a claim that opens a frame", 20);
    sync(&bench, SyncInput { reports: picture(&second), ..asks }).await.expect("work");
    assert_sent("a delivery of a whole frame and a claim that opens the next", 30);
}

#[tokio::test]
async fn an_idle_turn_has_few_statements() {
    let bench = Fixture::new().await;
    let worker = bench.worker(None).await;
    sent::take();
    assert!(sync(&bench, asks(worker)).await.is_none());
    assert_sent("a claim without work", 7);
}

#[tokio::test]
async fn a_verification_has_few_statements() {
    let mut bench = Fixture::new().await;
    bench.queue = bench.queue.with_verification(VerificationPolicy { share: 1.0, new_worker_ms: 0 });
    let (worker, other) = (bench.worker(None).await, bench.worker(None).await);
    let plan = TilePlan { width_px: 320, height_px: 320, samples: 1, pixel_bytes: 16, edge_px: Some(32), frames: 1 };
    bench.queue.submit(NewJob { plan, ..new_job(1) }).await.expect("accepted");
    let first = sync(&bench, asks(worker)).await.expect("work");
    let reports = blobs(&first);
    sent::take();
    sync(&bench, SyncInput { reports: reports.clone(), ..turn(worker) }).await;
    assert_sent("a delivery of tiles that are verified", 14);
    let second = sync(&bench, asks(other)).await.expect("work");
    assert_sent("a claim of tiles to verify", 9);
    assert_eq!(leases(&second).count(), 8, "as many as are verified together");
    let hash = |index: usize| reports[index].outcome.clone();
    let reports = leases(&second).enumerate().map(|(index, lease)| LeaseReport { lease, outcome: hash(index) });
    let said = SyncInput { reports: reports.collect(), ..turn(other) };
    let synced = bench.turn(said).await.expect("known");
    assert_eq!((synced.verification.agreed, synced.verification.differed), (8, 0));
    assert_sent("a delivery of verified tiles", 9);
    let left = sync(&bench, asks(other)).await.expect("work");
    assert_eq!(leases(&left).count(), 2, "the others");
}
