//! Simulated farms: how well the queue's rules use workers, in virtual time.

use std::time::Instant;

use anyhow::Context;
use server::simulation::{Scenario, SimulationReport, simulate};

use super::Arguments;
use crate::terminal::{print_line, print_note};

/// File system in memory: nothing of a simulation has to survive.
const MEMORY_FOLDER: &str = "/dev/shm";

/// Simulates scenarios and prints their figures.
pub(super) async fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let scenarios = Scenario::all(arguments.simulated_workers, arguments.seed);
    let mut reports = Vec::new();
    for scenario in scenarios.iter().filter(|scenario| scenario.name().contains(&arguments.scenario)) {
        let folder = tempfile::tempdir_in(MEMORY_FOLDER).or_else(|_| tempfile::tempdir());
        let folder = folder.context("could not create a folder for the queue: free some space there")?;
        let start = Instant::now();
        let report = simulate(folder.path(), scenario, arguments.seed).await?;
        let turn_ms = start.elapsed().as_secs_f64() * 1e3 / report.turns as f64;
        print_note(&format!("{}: {} syncs, {turn_ms:.2} ms each on this machine", scenario.name(), report.turns));
        reports.push(report);
    }
    anyhow::ensure!(!reports.is_empty(), "no scenario has {:?} in its name", arguments.scenario);
    if arguments.json { print_line(&serde_json::to_string_pretty(&reports)?) } else { table(&reports) }
}

fn table(reports: &[SimulationReport]) -> anyhow::Result<()> {
    print_line(&format!(
        "{:<30} {:>7} {:>10} {:>7} {:>6} {:>8} {:>9} {:>8} {:>9}",
        "", "workers", "makespan s", "bound s", "busy", "tail s", "most/least", "batches", "stitches"
    ))?;
    for report in reports {
        let unfairness = report.unfairness.map_or_else(String::new, |ratio| format!("{ratio:.2}"));
        print_line(&format!(
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
        ))?;
    }
    Ok(())
}
