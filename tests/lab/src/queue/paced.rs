//! Measures the turns of many workers that each hold a whole frame for a while, as GPUs do, and call several servers.

use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use tokio::task::JoinSet;

use super::fake_worker::FakeWorker;
use super::{Arguments, BenchFarm, Times, heading, load, row};
use crate::program::Program;

/// Time after which a worker renews its leases: a third of a lease's.
const RENEWAL: Duration = Duration::from_secs(10);
/// Speed at which a frame is one batch.
const RAYS_PER_SECOND: f64 = 1e9;
/// Secret of these servers, which listen on loopback only.
const SECRET: &str = "the secret of the servers of a benchmark";

/// Runs the measurement, and returns it as text.
pub(super) async fn run(arguments: &Arguments, program: &Program, workers: u32) -> anyhow::Result<String> {
    let mut farms = Vec::new();
    for _ in 0..arguments.servers {
        let secret = arguments.database.as_ref().map(|_| SECRET.parse()).transpose()?;
        let farm = BenchFarm::start_among(program, 0, Some(load::TILE_PX), arguments.database.clone(), secret).await;
        farms.push(farm.context("several servers need an empty database: pass --database")?);
    }
    let frame = Duration::from_secs(arguments.frame_seconds);
    let time = Duration::from_secs(arguments.seconds).max(2 * frame);
    // Each worker takes one frame at its start, and one after each.
    let jobs = workers * (2 + (time.as_secs() / frame.as_secs()) as u32);
    let first = Arc::new(farms.remove(0));
    eprintln!("submitting {jobs} jobs of 100 tiles");
    load::submit(&first, arguments.clients, jobs).await?;
    eprintln!("{workers} workers call {} servers for {time:?}", arguments.servers);
    let addresses: Vec<String> = std::iter::once(first.client.server())
        .chain(farms.iter().map(|farm| farm.client.server()))
        .map(str::to_owned)
        .collect();
    // Their turns are spread over the time of a frame, and counted once all have begun.
    let counted_from = Instant::now() + frame;
    let mut turns = JoinSet::new();
    for number in 0..workers {
        let address = addresses[number as usize % addresses.len()].clone();
        let delay = frame.mul_f64(f64::from(number) / f64::from(workers));
        turns.spawn(async move {
            tokio::time::sleep(delay).await;
            work(&address, frame, counted_from, time).await
        });
    }
    let times = load::gather(turns).await?;
    let rate = times.len() as f64 / time.as_secs_f64();
    let times = Times::new(times);
    let result = if arguments.json {
        serde_json::to_string_pretty(&times)?
    } else {
        let turns = format!("turns of {workers} workers on {} servers", addresses.len());
        format!("{}\n{}", heading(), row(&turns, Some(rate), Some(times)))
    };
    for farm in farms {
        farm.stop().await?;
    }
    Arc::into_inner(first).context("a client still uses the farm")?.stop().await?;
    Ok(result)
}

/// Works until the time is over; returns the durations of the turns that are counted.
async fn work(address: &str, frame: Duration, counted_from: Instant, time: Duration) -> anyhow::Result<Vec<Duration>> {
    let worker = FakeWorker::register(address, Some(RAYS_PER_SECOND)).await?;
    let (mut results, mut times) = (Vec::new(), Vec::new());
    let mut count = |start: Instant| {
        if start >= counted_from {
            times.push(start.elapsed());
        }
    };
    while counted_from.elapsed() < time {
        let start = Instant::now();
        let batch = worker.sync(std::mem::take(&mut results), true, Duration::ZERO).await?;
        count(start);
        let mut left = frame;
        while left > RENEWAL {
            tokio::time::sleep(RENEWAL).await;
            left -= RENEWAL;
            let start = Instant::now();
            worker.renew(batch.as_ref()).await?;
            count(start);
        }
        tokio::time::sleep(left).await;
        if let Some(batch) = batch {
            results = worker.results(&batch).await?;
        }
    }
    worker.sync(results, false, Duration::ZERO).await?;
    Ok(times)
}
