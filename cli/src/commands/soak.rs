//! `sdfarm soak`: loads a temporary farm, kills it repeatedly, and checks after each kill that nothing was
//! lost, doubled or changed. A test for the user's own machine.
//!
//! It uses the public API and the integrity check (`server::audit`); it never helps the farm.

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

use crate::commands::temporary_farm_folder;
use crate::error::UsageError;
use crate::signals::Signals;
use crate::terminal::{print_line, print_note};
use kills::SoakPlan;

/// Default duration of a soak in minutes.
const DEFAULT_MINUTES: u32 = 2;
/// Lines of the servers' log to show after a violation.
const LAST_LINES: usize = 40;

/// Arguments of `soak`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Kill workers and the server at random instants and at fail points.
    #[arg(long, env = "SDFARM_KILL", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    kill: bool,
    /// Submit far more jobs than the farm can take.
    #[arg(long, env = "SDFARM_OVERLOAD", conflicts_with = "kill", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    overload: bool,
    /// Duration, if no number of kills is given [default: 2].
    #[arg(long, value_name = "N", env = "SDFARM_MINUTES", value_parser = clap::value_parser!(u32).range(1..=10_000), conflicts_with_all = ["worker_kills", "server_kills"])]
    minutes: Option<u32>,
    /// Kill this many workers, however long that takes.
    #[arg(long, value_name = "N", env = "SDFARM_WORKER_KILLS", requires = "kill")]
    worker_kills: Option<u32>,
    /// Kill the server this many times, however long that takes.
    #[arg(long, value_name = "N", env = "SDFARM_SERVER_KILLS", requires = "kill")]
    server_kills: Option<u32>,
    /// Seed that chooses jobs, victims, and instants.
    #[arg(long, value_name = "N", env = "SDFARM_SEED", default_value_t = 1)]
    seed: u64,
    /// Number of workers of the farm.
    #[arg(long, value_name = "N", env = "SDFARM_WORKERS", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=64))]
    workers: u32,
    /// Data folder of the farm, which is not deleted [default: a temporary one].
    #[arg(long, value_name = "FOLDER", env = "SDFARM_DATA")]
    data: Option<PathBuf>,
    /// Empty database on a PostgreSQL server for the farm [default: a file in the data folder].
    #[arg(
        long,
        value_name = "postgres://USER@HOST/NAME",
        env = "SDFARM_DATABASE",
        hide_env_values = true,
        conflicts_with = "overload"
    )]
    database: Option<String>,
    /// Number of servers on that database, whose workers are not theirs, but call any of them.
    #[arg(long, value_name = "N", env = "SDFARM_SERVERS", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=16))]
    servers: u32,
    /// Empty prefix of a bucket for several servers.
    #[arg(long, value_name = "s3://BUCKET/PREFIX", env = "SDFARM_STORE", requires = "database")]
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

/// Runs the soak; any violation is an error.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    if arguments.servers > 1 && (arguments.store.is_none() || !arguments.kill) {
        let message = "several servers are soaked with --kill, and need --database and --store";
        return Err(UsageError(message.to_owned()).into());
    }
    let mut signals = Signals::install()?;
    let temporary = temporary_farm_folder()?;
    let data = arguments.data.clone().unwrap_or_else(|| temporary.path().join("data"));
    std::fs::create_dir_all(&data).with_context(|| format!("could not create {}", data.display()))?;
    print_note("rendering the expected pictures");
    let (seed, plan) = (arguments.seed, arguments.plan());
    let tasks = tokio::task::spawn_blocking(move || workload::reference_jobs(seed, None))
        .await
        .context("rendering panicked")??;
    let soaked = async {
        if arguments.overload {
            let report = overload::overload(&tasks, &data, arguments.time()).await?;
            return anyhow::Ok((report.table(), report.violations));
        }
        let tally = match plan.servers {
            1 => kills::soak(&plan, &tasks, &data).await?,
            _ => cluster::soak(&plan, &tasks, &data).await?,
        };
        Ok((tally.table(), tally.violations))
    };
    let (table, violations) = tokio::select! {
        soaked = soaked => soaked?,
        () = signals.next() => anyhow::bail!("interrupted"),
    };
    print_line(&table)?;
    if violations.is_empty() {
        return Ok(());
    }
    let log = std::fs::read_to_string(data.join("soak.log")).unwrap_or_default();
    let lines: Vec<&str> = log.lines().collect();
    for line in &lines[lines.len().saturating_sub(LAST_LINES)..] {
        print_note(line);
    }
    anyhow::bail!("violations were found: {}", violations.join("; "))
}
