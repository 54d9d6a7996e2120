//! Several short frames granted in one sync: no more than a worker asks for and than a batch may take, fairly, and none
//! is lost.

use std::collections::BTreeSet;
use std::time::Duration;

use proto::worker_protocol::{Batch, LeaseOutcome, LeaseReport};
use proto::{JobId, WorkerId};

use super::{Fixture, leases, new_job, speed, turn};
use crate::queue::{NewJob, NextWork, SyncInput};

/// Speed that workers report.
const RAYS_PER_SECOND: f64 = 1e9;

/// Batches of a sync that asks for up to `max_batches`.
async fn claim(bench: &Fixture, worker: WorkerId, max_batches: u32, held: &[&Batch]) -> Vec<Batch> {
    let held_leases = held.iter().flat_map(|batch| leases(batch)).collect();
    let asks = SyncInput {
        wants_work: true,
        max_batches,
        rays_per_second: speed(RAYS_PER_SECOND),
        held_leases,
        ..turn(worker)
    };
    let synced = bench.turn(asks).await.expect("known");
    match synced.next {
        NextWork::Run(first) => std::iter::once(first).chain(synced.more).collect(),
        NextWork::OpenFrame { .. } | NextWork::Nothing(_) => Vec::new(),
    }
}

/// Delivers the pictures of frames.
async fn deliver(bench: &Fixture, worker: WorkerId, batches: &[Batch]) -> SyncInput {
    let results = batches.iter().flat_map(|batch| {
        let hash = blake3::hash(format!("{} {}", batch.job, batch.frame).as_bytes()).to_hex().to_string();
        let outcome = LeaseOutcome::Picture { hash, size_bytes: 1 };
        leases(batch).map(move |lease| LeaseReport { lease, outcome: outcome.clone() })
    });
    let input = SyncInput { reports: results.collect(), ..turn(worker) };
    bench.turn(input.clone()).await.expect("known");
    input
}

async fn submit(bench: &Fixture, submitter: &str, frames: u32) -> JobId {
    let new = NewJob { submitter: submitter.to_owned(), ..new_job(frames) };
    let id = new.id;
    bench.queue.submit(new).await.expect("accepted");
    id
}

/// Has a worker render the first frame of a job in this time, so that its speed is known.
async fn measure(bench: &Fixture, worker: WorkerId, ms: u64) {
    let first = claim(bench, worker, 8, &[]).await;
    assert_eq!(first.len(), 1, "its speed in the job is unknown");
    bench.hand.advance(Duration::from_millis(ms));
    deliver(bench, worker, &first).await;
}

#[tokio::test]
async fn a_worker_gets_as_many_short_frames_as_it_asks_for() {
    let bench = Fixture::new().await;
    let worker = bench.worker(None).await;
    submit(&bench, "a", 100).await;
    measure(&bench, worker, 20).await;
    let mut frames = BTreeSet::from([0]);
    for max_batches in [1, 2, 8] {
        let granted = claim(&bench, worker, max_batches, &[]).await;
        assert_eq!(granted.len(), max_batches as usize);
        frames.extend(granted.iter().map(|batch| batch.frame));
        deliver(&bench, worker, &granted).await;
    }
    assert_eq!(frames, (0..12).collect(), "each frame once, in order");
    bench.check().await;
}

#[tokio::test]
async fn frames_granted_together_take_at_most_a_second() {
    let bench = Fixture::new().await;
    let worker = bench.worker(None).await;
    submit(&bench, "a", 100).await;
    // 50 ms are added to a measured time.
    measure(&bench, worker, 250).await;
    assert_eq!(claim(&bench, worker, 8, &[]).await.len(), 3);
    bench.check().await;
}

#[tokio::test]
async fn the_last_frames_are_shared() {
    let bench = Fixture::new().await;
    let (worker, other) = (bench.worker(None).await, bench.worker(None).await);
    submit(&bench, "a", 9).await;
    measure(&bench, worker, 50).await;
    bench.turn(SyncInput { rays_per_second: speed(RAYS_PER_SECOND), ..turn(other) }).await.expect("known");
    let granted = claim(&bench, worker, 8, &[]).await;
    assert_eq!(granted.len(), 2, "half of its half of eight");
    bench.check().await;
}

#[tokio::test]
async fn submitters_alternate_although_a_worker_asks_for_several_batches() {
    let bench = Fixture::new().await;
    let worker = bench.worker(None).await;
    let first = submit(&bench, "a", 40).await;
    measure(&bench, worker, 10).await;
    let second = submit(&bench, "b", 40).await;
    measure(&bench, worker, 10).await;
    let mut counts = [0_u32; 2];
    for _ in 0..10 {
        let granted = claim(&bench, worker, 8, &[]).await;
        assert!(!granted.is_empty());
        for batch in &granted {
            counts[usize::from(batch.job == second)] += 1;
            assert!([first, second].contains(&batch.job));
        }
        bench.hand.advance(Duration::from_millis(10));
        deliver(&bench, worker, &granted).await;
    }
    assert!(counts[0].abs_diff(counts[1]) <= 1, "{counts:?}");
    bench.check().await;
}

#[tokio::test]
async fn frames_of_a_lost_response_are_granted_again() {
    let bench = Fixture::new().await;
    let worker = bench.worker(None).await;
    submit(&bench, "a", 20).await;
    measure(&bench, worker, 10).await;
    let unheard = claim(&bench, worker, 4, &[]).await;
    assert_eq!(unheard.len(), 4);
    bench.hand.advance(Duration::from_millis(2100));
    let mut again = claim(&bench, worker, 8, &[]).await;
    while again.len() < 4 {
        let held: Vec<&Batch> = again.iter().collect();
        let more = claim(&bench, worker, 8, &held).await;
        again.extend(more);
    }
    let frames = |batches: &[Batch]| batches.iter().map(|batch| batch.frame).take(4).collect::<Vec<_>>();
    assert_eq!(frames(&again), frames(&unheard));
    let late = deliver(&bench, worker, &unheard).await;
    assert_eq!(late.reports.len(), 4 * 12, "late results have no effect");
    bench.check().await;
    deliver(&bench, worker, &again).await;
    bench.check().await;
}
