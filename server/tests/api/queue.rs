//! The queue over HTTP: pauses, stragglers, failing workers.

use std::time::Duration;

use proto::farm::FarmView;
use proto::job::{JobState, JobView};
use proto::pool::{WorkerList, WorkerState};
use proto::worker_protocol::{BatchWork, LeaseOutcome, LeaseReport};
use reqwest::StatusCode;

use super::harness::{Farm, LEASE, Said, Worker, assert_state, in_time, job, leases, read, refused, small_job};

/// A job of three tiles, each more than a worker without a measured speed gets with another.
fn three_tiles(seed: u32) -> serde_json::Value {
    let mut three = job(3072, 1024, 2);
    three["image"]["seed"] = seed.into();
    three
}

fn failed(lease: proto::LeaseId) -> Vec<LeaseReport> {
    vec![LeaseReport { lease, outcome: LeaseOutcome::Failed { message: "no".to_owned() } }]
}

async fn metric(farm: &Farm, name: &str) -> String {
    let metrics = in_time(farm.get("/metrics").await.text()).await.expect("text");
    let line = metrics.lines().find(|line| line.starts_with(&format!("{name} "))).expect("the metric");
    line.rsplit(' ').next().expect("a value").to_owned()
}

#[tokio::test]
async fn a_paused_job_finishes_leased_tiles_and_starts_none() {
    let farm = Farm::start().await;
    let posted = farm.submit(&three_tiles(1)).await;
    let worker = farm.worker("one").await;
    let run = worker.claim().await.expect("work");
    let path = |verb: &str| format!("/v1/jobs/{}/{verb}", posted.id);
    let paused: JobView = read(farm.post(&path("pause"), "").await, StatusCode::OK).await;
    assert!(paused.paused && paused.state == JobState::Running && paused.eta_seconds.is_none(), "{paused:?}");
    assert!(worker.sync(Said { holding: leases(&run), ..Said::default() }).await.revoked_leases.is_empty());
    worker.report(worker.results(&run).await).await;
    assert_eq!(farm.job(posted.id).await.tiles.done, leases(&run).len() as u64);
    assert!(worker.claim().await.is_none());
    let again: JobView = read(farm.post(&path("pause"), "").await, StatusCode::OK).await;
    assert!(again.paused);
    let waiting = worker.next();
    let resumed = async { read::<JobView>(farm.post(&path("resume"), "").await, StatusCode::OK).await };
    let (run, resumed) = tokio::join!(waiting, resumed);
    assert!(!resumed.paused);
    worker.report(worker.results(&run).await).await;
    worker.work_off().await;
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    refused(farm.post(&path("pause"), "").await, 409, "job_finished").await;
    refused(farm.post(&path("resume"), "").await, 409, "job_finished").await;
    refused(farm.post("/v1/jobs/0/pause", "").await, 404, "unknown_job").await;
    farm.stop().await;
}

#[tokio::test]
async fn a_paused_farm_stays_paused_after_a_restart() {
    let farm = Farm::start().await;
    let posted = farm.submit(&small_job(1)).await;
    let view: FarmView = read(farm.post("/v1/farm/pause", "").await, StatusCode::OK).await;
    assert!(view.paused);
    assert!(farm.worker("one").await.claim().await.is_none());
    let farm = Farm::start_in(farm.stop().await, |_| {}).await;
    let view: FarmView = read(farm.get("/v1/farm").await, StatusCode::OK).await;
    assert!(view.paused);
    let worker = farm.worker("two").await;
    assert!(worker.claim().await.is_none());
    let view: FarmView = read(farm.post("/v1/farm/resume", "").await, StatusCode::OK).await;
    assert!(!view.paused);
    worker.work_off().await;
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    farm.stop().await;
}

/// Leaves one tile of a job to `slow`, renders the others with `quick`, and waits until the tile straggles.
async fn straggle(farm: &Farm, slow: &Worker<'_>, quick: &Worker<'_>) -> (JobView, proto::worker_protocol::Batch) {
    let posted = farm.submit(&three_tiles(1)).await;
    let held = slow.claim().await.expect("work");
    assert_eq!(leases(&held).len(), 1);
    while let Some(run) = quick.claim().await {
        let tiles = leases(&run).len() as u64;
        farm.hand.advance(Duration::from_millis(400 * tiles / posted.tiles.total));
        quick.report(quick.results(&run).await).await;
        slow.sync(Said { holding: leases(&held), ..Said::default() }).await;
    }
    // No tile is ready, and none straggles yet.
    farm.hand.advance(Duration::from_millis(800));
    (posted, held)
}

#[tokio::test]
async fn the_first_result_of_a_duplicated_straggler_counts() {
    let farm = Farm::start().await;
    let (slow, quick, third) = (farm.worker("slow").await, farm.worker("quick").await, farm.worker("third").await);
    let (posted, held) = straggle(&farm, &slow, &quick).await;
    let again = quick.claim().await.expect("the straggler");
    let index = |run: &proto::worker_protocol::Batch| match &run.work {
        BatchWork::Render { tiles, .. } => tiles.iter().map(|tile| tile.index).collect::<Vec<_>>(),
        BatchWork::Stitch { .. } => panic!("{run:?}"),
    };
    assert_eq!(index(&again), index(&held));
    assert!(third.claim().await.is_none(), "it has at most two leases");
    assert!(
        slow.sync(Said { holding: leases(&held), ..Said::default() }).await.revoked_leases.is_empty(),
        "neither lease is revoked"
    );
    assert_eq!(quick.report(quick.results(&again).await).await.revoked_leases, []);
    let received = slow.sync(Said { holding: leases(&held), ..Said::default() }).await;
    assert_eq!(received.revoked_leases, leases(&held));
    let late = slow.blob(leases(&held)[0], b"not the same").await;
    assert_eq!(slow.report(vec![late]).await.revoked_leases, leases(&held));
    assert_eq!(metric(&farm, "sdfarm_nondeterministic_tiles_total").await, "1");
    let tiles = farm.job(posted.id).await.tiles;
    assert_eq!(tiles.done, tiles.total);
    quick.work_off().await;
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    farm.stop().await;
}

#[tokio::test]
async fn releasing_one_of_two_leases_keeps_the_other() {
    let farm = Farm::start().await;
    let (slow, quick) = (farm.worker("slow").await, farm.worker("quick").await);
    let (posted, held) = straggle(&farm, &slow, &quick).await;
    let again = quick.claim().await.expect("the straggler");
    slow.report(failed(leases(&held)[0])).await;
    assert!(slow.claim().await.is_none(), "the other lease is still live");
    assert_eq!(quick.report(quick.results(&again).await).await.revoked_leases, []);
    quick.work_off().await;
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    farm.stop().await;
}

#[tokio::test]
async fn a_straggler_that_delivers_first_voids_the_duplicate_lease() {
    let farm = Farm::start().await;
    let (slow, quick) = (farm.worker("slow").await, farm.worker("quick").await);
    let (posted, held) = straggle(&farm, &slow, &quick).await;
    let again = quick.claim().await.expect("the straggler");
    assert_eq!(slow.report(slow.results(&held).await).await.revoked_leases, []);
    let received = quick.sync(Said { holding: leases(&again), ..Said::default() }).await;
    assert_eq!(received.revoked_leases, leases(&again));
    quick.work_off().await;
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    assert_eq!(metric(&farm, "sdfarm_nondeterministic_tiles_total").await, "0");
    farm.stop().await;
}

#[tokio::test]
async fn a_straggling_complete_frame_is_duplicated_as_a_whole() {
    let farm = Farm::start().await;
    let mut animation = small_job(1);
    animation["frames"] = serde_json::json!({ "count": 3 });
    let posted = farm.submit(&animation).await;
    let (slow, quick) = (farm.worker("slow").await, farm.worker("quick").await);
    let held = slow.claim().await.expect("work");
    for _ in 0..2 {
        let run = quick.claim().await.expect("work");
        farm.hand.advance(Duration::from_millis(100));
        quick.report(quick.results(&run).await).await;
    }
    farm.hand.advance(Duration::from_secs(1));
    let again = quick.claim().await.expect("the straggling frame");
    assert_eq!(again.frame, held.frame);
    assert!(matches!(again.work, BatchWork::Render { whole_frame: true, .. }), "{again:?}");
    assert_eq!(slow.report(slow.results(&held).await).await.revoked_leases, []);
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    assert_eq!(quick.report(quick.results(&again).await).await.revoked_leases, leases(&again));
    assert_eq!(metric(&farm, "sdfarm_nondeterministic_tiles_total").await, "0");
    farm.stop().await;
}

#[tokio::test]
async fn a_worker_with_three_errors_is_excluded_for_an_hour() {
    let farm = Farm::start().await;
    let posted = farm.submit(&job(4096, 4096, 4)).await;
    let (bad, good) = (farm.worker("bad").await, farm.worker("good").await);
    for _ in 0..3 {
        let run = bad.claim().await.expect("work");
        bad.report(failed(leases(&run)[0])).await;
    }
    assert!(bad.claim().await.is_none(), "tiles are left, but the worker is excluded");
    let other = farm.submit(&small_job(1)).await;
    let run = bad.claim().await.expect("another job");
    assert_eq!(run.job, other.id);
    bad.report(bad.results(&run).await).await;
    let run = good.claim().await.expect("the job continues");
    assert_eq!(run.job, posted.id);
    for _ in 0..=(3600 / (LEASE.as_secs() / 2)) {
        farm.hand.advance(LEASE / 2);
        bad.sync(Said::default()).await;
        good.sync(Said { holding: leases(&run), ..Said::default() }).await;
    }
    assert_eq!(bad.claim().await.expect("after an hour").job, posted.id);
    farm.stop().await;
}

#[tokio::test]
async fn the_last_worker_is_never_excluded() {
    let farm = Farm::start().await;
    let posted = farm.submit(&job(4096, 4096, 4)).await;
    let workers = [farm.worker("one").await, farm.worker("two").await];
    for round in 0..60 {
        farm.hand.advance(Duration::from_secs(6));
        for worker in &workers {
            if let Some(run) = worker.claim().await {
                worker.report(failed(leases(&run)[0])).await;
            }
        }
        if farm.job(posted.id).await.state == JobState::Failed {
            assert!(round > 0);
            return drop(farm.stop().await);
        }
    }
    panic!("a scene that no worker renders must fail: {:?}", farm.job(posted.id).await);
}

#[tokio::test]
async fn a_worker_excluded_from_many_jobs_is_quarantined() {
    let farm = Farm::start().await;
    let (bad, good) = (farm.worker("bad").await, farm.worker("good").await);
    farm.submit_three_large().await;
    for _ in 0..9 {
        let run = bad.claim().await.expect("work");
        bad.report(failed(leases(&run)[0])).await;
    }
    assert!(bad.claim().await.is_none());
    let list: WorkerList = read(farm.get("/v1/workers").await, StatusCode::OK).await;
    let state = |id| list.workers.iter().find(|worker| worker.id == id).expect("listed").state;
    assert_eq!((state(bad.id), state(good.id)), (WorkerState::Quarantined, WorkerState::Ready));
    assert!(good.claim().await.is_some());
    farm.submit(&small_job(1)).await;
    assert!(bad.claim().await.is_none(), "it gets no more work");
    farm.stop().await;
}

#[tokio::test]
async fn a_tile_lost_twice_is_leased_alone() {
    let farm = Farm::start().await;
    farm.submit(&job(1920, 1080, 4)).await;
    for name in ["first", "second"] {
        let mut worker = farm.worker(name).await;
        worker.rays_per_second = Some(1e9);
        assert!(leases(&worker.claim().await.expect("work")).len() > 1);
        farm.hand.advance(LEASE);
    }
    let mut third = farm.worker("third").await;
    third.rays_per_second = Some(1e9);
    assert_eq!(leases(&third.claim().await.expect("work")).len(), 1);
    farm.stop().await;
}

/// Advances the clock while a worker renews its leases, and never delivers.
async fn renew_for(farm: &Farm, worker: &Worker<'_>, held: &proto::worker_protocol::Batch, time: Duration) {
    let mut left = time;
    while left > Duration::ZERO {
        let step = left.min(LEASE / 2);
        farm.hand.advance(step);
        left -= step;
        let received = worker.sync(Said { holding: leases(held), ..Said::default() }).await;
        assert_eq!(received.revoked_leases, []);
    }
}

#[tokio::test]
async fn a_worker_that_never_delivers_loses_its_exclusivity() {
    let farm = Farm::start().await;
    let posted = farm.submit(&small_job(1)).await;
    let silent = farm.worker("silent").await;
    let held = silent.claim().await.expect("work");
    let idle = farm.worker("idle").await;
    renew_for(&farm, &silent, &held, Duration::from_secs(4)).await;
    assert!(idle.claim().await.is_none(), "it may still deliver");
    renew_for(&farm, &silent, &held, Duration::from_secs(2)).await;
    let again = idle.claim().await.expect("the tile, without any delivery of its job");
    assert_eq!(again.frame, held.frame);
    idle.report(idle.results(&again).await).await;
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    assert_eq!(silent.report(silent.results(&held).await).await.revoked_leases, leases(&held));
    farm.stop().await;
}

#[tokio::test]
async fn slow_deliveries_do_not_make_a_lease_exclusive_for_long() {
    let farm = Farm::start().await;
    let mut animation = small_job(1);
    animation["frames"] = serde_json::json!({ "count": 2 });
    let posted = farm.submit(&animation).await;
    let mut silent = farm.worker("silent").await;
    silent.rays_per_second = Some(1e-9);
    // An hour for the first frame, so that neither the median nor the speed makes it a straggler.
    let run = silent.claim().await.expect("work");
    renew_for(&farm, &silent, &run, Duration::from_hours(1)).await;
    let whole = silent.results(&run).await;
    silent.report(whole).await;
    let held = loop {
        let run = silent.claim().await.expect("the other frame");
        if run.frame == 1 {
            break run;
        }
        silent.report(silent.results(&run).await).await;
    };
    renew_for(&farm, &silent, &held, Duration::from_secs(110)).await;
    let idle = farm.worker("idle").await;
    assert!(idle.claim().await.is_none(), "it may still deliver");
    renew_for(&farm, &silent, &held, Duration::from_secs(15)).await;
    let mut run = idle.claim().await;
    while let Some(more) = run {
        idle.report(idle.results(&more).await).await;
        run = idle.claim().await;
    }
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    farm.stop().await;
}
