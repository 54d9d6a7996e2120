//! Soaks: load a temporary farm, kill it repeatedly, and check after each kill that nothing was lost, doubled or changed.
//!
//! They use the public API and the integrity check (`server::check_integrity`); they never help the farm.

mod cluster;
mod kills;
mod overload;
mod probe;
mod processes;
mod report;
mod rng;
mod server;
mod workload;

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context;
use clap::Args;

use crate::program::{Program, temporary_farm_folder};
use kills::SoakPlan;

/// Default duration of a soak in minutes.
const DEFAULT_MINUTES: u32 = 2;
/// Lines of the servers' log to show after a violation.
const LAST_LINES: usize = 40;

/// Arguments of `soak`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Kill workers and the server at random instants and at fail points.
    #[arg(long)]
    kill: bool,
    /// Submit far more jobs than the farm can take.
    #[arg(long, conflicts_with = "kill")]
    overload: bool,
    /// Duration, if no number of kills is given [default: 2].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000), conflicts_with_all = ["worker_kills", "server_kills"])]
    minutes: Option<u32>,
    /// Kill this many workers, however long that takes.
    #[arg(long, value_name = "N", requires = "kill")]
    worker_kills: Option<u32>,
    /// Kill the server this many times, however long that takes.
    #[arg(long, value_name = "N", requires = "kill")]
    server_kills: Option<u32>,
    /// Seed that chooses jobs, victims, and instants.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Number of workers of the farm.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=64))]
    workers: u32,
    /// Data folder of the farm, which is not deleted [default: a temporary one].
    #[arg(long, value_name = "FOLDER")]
    data: Option<PathBuf>,
    /// Empty database on a PostgreSQL server for the farm [default: a file in the data folder].
    #[arg(long, value_name = "postgres://USER@HOST/NAME", conflicts_with = "overload")]
    database: Option<String>,
    /// Number of servers on that database, whose workers are not theirs, but call any of them.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=16))]
    servers: u32,
    /// Empty prefix of a bucket for several servers.
    #[arg(long, value_name = "s3://BUCKET/PREFIX", requires = "database")]
    store: Option<String>,
}

impl Arguments {
    fn time(&self) -> Duration {
        Duration::from_secs(60 * u64::from(self.minutes.unwrap_or(DEFAULT_MINUTES)))
    }

    fn plan(&self) -> SoakPlan {
        let (worker_kills, server_kills, time) = match (self.worker_kills, self.server_kills) {
            (None, None) => (u32::MAX, u32::MAX, Some(self.time())),
            (workers, servers) => (workers.unwrap_or(0), servers.unwrap_or(0), None),
        };
        let (database, kill, workers, seed) = (self.database.clone(), self.kill, self.workers, self.seed);
        let (servers, store) = (self.servers, self.store.clone());
        SoakPlan { database, servers, store, kill, worker_kills, server_kills, time, workers, seed }
    }
}

/// Runs the soak, and returns its table; any violation is an error.
pub(crate) async fn run(arguments: &Arguments, program: &Program) -> anyhow::Result<String> {
    anyhow::ensure!(
        arguments.servers == 1 || (arguments.store.is_some() && arguments.kill),
        "several servers are soaked with --kill, and need --database and --store"
    );
    let temporary = temporary_farm_folder()?;
    let data = arguments.data.clone().unwrap_or_else(|| temporary.path().join("data"));
    std::fs::create_dir_all(&data).with_context(|| format!("could not create {}", data.display()))?;
    eprintln!("rendering the expected pictures");
    let (seed, plan) = (arguments.seed, arguments.plan());
    let tasks = tokio::task::spawn_blocking(move || workload::reference_jobs(seed, None))
        .await
        .context("rendering panicked")??;
    let (table, violations) = if arguments.overload {
        let report = overload::overload(program, &tasks, &data, arguments.time()).await?;
        (report.table(), report.violations)
    } else {
        let report = match plan.servers {
            1 => kills::soak(program, &plan, &tasks, &data).await?,
            _ => cluster::soak(program, &plan, &tasks, &data).await?,
        };
        (report.table(), report.violations)
    };
    if violations.is_empty() {
        return Ok(table);
    }
    let log = std::fs::read_to_string(data.join("soak.log")).unwrap_or_default();
    let lines: Vec<&str> = log.lines().collect();
    eprintln!("{table}\n{}", lines[lines.len().saturating_sub(LAST_LINES)..].join("\n"));
    anyhow::bail!("violations were found: {}", violations.join("; "))
}
