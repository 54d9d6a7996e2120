//! Fair share between submitters, with the real queue and a manual clock.

use std::time::Duration;

use proto::worker_protocol::{Batch, BatchWork, LeaseOutcome, LeaseReport};
use proto::{JobId, WorkerId};

use super::{Fixture, leases, new_job, speed, turn};
use crate::db;
use crate::queue::{NewJob, NextWork, SyncInput};
use crate::tile_plan::TilePlan;

/// Speed of a worker, at which a tile of `large` takes 1 s.
const RAYS_PER_SECOND: f64 = 1024.0;

/// A job with this many tiles, which take 1 s each.
fn job_of(submitter: &str, tiles: u32, priority: i32) -> NewJob {
    let plan =
        TilePlan { width_px: 32 * tiles, height_px: 32, samples: 1, pixel_bytes: 16, edge_px: Some(32), frames: 1 };
    NewJob { submitter: submitter.to_owned(), priority, plan, ..new_job(1) }
}

async fn submit(bench: &Fixture, new: NewJob) -> JobId {
    let id = new.id;
    bench.queue.submit(new).await.expect("accepted");
    id
}

async fn claim(bench: &Fixture, worker: WorkerId) -> Option<Batch> {
    let said = SyncInput { wants_work: true, rays_per_second: speed(RAYS_PER_SECOND), ..turn(worker) };
    match bench.turn(said).await.expect("known").next {
        NextWork::Run(run) => Some(run),
        NextWork::OpenFrame { .. } | NextWork::Nothing(_) => None,
    }
}

/// Finishes a batch and advances the clock by its duration.
async fn finish(bench: &Fixture, worker: WorkerId, run: &Batch) {
    let count = leases(run).count() as u32;
    for _ in 0..count {
        bench.hand.advance(Duration::from_millis(900));
        let holding = leases(run).collect();
        bench.turn(SyncInput { held_leases: holding, ..turn(worker) }).await;
    }
    deliver(bench, worker, run).await;
}

/// Delivers the results of a batch.
async fn deliver(bench: &Fixture, worker: WorkerId, run: &Batch) {
    let hash = blake3::hash(b"pixels").to_hex().to_string();
    let whole = !matches!(run.work, BatchWork::Render { whole_frame: false, .. });
    let outcome =
        if whole { LeaseOutcome::Picture { hash, size_bytes: 1 } } else { LeaseOutcome::Blob { hash, size_bytes: 1 } };
    let results = leases(run).map(|lease| LeaseReport { lease, outcome: outcome.clone() }).collect();
    bench.turn(SyncInput { reports: results, ..turn(worker) }).await;
}

#[tokio::test]
async fn many_tiles_delay_another_submitter_by_at_most_two_leases() {
    let bench = Fixture::new().await;
    let worker = bench.worker(None).await;
    for _ in 0..100 {
        submit(&bench, job_of("many", 1000, 0)).await;
    }
    for round in 0..20 {
        for _ in 0..round % 3 {
            let run = claim(&bench, worker).await.expect("work");
            finish(&bench, worker, &run).await;
        }
        let few = submit(&bench, job_of("few", 1, 0)).await;
        let mut leases_before = 0;
        loop {
            let run = claim(&bench, worker).await.expect("work");
            finish(&bench, worker, &run).await;
            if run.job == few {
                break;
            }
            leases_before += 1;
        }
        assert!(leases_before <= 2, "{leases_before} leases in round {round}");
    }
    bench.check().await;
}

#[tokio::test]
async fn submitters_alternate_regardless_of_their_queue_lengths() {
    let bench = Fixture::new().await;
    let worker = bench.worker(None).await;
    let mut of = std::collections::HashMap::new();
    for (submitter, jobs) in [("a", 1), ("b", 3), ("c", 9)] {
        for _ in 0..jobs {
            of.insert(submit(&bench, job_of(submitter, 100, 0)).await, submitter);
        }
    }
    let mut served = std::collections::BTreeMap::<_, i32>::new();
    for _ in 0..60 {
        let run = claim(&bench, worker).await.expect("work");
        *served.entry(of[&run.job]).or_default() += 1;
        finish(&bench, worker, &run).await;
    }
    assert!(served.values().all(|count| (18..=22).contains(count)), "{served:?}");
}

#[tokio::test]
async fn priority_precedes_fair_share() {
    let bench = Fixture::new().await;
    let worker = bench.worker(None).await;
    submit(&bench, job_of("few", 1, 0)).await;
    let urgent = submit(&bench, job_of("many", 50, 1)).await;
    for _ in 0..50 {
        let run = claim(&bench, worker).await.expect("work");
        assert_eq!(run.job, urgent);
        finish(&bench, worker, &run).await;
    }
}

#[tokio::test]
async fn a_paused_job_gains_no_credit() {
    let bench = Fixture::new().await;
    let worker = bench.worker(None).await;
    let other = submit(&bench, job_of("steady", 1000, 0)).await;
    let paused = submit(&bench, job_of("paused", 1000, 0)).await;
    bench.queue.pause(paused, true, None).await.expect("pauses");
    for _ in 0..200 {
        let run = claim(&bench, worker).await.expect("work");
        assert_eq!(run.job, other, "nothing of a paused job is leased");
        finish(&bench, worker, &run).await;
    }
    bench.queue.pause(paused, false, None).await.expect("resumes");
    let mut served = 0;
    for _ in 0..20 {
        let run = claim(&bench, worker).await.expect("work");
        served += i32::from(run.job == paused);
        finish(&bench, worker, &run).await;
    }
    assert!((9..=11).contains(&served), "{served} of 20");
    bench.check().await;
}

#[tokio::test]
async fn shares_without_work_or_credit_are_removed() {
    let bench = Fixture::new().await;
    let worker = bench.worker(None).await;
    for submitter in ["first", "second", "second"] {
        submit(&bench, job_of(submitter, 1, 0)).await;
        let run = claim(&bench, worker).await.expect("work");
        finish(&bench, worker, &run).await;
    }
    submit(&bench, job_of("waiting", 1, 0)).await;
    bench.queue.prune().await.expect("prunes");
    let left: Vec<String> = db::query_scalar("SELECT submitter FROM share ORDER BY submitter")
        .fetch_all(bench.queue.readers())
        .await
        .expect("reads");
    assert_eq!(left, ["second", "waiting"], "the first would start where the second was served last");
}

/// Total charge of a submitter, in seconds.
async fn served(bench: &Fixture, submitter: &str) -> f64 {
    let served = db::query_scalar("SELECT served_us FROM share WHERE submitter = ?").bind(submitter);
    let served_us: i64 = served.fetch_one(bench.queue.readers()).await.expect("reads");
    served_us as f64 / 1e6
}

/// Claims with the speed that a worker reports, and delivers after this time.
async fn work(bench: &Fixture, worker: WorkerId, reported: f64, took: Duration) -> usize {
    let said = SyncInput { wants_work: true, rays_per_second: speed(reported), ..turn(worker) };
    let NextWork::Run(run) = bench.turn(said).await.expect("known").next else { panic!("there is work") };
    let mut left = took;
    while left > Duration::ZERO {
        let step = left.min(Duration::from_millis(900));
        bench.hand.advance(step);
        left -= step;
        bench.turn(SyncInput { held_leases: leases(&run).collect(), ..turn(worker) }).await;
    }
    deliver(bench, worker, &run).await;
    leases(&run).count()
}

#[tokio::test]
async fn a_light_job_is_not_charged_at_the_speed_of_a_heavy_one() {
    let bench = Fixture::new().await;
    let worker = bench.worker(None).await;
    submit(&bench, job_of("heavy", 10, 0)).await;
    // The first batches are one tile each; the worker finds out that it renders 100 rays per second here.
    for _ in 0..3 {
        assert_eq!(work(&bench, worker, 100.0, Duration::from_secs(10)).await, 1);
    }
    let heavy = served(&bench, "heavy").await;
    assert!((29.0..=31.0).contains(&heavy), "{heavy} s");
    submit(&bench, job_of("light", 10, 0)).await;
    // Its first batch is sized by the speed over all scenes, the next one by its own.
    assert_eq!(work(&bench, worker, 100.0, Duration::from_millis(4)).await, 1);
    let begun = served(&bench, "light").await;
    let clock_before = 30.0;
    assert!(begun <= clock_before + 0.1, "{begun} s");
    assert_eq!(work(&bench, worker, 100.0, Duration::from_millis(36)).await, 9);
    let light = served(&bench, "light").await;
    assert!((0.03..=0.05).contains(&(light - begun)), "{begun} s, then {light} s");
    bench.check().await;
}

#[tokio::test]
async fn a_cancelled_job_is_charged_for_the_time_it_held_a_worker() {
    let bench = Fixture::new().await;
    let worker = bench.worker(None).await;
    let heavy = submit(&bench, job_of("heavy", 1, 0)).await;
    let run = claim(&bench, worker).await.expect("work");
    for _ in 0..10 {
        bench.hand.advance(Duration::from_millis(900));
        bench.turn(SyncInput { held_leases: leases(&run).collect(), ..turn(worker) }).await;
    }
    bench.queue.cancel(heavy).await.expect("cancels");
    let charged = served(&bench, "heavy").await;
    assert!((8.9..=9.1).contains(&charged), "{charged} s");
}
