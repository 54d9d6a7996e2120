//! Measures the throughput and response times of a server's queue.
//!
//! The server is real and called over HTTP; its workers only simulate rendering, except the one that a cancel stops.

mod fake_worker;
mod latency;
mod load;
mod paced;

use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use clap::Args;
use proto::Client;
use serde::Serialize;
use server::{ClusterSecret, Config, PostgresAddress, Server};
use tokio_util::sync::CancellationToken;

use crate::program::{Program, temporary_farm_folder};

/// Arguments of `queue`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Number of clients that submit jobs concurrently.
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=1024))]
    clients: u32,
    /// Number of queued jobs of 100 tiles each while claims are measured.
    #[arg(long, value_name = "N", default_value_t = 10_000, value_parser = clap::value_parser!(u32).range(1..=90_000))]
    jobs: u32,
    /// Number of workers that simulate rendering.
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=256))]
    workers: u32,
    /// Seconds to measure tiles and status reads.
    #[arg(long, value_name = "SECONDS", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=600))]
    seconds: u64,
    /// Number of jobs to measure each latency with.
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    runs: u32,
    /// Empty database on a PostgreSQL server for the measured server [default: a file].
    #[arg(long, value_name = "postgres://USER@HOST/NAME")]
    database: Option<PostgresAddress>,
    /// Measure the turns of this many workers instead; each holds a whole frame for a while, as a GPU does.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    paced_workers: Option<u32>,
    /// Seconds for which a paced worker holds a frame; it renews its leases every 10 s.
    #[arg(long, value_name = "SECONDS", default_value_t = 10, requires = "paced_workers", value_parser = clap::value_parser!(u64).range(1..=600))]
    frame_seconds: u64,
    /// Number of servers on the database that the paced workers call.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "paced_workers", value_parser = clap::value_parser!(u32).range(1..=16))]
    servers: u32,
    /// Print the results as JSON.
    #[arg(long)]
    json: bool,
}

/// Distribution of a measured time, in milliseconds.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Times {
    count: usize,
    median_ms: f64,
    p99_ms: f64,
    longest_ms: f64,
}

impl Times {
    fn new(mut times: Vec<Duration>) -> Self {
        times.sort();
        let at = |share: f64| {
            let index = ((times.len() as f64 * share).ceil() as usize).clamp(1, times.len().max(1)) - 1;
            times.get(index).map_or(f64::NAN, |time| time.as_secs_f64() * 1e3)
        };
        Self { count: times.len(), median_ms: at(0.5), p99_ms: at(0.99), longest_ms: at(1.0) }
    }
}

/// All results.
#[derive(Debug, Serialize)]
struct QueueBenchReport {
    clients: u32,
    jobs: u32,
    submits_per_second: f64,
    submit: Times,
    claim: Times,
    tiles_per_second: f64,
    status_per_second: f64,
    status: Times,
    /// Measured on files only, on farms of their own.
    start: Option<Times>,
    cancel: Option<Times>,
}

/// Server in a new folder.
pub(super) struct BenchFarm {
    pub(super) client: Client,
    shutdown: CancellationToken,
    serving: tokio::task::JoinHandle<Result<(), server::ServeError>>,
    _data: tempfile::TempDir,
}

impl BenchFarm {
    pub(super) async fn start(
        program: &Program,
        workers: u32,
        tile_px: Option<u32>,
        database: Option<PostgresAddress>,
    ) -> anyhow::Result<Self> {
        Self::start_among(program, workers, tile_px, database, None).await
    }

    /// Starts a server that may share the database with others of this secret.
    pub(super) async fn start_among(
        program: &Program,
        workers: u32,
        tile_px: Option<u32>,
        database: Option<PostgresAddress>,
        cluster_secret: Option<ClusterSecret>,
    ) -> anyhow::Result<Self> {
        let data = temporary_farm_folder()?;
        let config = Config {
            cluster_secret,
            listen: ([127, 0, 0, 1], 0).into(),
            data: data.path().to_owned(),
            database,
            worker_program: program.file()?,
            job_reader: Some(program.file()?),
            devices: vec!["cpu".to_owned()],
            workers: Some(workers),
            tile_edge_px: tile_px,
            ..Config::default()
        };
        let server = Server::start(config).await?;
        let client = Client::new(&format!("http://{}", server.address()))?;
        let shutdown = CancellationToken::new();
        let serving = tokio::spawn(server.run(shutdown.clone()));
        Ok(Self { client, shutdown, serving, _data: data })
    }

    pub(super) async fn stop(self) -> anyhow::Result<()> {
        self.shutdown.cancel();
        Ok(self.serving.await.context("the farm did not shut down gracefully")??)
    }
}

/// Runs the measurements, and returns them as text.
pub(crate) async fn run(arguments: &Arguments, program: &Program) -> anyhow::Result<String> {
    if let Some(workers) = arguments.paced_workers {
        return paced::run(arguments, program, workers).await;
    }
    let seconds = Duration::from_secs(arguments.seconds);
    let farm = Arc::new(BenchFarm::start(program, 0, Some(load::TILE_PX), arguments.database.clone()).await?);
    eprintln!("submitting {} jobs of 100 tiles", arguments.jobs);
    let (submits_per_second, submit) = load::submit(&farm, arguments.clients, arguments.jobs).await?;
    eprintln!("measuring claims among them");
    let claim = load::claim(&farm).await?;
    eprintln!("completing tiles while clients read jobs");
    let load::Throughput { tiles_per_second, status_per_second, status } =
        load::work(&farm, arguments.workers, seconds).await?;
    Arc::into_inner(farm).context("a client still uses the farm")?.stop().await?;
    let (mut start, mut cancel) = (None, None);
    if arguments.database.is_none() {
        eprintln!("measuring starts and cancels");
        start = Some(latency::start(program, arguments.runs).await?);
        cancel = Some(latency::cancel(program, arguments.runs.min(latency::MAX_CANCELS)).await?);
    }
    let (clients, jobs) = (arguments.clients, arguments.jobs);
    let report = QueueBenchReport {
        clients,
        jobs,
        submits_per_second,
        submit,
        claim,
        tiles_per_second,
        status_per_second,
        status,
        start,
        cancel,
    };
    if arguments.json { Ok(serde_json::to_string_pretty(&report)?) } else { Ok(table(&report)) }
}

fn heading() -> String {
    format!("{:<52} {:>9} {:>10} {:>10} {:>10}", "", "per second", "median ms", "p99 ms", "longest")
}

fn row(what: &str, rate: Option<f64>, times: Option<Times>) -> String {
    let rate = rate.map_or_else(String::new, |rate| format!("{rate:.0}"));
    let times = times.map_or_else(String::new, |times| {
        format!("{:>10.2} {:>10.2} {:>10.2}", times.median_ms, times.p99_ms, times.longest_ms)
    });
    format!("{what:<52} {rate:>9} {times}")
}

fn table(report: &QueueBenchReport) -> String {
    let submitted = format!("jobs submitted by {} clients", report.clients);
    let mut lines = vec![
        heading(),
        row(&submitted, Some(report.submits_per_second), Some(report.submit)),
        row(&format!("claims with {} jobs of 100 tiles queued", report.jobs), None, Some(report.claim)),
        row("tiles claimed and completed", Some(report.tiles_per_second), None),
        row("GET of a job meanwhile", Some(report.status_per_second), Some(report.status)),
    ];
    if let Some((start, cancel)) = report.start.zip(report.cancel) {
        lines.push(row("from a job's 201 to an idle worker's start", None, Some(start)));
        lines.push(row("from a cancel's 200 to its worker's next job", None, Some(cancel)));
    }
    lines.join("\n")
}
