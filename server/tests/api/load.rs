//! Many jobs at once.

use std::time::{Duration, Instant};

use futures_util::{StreamExt, stream};
use proto::job::JobState;

use super::harness::{Farm, assert_state, small_job};

/// Jobs that wait.
const JOBS: u32 = 10_000;
/// Claims that are timed.
const CLAIMS: usize = 100;

#[tokio::test(flavor = "multi_thread")]
async fn claims_stay_quick_while_ten_thousand_jobs_wait() {
    let farm = Farm::start().await;
    let start = Instant::now();
    let submitted = stream::iter(0..JOBS)
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
    for _ in 0..CLAIMS {
        let start = Instant::now();
        let run = worker.claim().await.expect("work");
        times.push(start.elapsed());
        worker.report(worker.results(&run).await).await;
    }
    times.sort();
    eprintln!(
        "{JOBS} jobs handed in by 64 clients in {submitting:.1?}; a claim, with its request: median {:.2?}, longest {:.2?}",
        times[CLAIMS / 2],
        times[CLAIMS - 1]
    );
    for id in &submitted[submitted.len() - 3..] {
        assert_state(&farm, *id, JobState::Queued).await;
    }
    assert!(times[CLAIMS / 2] < Duration::from_secs(1), "a claim must not look at every job");
    farm.stop().await;
}
