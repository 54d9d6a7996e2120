//! Measures jobs, tiles, and reads per second of a server.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context;
use proto::JobId;
use proto::worker_protocol::BatchWork as RunWork;
use tokio::task::JoinSet;

use super::fake_worker::FakeWorker;
use super::{BenchFarm, Times};

/// Number of timed claims.
const CLAIMS: u32 = 1000;
/// Clients that read jobs, and the interval of each: together they read more than a thousand times per
/// second, and leave the rest of the CPU to the workers.
const POLLERS: usize = 4;
const POLL_INTERVAL: Duration = Duration::from_millis(2);
/// Edge of the tiles, in pixels.
pub(super) const TILE_PX: u32 = 32;
/// Speed at which a worker gets batches of about ten tiles of these jobs.
const TEN_TILES_A_SECOND: f64 = 10.0 * (TILE_PX * TILE_PX) as f64;

/// Job of 100 tiles whose pictures differ for each seed.
fn job(seed: u32) -> Vec<u8> {
    serde_json::json!({
        "name": "bench",
        "scene": {
            "camera": { "position": [0, 0, 5], "look_at": [0, 0, 0] },
            "objects": [{ "material": { "normals": {} }, "shape": { "sphere": { "radius": 1 } } }]
        },
        "image": { "width": 10 * TILE_PX, "height": 10 * TILE_PX, "samples": 1, "seed": seed },
    })
    .to_string()
    .into_bytes()
}

/// Submits jobs from several clients; returns the rate and the duration of each submission.
pub(super) async fn submit(farm: &Arc<BenchFarm>, clients: u32, jobs: u32) -> anyhow::Result<(f64, Times)> {
    let start = Instant::now();
    let mut tasks = JoinSet::new();
    for client in 0..clients {
        let farm = Arc::clone(farm);
        tasks.spawn(async move {
            let mut times = Vec::new();
            for seed in (client..jobs).step_by(clients as usize) {
                let start = Instant::now();
                farm.client.submit(job(seed), true).await?;
                times.push(start.elapsed());
            }
            anyhow::Ok(times)
        });
    }
    let times = gather(tasks).await?;
    Ok((f64::from(jobs) / start.elapsed().as_secs_f64(), Times::new(times)))
}

pub(super) async fn gather(mut tasks: JoinSet<anyhow::Result<Vec<Duration>>>) -> anyhow::Result<Vec<Duration>> {
    let mut times = Vec::new();
    while let Some(done) = tasks.join_next().await {
        times.extend(done.context("a client panicked")??);
    }
    Ok(times)
}

/// Measures claims of one worker while all the jobs are queued.
pub(super) async fn claim(farm: &BenchFarm) -> anyhow::Result<Times> {
    let worker = FakeWorker::register(farm.client.server(), Some(TEN_TILES_A_SECOND)).await?;
    let mut times = Vec::new();
    for _ in 0..CLAIMS {
        let start = Instant::now();
        let Some(run) = worker.sync(Vec::new(), true, Duration::ZERO).await? else { break };
        times.push(start.elapsed());
        worker.sync(worker.results(&run).await?, false, Duration::ZERO).await?;
    }
    Ok(Times::new(times))
}

/// Result of the measured time.
pub(super) struct Throughput {
    pub(super) tiles_per_second: f64,
    pub(super) status_per_second: f64,
    pub(super) status: Times,
}

/// Measures how fast workers claim and complete tiles while clients read jobs.
pub(super) async fn work(farm: &Arc<BenchFarm>, workers: u32, time: Duration) -> anyhow::Result<Throughput> {
    let (tiles, over) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicBool::new(false)));
    let mut working = JoinSet::new();
    for _ in 0..workers {
        let worker = FakeWorker::register(farm.client.server(), Some(TEN_TILES_A_SECOND)).await?;
        let (tiles, over) = (Arc::clone(&tiles), Arc::clone(&over));
        working.spawn(async move { run_fake_worker(&worker, &tiles, &over).await.map(|()| Vec::new()) });
    }
    let asked: Vec<JobId> = farm.client.jobs(None, 100, None).await?.jobs.iter().map(|job| job.id).collect();
    let mut asking = JoinSet::new();
    for index in 0..POLLERS {
        let (farm, over, asked) = (Arc::clone(farm), Arc::clone(&over), asked.clone());
        asking.spawn(async move { poll_status(&farm, asked.iter().cycle().skip(index), &over).await });
    }
    let start = Instant::now();
    tiles.store(0, Ordering::Relaxed);
    tokio::time::sleep(time).await;
    over.store(true, Ordering::Relaxed);
    let (seconds, tiles) = (start.elapsed().as_secs_f64(), tiles.load(Ordering::Relaxed));
    gather(working).await?;
    let times = gather(asking).await?;
    Ok(Throughput {
        tiles_per_second: tiles as f64 / seconds,
        status_per_second: times.len() as f64 / seconds,
        status: Times::new(times),
    })
}

async fn run_fake_worker(worker: &FakeWorker, tiles: &AtomicU64, over: &AtomicBool) -> anyhow::Result<()> {
    let (mut results, mut rendered) = (Vec::new(), 0);
    while !over.load(Ordering::Relaxed) {
        let run = worker.sync(std::mem::take(&mut results), true, Duration::ZERO).await?;
        tiles.fetch_add(rendered, Ordering::Relaxed);
        let Some(run) = run else { break };
        results = worker.results(&run).await?;
        rendered = if let RunWork::Render { tiles, .. } = &run.work { tiles.len() as u64 } else { 0 };
    }
    Ok(())
}

async fn poll_status(
    farm: &BenchFarm,
    jobs: impl Iterator<Item = &JobId>,
    over: &AtomicBool,
) -> anyhow::Result<Vec<Duration>> {
    let mut times = Vec::new();
    let mut pace = tokio::time::interval(POLL_INTERVAL);
    for job in jobs.take_while(|_| !over.load(Ordering::Relaxed)) {
        pace.tick().await;
        let start = Instant::now();
        farm.client.job(*job).await?;
        times.push(start.elapsed());
    }
    Ok(times)
}
