//! Measures the latency until a worker receives a submitted job, and until a cancel stops a render.

use std::time::{Duration, Instant};

use proto::job::JobState;
use proto::{Client, JobId};

use super::fake_worker::FakeWorker;
use super::{BenchFarm, Times};
use crate::program::Program;

/// Maximum number of timed cancels: each waits until its job has started.
pub(super) const MAX_CANCELS: u32 = 50;
/// How long a worker's sync waits at the server.
const WAIT: Duration = Duration::from_secs(10);
/// Maximum time that a worker's sync waits at the server.
const SETTLE_DELAY: Duration = Duration::from_millis(20);
/// Interval between two reads of a job.
const POLL_INTERVAL: Duration = Duration::from_millis(1);
/// How long a job renders before it is cancelled.
const RENDERED: Duration = Duration::from_millis(100);

fn job(width: u32, samples: u32) -> Vec<u8> {
    serde_json::json!({
        "name": "latency",
        "scene": {
            "camera": { "position": [0, 0, 3], "look_at": [0, 0, 0] },
            "objects": [{ "material": { "normals": {} }, "shape": { "mandelbulb": { "power": 8, "iterations": 8 } } }]
        },
        "image": { "width": width, "height": width, "samples": samples },
    })
    .to_string()
    .into_bytes()
}

/// Measures the time from the 201 until the waiting worker has the job.
pub(super) async fn start(program: &Program, runs: u32) -> anyhow::Result<Times> {
    let farm = BenchFarm::start(program, 0, None, None).await?;
    let worker = FakeWorker::register(farm.client.server(), None).await?;
    let mut times = Vec::new();
    for _ in 0..runs {
        let submit = async {
            tokio::time::sleep(SETTLE_DELAY).await;
            farm.client.submit(job(64, 1), true).await?;
            anyhow::Ok(Instant::now())
        };
        let claim = async {
            let run = worker.sync(Vec::new(), true, WAIT).await?;
            anyhow::Ok((run, Instant::now()))
        };
        let (accepted, (run, begun)) = tokio::try_join!(submit, claim)?;
        let Some(run) = run else { anyhow::bail!("a worker received no work within {} s", WAIT.as_secs()) };
        // The worker may have the job before its submitter receives the 201.
        times.push(begun.saturating_duration_since(accepted));
        worker.sync(worker.results(&run).await?, false, Duration::ZERO).await?;
    }
    farm.stop().await?;
    Ok(Times::new(times))
}

/// Measures the time from the response to a cancel until the rendering worker starts the next job.
pub(super) async fn cancel(program: &Program, runs: u32) -> anyhow::Result<Times> {
    let farm = BenchFarm::start(program, 1, None, None).await?;
    let mut times = Vec::new();
    for _ in 0..runs {
        let heavy = farm.client.submit(job(8192, 64), true).await?.id;
        until(&farm.client, heavy, JobState::Running).await?;
        tokio::time::sleep(RENDERED).await;
        let next = farm.client.submit(job(32, 1), true).await?.id;
        farm.client.cancel(heavy).await?;
        let cancelled = Instant::now();
        until(&farm.client, next, JobState::Running).await?;
        times.push(cancelled.elapsed());
        until(&farm.client, next, JobState::Succeeded).await?;
    }
    farm.stop().await?;
    Ok(Times::new(times))
}

/// Waits until a job is in a state, or has succeeded meanwhile.
async fn until(client: &Client, id: JobId, state: JobState) -> anyhow::Result<()> {
    loop {
        let now = client.job(id).await?.state;
        if now == state || now == JobState::Succeeded {
            return Ok(());
        }
        anyhow::ensure!(!now.is_final(), "job {id} is unexpectedly {}", now.name());
        tokio::time::sleep(POLL_INTERVAL).await;
    }
}
