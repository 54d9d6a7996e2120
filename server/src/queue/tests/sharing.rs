//! How workers share the tiles of a job, with the real queue and a manual clock.

use std::time::Duration;

use proto::WorkerId;
use proto::worker_protocol::{Batch, BatchWork, LeaseOutcome, LeaseReport};

use super::{Fixture, leases, new_job, speed, turn};
use crate::queue::{NewJob, NextWork, SyncInput};
use crate::tile_plan::TilePlan;

/// Speed that a GPU reports after light scenes.
const LIGHT: f64 = 2.7e9;

/// Job at 1920×1080.
fn full_hd(samples: u32, frames: u32) -> NewJob {
    let plan = TilePlan { width_px: 1920, height_px: 1080, samples, pixel_bytes: 16, edge_px: None, frames };
    NewJob { plan, ..new_job(frames) }
}

/// Workers that have reported this speed.
async fn workers(bench: &Fixture, count: usize, rays_per_second: f64) -> Vec<WorkerId> {
    let mut workers = Vec::new();
    for _ in 0..count {
        let worker = bench.worker(None).await;
        bench.turn(SyncInput { rays_per_second: speed(rays_per_second), ..turn(worker) }).await.expect("known");
        workers.push(worker);
    }
    workers
}

/// Delivers a batch, if there is one, and claims the next.
async fn next(bench: &Fixture, worker: WorkerId, done: Option<&Batch>, rays_per_second: f64) -> Option<Batch> {
    let hash = blake3::hash(b"pixels").to_hex().to_string();
    let reports = done.map(|run| {
        let outcome = match run.work {
            BatchWork::Render { whole_frame: false, .. } => LeaseOutcome::Blob { hash, size_bytes: 1 },
            BatchWork::Render { whole_frame: true, .. } | BatchWork::Stitch { .. } => {
                LeaseOutcome::Picture { hash, size_bytes: 1 }
            }
        };
        leases(run).map(|lease| LeaseReport { lease, outcome: outcome.clone() }).collect()
    });
    let said = SyncInput {
        wants_work: true,
        rays_per_second: speed(rays_per_second),
        reports: reports.unwrap_or_default(),
        ..turn(worker)
    };
    match bench.turn(said).await.expect("known").next {
        NextWork::Run(run) => Some(run),
        NextWork::OpenFrame { .. } | NextWork::Nothing(_) => None,
    }
}

fn is_whole(run: &Batch) -> bool {
    matches!(run.work, BatchWork::Render { whole_frame: true, .. })
}

#[tokio::test]
async fn idle_workers_share_a_heavy_first_frame() {
    let bench = Fixture::in_memory().await;
    let workers = workers(&bench, 4, LIGHT).await;
    bench.queue.submit(full_hd(32, 1)).await.expect("accepted");
    let mut runs = Vec::new();
    for &worker in &workers {
        runs.push(next(&bench, worker, None, LIGHT).await.expect("work"));
    }
    // Half of a quarter of the 60 tiles for the first; each leaves less.
    let lengths: Vec<usize> = runs.iter().map(|run| leases(run).count()).collect();
    assert_eq!(lengths, [7, 6, 5, 4]);
    // A tile takes 44 ms: the next batches follow the speed measured in the job, down to 50 ms of work.
    bench.hand.advance(Duration::from_millis(250));
    let mut left = 60 - lengths.iter().sum::<usize>();
    for (&worker, run) in workers.iter().zip(&mut runs) {
        *run = next(&bench, worker, Some(run), LIGHT).await.expect("work");
        assert!(leases(run).count() <= left.div_ceil(4), "{} of {left}", leases(run).count());
        left -= leases(run).count();
    }
    bench.check().await;
}

#[tokio::test]
async fn a_worker_alone_takes_the_whole_frame() {
    let bench = Fixture::in_memory().await;
    let worker = workers(&bench, 1, LIGHT).await[0];
    bench.queue.submit(full_hd(32, 1)).await.expect("accepted");
    assert!(is_whole(&next(&bench, worker, None, LIGHT).await.expect("work")));
}

#[tokio::test]
async fn workers_take_whole_frames_of_a_light_animation() {
    let bench = Fixture::in_memory().await;
    let workers = workers(&bench, 8, LIGHT).await;
    bench.queue.submit(full_hd(4, 100)).await.expect("accepted");
    let mut runs = Vec::new();
    for &worker in &workers {
        runs.push(next(&bench, worker, None, LIGHT).await.expect("work"));
    }
    for _ in 0..5 {
        bench.hand.advance(Duration::from_millis(3));
        for (&worker, run) in workers.iter().zip(&mut runs) {
            assert!(is_whole(run), "{run:?}");
            *run = next(&bench, worker, Some(run), LIGHT).await.expect("work");
        }
    }
    bench.check().await;
}

#[tokio::test]
async fn frames_of_a_heavy_animation_are_split_only_at_its_end() {
    let bench = Fixture::in_memory().await;
    let workers = workers(&bench, 2, LIGHT).await;
    bench.queue.submit(full_hd(4, 20)).await.expect("accepted");
    let mut run = next(&bench, workers[0], None, LIGHT).await.expect("work");
    for frame in 0..14 {
        assert!(is_whole(&run) && run.frame == frame, "{frame}: {run:?}");
        bench.hand.advance(Duration::from_millis(100));
        bench.turn(turn(workers[1])).await.expect("known");
        run = next(&bench, workers[0], Some(&run), LIGHT).await.expect("work");
    }
    while run.frame < 19 {
        bench.hand.advance(Duration::from_millis(100));
        bench.turn(turn(workers[1])).await.expect("known");
        run = next(&bench, workers[0], Some(&run), LIGHT).await.expect("work");
    }
    assert!(!is_whole(&run), "the other worker may take a part of the last frame");
}

#[tokio::test]
async fn a_slow_worker_gets_no_duplicate_while_a_fast_one_is_ready() {
    let bench = Fixture::in_memory().await;
    let workers = workers(&bench, 3, LIGHT).await;
    let [fast, slow, stuck] = workers[..] else { panic!("three workers") };
    let plan = TilePlan { width_px: 96, height_px: 32, samples: 4096, pixel_bytes: 16, edge_px: Some(32), frames: 1 };
    bench.queue.submit(NewJob { plan, ..new_job(1) }).await.expect("accepted");
    next(&bench, stuck, None, 1e6).await.expect("work");
    let first = next(&bench, fast, None, 1e6).await.expect("work");
    bench.hand.advance(Duration::from_millis(10));
    let second = next(&bench, fast, Some(&first), 1e6).await.expect("work");
    bench.hand.advance(Duration::from_millis(10));
    assert!(next(&bench, fast, Some(&second), 1e6).await.is_none(), "the last tile is not a straggler yet");
    bench.hand.advance(Duration::from_millis(900));
    assert!(next(&bench, slow, None, 1e6).await.is_none(), "it was not measured in the job");
    let third = next(&bench, fast, None, 1e6).await.expect("the straggler's tile");
    assert_eq!(leases(&third).count(), 1);
    bench.check().await;
}
