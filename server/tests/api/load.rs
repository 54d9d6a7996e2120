//! Load: many queued jobs at once.

use std::collections::HashSet;
use std::time::Instant;

use futures_util::future::join_all;
use futures_util::{StreamExt, stream};
use proto::job::JobState;
use serde_json::json;

use super::harness::{Farm, Worker, assert_state, small_job};
use super::metrics::Metrics;

/// Number of queued jobs, in every run of the tests and in the long ones.
const JOBS: [u32; 2] = [500, 10_000];
/// Number of claims that are timed.
const CLAIMS: usize = 100;

#[expect(clippy::disallowed_methods, reason = "the time is only printed")]
fn now() -> Instant {
    Instant::now()
}

#[tokio::test(flavor = "multi_thread")]
async fn hundreds_of_jobs_are_each_claimed_once() {
    assert_claimed_once(JOBS[0]).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "long: 10,000 jobs; 30 s"]
async fn ten_thousand_jobs_are_each_claimed_once() {
    assert_claimed_once(JOBS[1]).await;
}

/// Workers that ask at the same time are all to open the next frame: they must not all try again for each.
#[tokio::test(flavor = "multi_thread")]
async fn workers_that_ask_at_once_open_frames_in_few_transactions() {
    const WORKERS: usize = 100;
    const OPERATIONS: &str = "sdfarm_commit_operations_sum";
    let animation = {
        let mut job = small_job(0);
        job["frames"] = json!({ "count": WORKERS, "fps": 24 });
        vec![job]
    };
    for jobs in [(0..WORKERS as u32).map(small_job).collect(), animation] {
        let farm = Farm::start().await;
        for job in &jobs {
            farm.submit(job).await;
        }
        let mut workers = Vec::new();
        for number in 0..WORKERS {
            workers.push(farm.worker(&number.to_string()).await);
        }
        let before = Metrics::of(&farm).await.value(OPERATIONS);
        let batches = join_all(workers.iter().map(Worker::claim)).await;
        let operations = Metrics::of(&farm).await.value(OPERATIONS) - before;
        let frames: HashSet<_> = batches.iter().flatten().map(|batch| (batch.job, batch.frame)).collect();
        assert_eq!(frames.len(), WORKERS, "{} jobs", jobs.len());
        eprintln!("{WORKERS} claims of {} jobs took {operations} operations", jobs.len());
        assert!(operations <= 4.0 * WORKERS as f64, "{operations} operations for {WORKERS} claims");
        farm.stop().await;
    }
}

async fn assert_claimed_once(jobs: u32) {
    let farm = Farm::start().await;
    let start = now();
    let submitted = stream::iter(0..jobs)
        .map(|seed| {
            let farm = &farm;
            async move { farm.submit(&small_job(seed)).await.id }
        })
        .buffered(64)
        .collect::<Vec<_>>()
        .await;
    let submitting = start.elapsed();
    let worker = farm.worker("one").await;
    let mut times = Vec::new();
    let mut claimed = HashSet::new();
    for _ in 0..CLAIMS {
        let start = now();
        let run = worker.claim().await.expect("work");
        times.push(start.elapsed());
        assert!(claimed.insert(run.job), "{} is claimed twice", run.job);
        worker.report(worker.results(&run).await).await;
        assert_state(&farm, run.job, JobState::Succeeded).await;
    }
    times.sort();
    eprintln!(
        "{jobs} jobs submitted by 64 clients in {submitting:.1?}; a claim, with its request: median {:.2?}, longest {:.2?}",
        times[CLAIMS / 2],
        times[CLAIMS - 1]
    );
    let waiting = submitted.iter().filter(|id| !claimed.contains(id)).count();
    assert_eq!(waiting, jobs as usize - CLAIMS);
    assert_state(&farm, submitted[jobs as usize - 1], JobState::Queued).await;
    farm.stop().await;
}
