//! Plays a scenario, and measures how well the queue used the workers. Same scenario and seed, same report.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;

use super::farm::{Ledger, SimulatedFarm};
use super::scenario::Scenario;
use super::worker::{SimulatedWorker, tile_work};

/// Figures of a simulated scenario.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct SimulationReport {
    /// Name of the scenario.
    pub(super) scenario: &'static str,
    /// Number of workers.
    pub(super) workers: usize,
    /// Number of jobs.
    pub(super) jobs: usize,
    /// Time from the start to the last stored picture, in seconds.
    pub(super) makespan_seconds: f64,
    /// Work divided by the speed of all workers, in seconds: no schedule takes less.
    pub(super) lower_bound_seconds: f64,
    /// Part of all workers' time that they were busy.
    pub(super) utilization: f64,
    /// Time from the moment when the first worker had nothing more to do to the last stored picture, in seconds.
    pub(super) tail_seconds: f64,
    /// Time served to the submitter served most, divided by that of the one served least, while all had work;
    /// `None` with one submitter.
    pub(super) unfairness: Option<f64>,
    /// Syncs with the queue.
    pub(super) turns: u64,
    /// Batches of tiles or stitches.
    pub(super) batches: usize,
    /// Batches that were whole frames.
    pub(super) whole_frames: u64,
    /// Stitches.
    pub(super) stitches: u64,
    /// Batches in which a tile failed.
    pub(super) failures: u64,
    /// Batches dropped because another worker was first.
    pub(super) dropped: u64,
}

/// Plays a scenario on a new queue in an empty folder.
pub(super) async fn simulate(folder: &Path, scenario: &Scenario, seed: u64) -> anyhow::Result<SimulationReport> {
    let mut farm = SimulatedFarm::new(folder, scenario, seed).await?;
    let end_us = farm.play().await?;
    let seconds = |us: u64| us as f64 / 1e6;
    let busy_us: u64 = farm.workers.iter().map(|worker| worker.busy_us.min(end_us)).sum();
    let first_dry_us = farm.workers.iter().map(|worker| worker.last_us).min().unwrap_or(0);
    let worker_count = farm.workers.len();
    Ok(SimulationReport {
        scenario: scenario.name(),
        workers: worker_count,
        jobs: farm.jobs.len(),
        makespan_seconds: seconds(end_us),
        lower_bound_seconds: lower_bound_seconds(&farm),
        utilization: seconds(busy_us) / (seconds(end_us) * worker_count as f64),
        tail_seconds: seconds(end_us.saturating_sub(first_dry_us)),
        unfairness: unfairness(&farm, &farm.ledger),
        turns: farm.ledger.turns,
        batches: farm.ledger.served.len(),
        whole_frames: farm.ledger.whole_frames,
        stitches: farm.ledger.stitches,
        failures: farm.ledger.failures,
        dropped: farm.ledger.dropped,
    })
}

fn lower_bound_seconds(farm: &SimulatedFarm) -> f64 {
    let work: f64 = farm
        .jobs
        .iter()
        .enumerate()
        .map(|(index, job)| {
            let tiles = job.tiling.tiles();
            let frame_work = |frame| tiles.iter().map(|rect| tile_work(index, job, frame, *rect)).sum::<f64>();
            (0..job.frames).map(frame_work).sum::<f64>()
        })
        .sum();
    work / farm.workers.iter().map(SimulatedWorker::speed).sum::<f64>()
}

/// Greatest divided by least served time of the submitters, up to the start of the last batch of the first one that
/// runs out of work.
fn unfairness(farm: &SimulatedFarm, ledger: &Ledger) -> Option<f64> {
    let mut last_us: BTreeMap<&str, u64> = BTreeMap::new();
    for time in &ledger.served {
        let last = last_us.entry(farm.jobs[time.job].submitter).or_default();
        *last = (*last).max(time.start_us);
    }
    let until_us = *last_us.values().min().filter(|_| last_us.len() > 1)?;
    let mut served: BTreeMap<&str, u64> = BTreeMap::new();
    for time in &ledger.served {
        *served.entry(farm.jobs[time.job].submitter).or_default() +=
            time.end_us.min(until_us).saturating_sub(time.start_us);
    }
    let (most, least) = (*served.values().max()?, *served.values().min()?);
    Some(most as f64 / least.max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    async fn report(name: &str, seed: u64) -> SimulationReport {
        let folder = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).expect("a temporary folder");
        let scenarios = Scenario::all(20, seed);
        let scenario = scenarios.iter().find(|scenario| scenario.name() == name).expect("a scenario");
        simulate(folder.path(), scenario, seed).await.expect("ends")
    }

    #[tokio::test]
    async fn equal_seeds_have_equal_reports_and_no_schedule_beats_the_bound() {
        for name in ["heavy-frame-2-gpus-8-cpus", "heavy-animation-2-gpus-8-cpus"] {
            let once = report(name, 3).await;
            assert_eq!(once, report(name, 3).await);
            assert!(once.makespan_seconds >= once.lower_bound_seconds, "{once:?}");
            assert!((0.0..=1.0).contains(&once.utilization), "{once:?}");
            assert_ne!(once, report(name, 4).await, "the noise depends on the seed");
        }
    }

    #[tokio::test]
    async fn idle_gpus_share_a_heavy_frame() {
        let one = report("heavy-frame-1-gpu", 1).await;
        assert_eq!((one.batches, one.stitches), (1, 0), "a worker alone delivers the picture itself");
        let two = report("heavy-frame-2-gpus", 1).await;
        assert!(two.makespan_seconds < 0.6 * one.makespan_seconds, "{one:?} {two:?}");
    }
}
