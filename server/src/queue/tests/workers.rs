//! Failing, leaving and unequal workers, late pictures, and pictures from the cache, with the real queue and a manual
//! clock.

use std::time::Duration;

use proto::WorkerId;
use proto::worker_protocol::{Batch, LeaseOutcome, LeaseReport};

use super::{Fixture, execute, leases, new_job, speed, turn};
use crate::db;
use crate::queue::{FrameOpening, MAX_WORKERS_OF_KEY, NewJob, NextWork, OpenOutcome, SyncInput, SyncOutcome};
use crate::tile_plan::TilePlan;

/// Longer than any back-off.
const BACK_OFF: Duration = Duration::from_mins(1);

pub(super) async fn claim(bench: &Fixture, worker: WorkerId) -> Option<Batch> {
    claim_at(bench, worker, None).await
}

async fn claim_at(bench: &Fixture, worker: WorkerId, rays_per_second: Option<f64>) -> Option<Batch> {
    let rays_per_second = rays_per_second.and_then(speed);
    let said = SyncInput { wants_work: true, rays_per_second, ..turn(worker) };
    match bench.turn(said).await.expect("known").next {
        NextWork::Run(run) => Some(run),
        NextWork::OpenFrame { .. } | NextWork::Nothing(_) => None,
    }
}

/// Reports these outcomes, in the order of a batch's leases; leases beyond them are released.
pub(super) async fn report(bench: &Fixture, worker: WorkerId, run: &Batch, outcomes: Vec<LeaseOutcome>) -> SyncOutcome {
    let outcomes = outcomes.into_iter().chain(std::iter::repeat(LeaseOutcome::Released));
    let reports = leases(run).zip(outcomes).map(|(lease, outcome)| LeaseReport { lease, outcome }).collect();
    bench.turn(SyncInput { reports, ..turn(worker) }).await.expect("known")
}

fn failed() -> LeaseOutcome {
    LeaseOutcome::Failed { message: "out of luck".to_owned() }
}

/// The outcomes of a whole frame whose picture has these bytes.
fn picture(run: &Batch, bytes: &[u8]) -> Vec<LeaseOutcome> {
    let hash = blake3::hash(bytes).to_hex().to_string();
    leases(run).map(|_| LeaseOutcome::Picture { hash: hash.clone(), size_bytes: 1 }).collect()
}

/// Fails three tiles of the job that is next for a worker.
async fn fail_thrice(bench: &Fixture, worker: WorkerId) {
    let run = claim(bench, worker).await.expect("work");
    report(bench, worker, &run, vec![failed(), failed(), failed()]).await;
    bench.hand.advance(BACK_OFF);
}

pub(super) async fn state(bench: &Fixture, worker: WorkerId) -> String {
    let state = db::query_scalar("SELECT state FROM worker WHERE id = ?").bind(worker.to_string());
    state.fetch_one(bench.queue.readers()).await.expect("reads")
}

#[tokio::test]
async fn a_key_has_a_limited_number_of_workers() {
    let bench = Fixture::new().await;
    bench.worker(None).await;
    execute(
        &bench,
        "WITH RECURSIVE counted (n) AS (SELECT 2 UNION ALL SELECT n + 1 FROM counted WHERE n < 16383)
         INSERT INTO worker (id, name, device, state, pool, process, generation, seen_ms, registered_ms, owner)
         SELECT 'worker ' || n, name, device, state, pool, process, generation, seen_ms, registered_ms, owner
         FROM worker, counted",
    )
    .await;
    assert_eq!(MAX_WORKERS_OF_KEY, 16384);
    assert!(bench.try_register("local", None, None).await.is_some(), "the last one");
    assert!(bench.try_register("local", None, None).await.is_none());
    assert!(bench.try_register("another", None, None).await.is_some());
    assert!(bench.try_register("local", None, Some(1)).await.is_some(), "the server limits its pool itself");
    execute(&bench, "UPDATE worker SET state = 'gone' WHERE id = 'worker 2'").await;
    assert!(bench.try_register("local", None, None).await.is_some());
}

#[tokio::test]
async fn a_failing_worker_is_excluded_only_if_another_can_render_the_scene() {
    let bench = Fixture::in_memory().await;
    let failing = bench.register(None, Some(1)).await;
    bench.register(Some(4), Some(2)).await;
    let job = bench.submit(1, 5).await;
    fail_thrice(&bench, failing).await;
    let run = claim(&bench, failing).await.expect("the other worker's scenes have at most 4 nodes");
    assert_eq!(run.job, job);
    report(&bench, failing, &run, Vec::new()).await;
    let able = bench.register(Some(5), Some(3)).await;
    assert!(claim(&bench, failing).await.is_none(), "another worker can render it");
    assert!(claim(&bench, able).await.is_some());
}

#[tokio::test]
async fn the_last_ready_worker_is_never_quarantined() {
    let bench = Fixture::in_memory().await;
    let failing = bench.register(None, Some(1)).await;
    for priority in 0..4 {
        // It precedes the jobs in which the worker failed before.
        bench.queue.submit(NewJob { priority, ..new_job(1) }).await.expect("accepted");
        fail_thrice(&bench, failing).await;
    }
    assert_eq!(state(&bench, failing).await, "ready");
}

#[tokio::test]
async fn a_worker_excluded_from_three_jobs_is_quarantined() {
    let bench = Fixture::in_memory().await;
    let failing = bench.register(None, Some(1)).await;
    let other = bench.register(None, Some(2)).await;
    for number in 1..=3 {
        assert_eq!(state(&bench, failing).await, "ready", "before job {number}");
        bench.submit(1, 1).await;
        fail_thrice(&bench, failing).await;
    }
    assert_eq!(state(&bench, failing).await, "quarantined");
    assert!(claim(&bench, failing).await.is_none() && claim(&bench, other).await.is_some());
}

#[tokio::test]
async fn a_worker_that_shuts_down_releases_its_leases_at_once() {
    let bench = Fixture::in_memory().await;
    let (leaving, other) = (bench.worker(None).await, bench.worker(None).await);
    bench.submit(1, 1).await;
    let run = claim(&bench, leaving).await.expect("work");
    assert!(claim(&bench, other).await.is_none());
    let said = SyncInput { shutting_down: true, wants_work: true, ..turn(leaving) };
    let synced = bench.turn(said).await.expect("known");
    assert!(synced.drain && matches!(synced.next, NextWork::Nothing(_)));
    assert_eq!((state(&bench, leaving).await.as_str(), state(&bench, other).await.as_str()), ("gone", "ready"));
    let again = claim(&bench, other).await.expect("the released tiles");
    assert_eq!(leases(&again).count(), leases(&run).count());
    assert!(bench.turn(turn(leaving)).await.is_none(), "a worker that is gone is unknown");
    bench.check().await;
}

#[tokio::test]
async fn a_batch_takes_no_longer_than_the_fastest_other_worker_needs_for_all() {
    let bench = Fixture::in_memory().await;
    let (slow, fast) = (bench.worker(None).await, bench.worker(None).await);
    bench.turn(SyncInput { rays_per_second: speed(1e6), ..turn(fast) }).await.expect("known");
    // 100 tiles of 1024 rays: the fast worker needs 0.1 s for all, in which the slow one renders one.
    let plan = TilePlan { width_px: 3200, height_px: 32, samples: 1, pixel_bytes: 16, edge_px: Some(32), frames: 1 };
    bench.queue.submit(NewJob { plan, ..new_job(1) }).await.expect("accepted");
    let run = claim_at(&bench, slow, Some(10_240.0)).await.expect("work");
    assert_eq!(leases(&run).count(), 1);
}

#[tokio::test]
async fn a_late_picture_that_differs_from_the_first_is_counted() {
    let bench = Fixture::in_memory().await;
    let (first, second) = (bench.worker(None).await, bench.worker(None).await);
    for (late, different) in [(&b"b"[..], 0), (b"c", 1)] {
        bench.submit(2, 1).await;
        let run = claim(&bench, first).await.expect("work");
        report(&bench, first, &run, picture(&run, b"a")).await;
        let held = claim(&bench, first).await.expect("work");
        bench.hand.advance(Duration::from_millis(900));
        bench.turn(SyncInput { held_leases: leases(&held).collect(), ..turn(first) }).await.expect("known");
        let duplicate = claim(&bench, second).await.expect("a straggler's tiles");
        report(&bench, second, &duplicate, picture(&duplicate, b"b")).await;
        let reported = report(&bench, first, &held, picture(&held, late)).await;
        let count = leases(&held).count() as u64;
        assert_eq!((reported.fenced, reported.nondeterministic), (count, different * count));
    }
    bench.check().await;
}

/// Opens frame 0 of the next job under the same cache key for all jobs.
async fn claim_under_one_key(bench: &Fixture, worker: WorkerId) -> Batch {
    let said = SyncInput { wants_work: true, ..turn(worker) };
    let asked = bench.queue.turn(said.clone()).await.expect("a sync").expect("known");
    let NextWork::OpenFrame { job, frame, plan } = asked.next else { panic!("a frame must be opened") };
    let opening = opening(job, frame, plan);
    let synced = bench.queue.turn(SyncInput { opening: Some(opening), ..said }).await.expect("a sync").expect("known");
    let NextWork::Run(run) = synced.next else { panic!("there is work") };
    run
}

fn opening(job: i64, frame: u32, plan: TilePlan) -> FrameOpening {
    FrameOpening { job, frame, picture_key: "key".to_owned(), scene: None, tiles: plan.tiles(), samples: plan.samples }
}

#[tokio::test]
async fn two_different_pictures_of_one_key_are_counted_and_the_last_that_bypassed_the_cache_is_reused() {
    let bench = Fixture::in_memory().await;
    let worker = bench.worker(None).await;
    let plan = TilePlan { samples: 4, ..new_job(1).plan };
    for (bytes, different) in [(&b"first"[..], 0), (b"first", 0), (b"second", 1)] {
        bench.queue.submit(NewJob { plan, ..new_job(1) }).await.expect("accepted");
        let run = claim_under_one_key(&bench, worker).await;
        let reported = report(&bench, worker, &run, picture(&run, bytes)).await;
        assert_eq!(reported.nondeterministic, different);
    }
    let new = NewJob { plan, no_cache: false, ..new_job(1) };
    let number = bench.queue.submit(new).await.expect("accepted");
    let reused = bench.queue.reuse(opening(number, 0, plan)).await.expect("opens");
    assert_eq!(reused, OpenOutcome::Stored);
    let row = db::query(
        "SELECT job.state, rays_done, rays_total, picture FROM job JOIN frame ON frame.job = job.number
         WHERE job.number = ?",
    );
    let row = row.bind(number).fetch_one(bench.queue.readers()).await.expect("reads");
    assert_eq!(row.get::<String>("state").expect("a text"), "succeeded");
    let rays = |column| row.get::<i64>(column).expect("a number");
    assert_eq!(rays("rays_done"), rays("rays_total"), "the rays of a reused picture count");
    assert_eq!(row.get::<String>("picture").expect("a text"), blake3::hash(b"second").to_hex().to_string());
}
