//! Simulated farms: how well the queue's rules use workers, in virtual time. Workers follow a model, and render
//! nothing; the queue that leases tiles to them is the real one, on a database of its own.

mod farm;
mod random;
mod report;
mod scenario;
mod worker;

use std::time::Instant;

use anyhow::Context;
use clap::Args;

use report::{SimulationReport, simulate};
use scenario::Scenario;

/// File system in memory: nothing of a simulation has to survive.
const MEMORY_FOLDER: &str = "/dev/shm";

/// Arguments of `simulate`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Simulate only the scenarios whose names contain this text.
    #[arg(long, value_name = "TEXT", default_value = "")]
    scenario: String,
    /// Number of workers of the scenario `many-jobs`.
    #[arg(long, value_name = "N", default_value_t = 1_000, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    workers: u32,
    /// Seed of noise, failures and speeds.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Print the results as JSON.
    #[arg(long)]
    json: bool,
}

/// Simulates scenarios, and returns their figures as text.
pub(crate) async fn run(arguments: &Arguments) -> anyhow::Result<String> {
    let scenarios = Scenario::all(arguments.workers, arguments.seed);
    let mut reports = Vec::new();
    for scenario in scenarios.iter().filter(|scenario| scenario.name().contains(&arguments.scenario)) {
        let folder = tempfile::tempdir_in(MEMORY_FOLDER).or_else(|_| tempfile::tempdir());
        let folder = folder.context("could not create a folder for the queue: free some space there")?;
        let start = Instant::now();
        let report = simulate(folder.path(), scenario, arguments.seed).await?;
        let turn_ms = start.elapsed().as_secs_f64() * 1e3 / report.turns as f64;
        eprintln!("{}: {} syncs, {turn_ms:.2} ms each on this machine", scenario.name(), report.turns);
        reports.push(report);
    }
    anyhow::ensure!(!reports.is_empty(), "no scenario has {:?} in its name", arguments.scenario);
    if arguments.json { Ok(serde_json::to_string_pretty(&reports)?) } else { Ok(table(&reports)) }
}

fn table(reports: &[SimulationReport]) -> String {
    let heading = format!(
        "{:<30} {:>7} {:>10} {:>7} {:>6} {:>8} {:>9} {:>8} {:>9}",
        "", "workers", "makespan s", "bound s", "busy", "tail s", "most/least", "batches", "stitches"
    );
    let row = |report: &SimulationReport| {
        let unfairness = report.unfairness.map_or_else(String::new, |ratio| format!("{ratio:.2}"));
        format!(
            "{:<30} {:>7} {:>10.3} {:>7.3} {:>5.0}% {:>8.3} {:>10} {:>8} {:>9}",
            report.scenario,
            report.workers,
            report.makespan_seconds,
            report.lower_bound_seconds,
            report.utilization * 100.0,
            report.tail_seconds,
            unfairness,
            report.batches,
            report.stitches,
        )
    };
    std::iter::once(heading).chain(reports.iter().map(row)).collect::<Vec<_>>().join("\n")
}
