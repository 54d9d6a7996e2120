//! Measures a whole farm: the time from POST to the stored picture, and frames per second of an animation.

use std::time::{Duration, Instant};

use anyhow::Context;
use proto::job::JobState;
use proto::{Client, JobId};
use serde::Serialize;
use server::{Config, Server};
use tokio_util::sync::CancellationToken;

use crate::commands::serve::current_executable;
use crate::commands::temporary_farm_folder;

/// Interval between two reads of a measured job.
const POLL_INTERVAL: Duration = Duration::from_millis(1);
/// Warm-up jobs that are not measured.
const WARM_UP: usize = 3;
/// Time limit for workers to start: a GPU's self-test is compiled at the first start.
const START_TIMEOUT: Duration = Duration::from_mins(1);

/// Measured times of a farm.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct FarmReport {
    /// The job's name.
    pub(crate) job: String,
    /// Devices of its workers.
    pub(crate) devices: Vec<String>,
    /// Jobs measured one after another.
    pub(crate) jobs: usize,
    /// Time from POST to `succeeded`, in milliseconds: minimum, median, maximum.
    pub(crate) latency_ms: [f64; 3],
    /// Frames of the animation.
    pub(crate) frames: u32,
    /// Stored frames of the animation per second.
    pub(crate) frames_per_second: f64,
}

/// Starts a farm in a new folder, and submits a job many times, then once with many frames.
pub(crate) async fn measure(text: &[u8], devices: Vec<String>, jobs: usize, frames: u32) -> anyhow::Result<FarmReport> {
    let data = temporary_farm_folder()?;
    let config = Config {
        listen: ([127, 0, 0, 1], 0).into(),
        data: data.path().to_owned(),
        worker_program: current_executable()?,
        job_reader: Some(current_executable()?),
        devices,
        ..Config::default()
    };
    let server = Server::start(config).await?;
    let client = Client::new(&format!("http://{}", server.address()))?;
    let shutdown = CancellationToken::new();
    let serving = tokio::spawn(server.run(shutdown.clone()));
    let measured = farm(&client, text, jobs.max(1), frames).await;
    shutdown.cancel();
    serving.await.context("the farm did not shut down gracefully")??;
    measured
}

async fn farm(client: &Client, text: &[u8], jobs: usize, frames: u32) -> anyhow::Result<FarmReport> {
    let start = Instant::now();
    loop {
        let pool = client.pool().await?;
        if pool.ready > 0 && pool.ready >= pool.workers {
            break;
        }
        anyhow::ensure!(
            start.elapsed() < START_TIMEOUT,
            "not every worker was ready after {} s",
            START_TIMEOUT.as_secs()
        );
        tokio::time::sleep(POLL_INTERVAL).await;
    }
    let mut devices: Vec<String> = client.workers().await?.workers.into_iter().map(|worker| worker.device).collect();
    devices.sort();
    let mut latencies = Vec::with_capacity(jobs);
    for round in 0..jobs + WARM_UP {
        let start = Instant::now();
        let id = client.submit(text.to_vec(), true).await?.id;
        until_stored(client, id).await?;
        if round >= WARM_UP {
            latencies.push(start.elapsed().as_secs_f64() * 1e3);
        }
    }
    latencies.sort_by(f64::total_cmp);
    let mut animation: serde_json::Value = serde_json::from_slice(text).context("the job is not JSON")?;
    animation["frames"] = serde_json::json!({ "count": frames });
    let start = Instant::now();
    let job = client.submit(animation.to_string().into_bytes(), true).await?;
    until_stored(client, job.id).await?;
    let seconds = start.elapsed().as_secs_f64();
    Ok(FarmReport {
        job: job.name,
        devices,
        jobs,
        latency_ms: [latencies[0], latencies[latencies.len() / 2], latencies[latencies.len() - 1]],
        frames,
        frames_per_second: f64::from(frames) / seconds,
    })
}

async fn until_stored(client: &Client, id: JobId) -> anyhow::Result<()> {
    loop {
        let job = client.job(id).await?;
        match job.state {
            JobState::Succeeded => return Ok(()),
            JobState::Failed | JobState::Cancelled => {
                anyhow::bail!("job {id} did not succeed: {}", job.errors.join("; "))
            }
            JobState::Queued | JobState::Running => tokio::time::sleep(POLL_INTERVAL).await,
        }
    }
}
