//! Simulates a farm in virtual time: workers follow a model, the queue that leases tiles to them is the real one, on
//! a database of its own, with a clock that the simulation advances. It renders nothing and opens no address.
//!
//! Same scenario and seed, same report.

mod farm;
mod random;
mod scenario;
mod worker;

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;

use crate::db::DatabaseError;
use farm::{Ledger, SimulatedFarm};
pub use scenario::Scenario;
use worker::tile_work;

/// Error of a simulation.
#[derive(Debug, thiserror::Error)]
pub enum SimulationError {
    /// The folder has no usable database.
    #[error("could not open a queue in the folder")]
    Open(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// A transition of the queue failed.
    #[error("the queue failed")]
    Queue(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// The queue rejected a job.
    #[error("the queue rejected a job: {0}")]
    Rejected(String),
    /// The queue does not know a worker that it registered.
    #[error("the queue does not know a registered worker")]
    UnknownWorker,
    /// The queue granted tiles of a job that was not submitted.
    #[error("the queue granted tiles of an unknown job")]
    UnknownJob,
    /// Frames remain, but no worker gets them.
    #[error("{frames} frames remain, and no worker gets them")]
    Stuck {
        /// Number of frames that remain.
        frames: u64,
    },
}

impl From<DatabaseError> for SimulationError {
    fn from(error: DatabaseError) -> Self {
        Self::Queue(Box::new(error))
    }
}

/// Figures of a simulated scenario.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SimulationReport {
    /// Name of the scenario.
    pub scenario: &'static str,
    /// Number of workers.
    pub workers: usize,
    /// Number of jobs.
    pub jobs: usize,
    /// Time from the start to the last stored picture, in seconds.
    pub makespan_seconds: f64,
    /// Work divided by the speed of all workers, in seconds: no schedule takes less.
    pub lower_bound_seconds: f64,
    /// Part of all workers' time that they were busy.
    pub utilization: f64,
    /// Time from the moment when the first worker had nothing more to do to the last stored picture, in seconds.
    pub tail_seconds: f64,
    /// Time served to the submitter served most, divided by that of the one served least, while all had work;
    /// `None` with one submitter.
    pub unfairness: Option<f64>,
    /// Syncs with the queue.
    pub turns: u64,
    /// Batches of tiles or stitches.
    pub batches: usize,
    /// Batches that were whole frames.
    pub whole_frames: u64,
    /// Stitches.
    pub stitches: u64,
    /// Batches in which a tile failed.
    pub failures: u64,
    /// Batches dropped because another worker was first.
    pub dropped: u64,
}

/// Plays a scenario on a new queue in an empty folder.
pub async fn simulate(folder: &Path, scenario: &Scenario, seed: u64) -> Result<SimulationReport, SimulationError> {
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
            let tiles = job.plan.tiles();
            let frame_work = |frame| tiles.iter().map(|rect| tile_work(index, job, frame, *rect)).sum::<f64>();
            (0..job.plan.frames).map(frame_work).sum::<f64>()
        })
        .sum();
    work / farm.workers.iter().map(worker::SimulatedWorker::speed).sum::<f64>()
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
