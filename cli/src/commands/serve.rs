//! `sdfarm serve`: runs the farm.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context;
use clap::Args;
use proto::pool::MAX_POOL_WORKERS;
use proto::{Retention, Secret};
use server::{
    AddressRange, ClusterSecret, Config, MAX_CONNECTIONS, MAX_JOBS_PER_NAME, MAX_PAUSED_PER_NAME, MAX_QUEUED_JOBS,
    MAX_RAYS_PER_NAME, MAX_REQUESTS_PER_CALLER, MAX_TILE_SECONDS, PostgresAddress, Server, StoreLocation, TlsFiles,
    VERIFY_NEW_MINUTES, VERIFY_PERCENT,
};
use tokio_util::sync::CancellationToken;
use worker::{CpuRenderer, RenderError, Simd};

use crate::arguments::{DeviceChoice, MAX_THREADS, simd_parser};
use crate::commands::price::RateArguments;
use crate::signals::Signals;
use crate::size::Size;
use crate::systemd;
use crate::terminal::print_line;

/// Upper limit of `--max-queued-jobs`: the sum of the jobs' rays must fit a counter.
const QUEUED_JOBS_LIMIT: u32 = 250_000;

/// Upper limit of `--max-tile-seconds`: a day.
const TILE_SECONDS_LIMIT: i64 = 86_400;

/// Arguments of `serve`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Address to listen on; port 0 takes any free port.
    #[arg(long, value_name = "ADDRESS:PORT", env = "SDFARM_LISTEN", default_value = "127.0.0.1:8080", value_parser = address)]
    listen: SocketAddr,
    /// Folder of the database and, without --store, the pictures; created if missing.
    #[arg(long, value_name = "FOLDER", env = "SDFARM_DATA", default_value = "./sdfarm-data")]
    data: PathBuf,
    /// Database on a PostgreSQL server, 15 or newer; a password may also be in PGPASSWORD or ~/.pgpass [default: a file in the data folder].
    #[arg(long, value_name = "postgres://USER@HOST/NAME", env = "SDFARM_DATABASE", hide_env_values = true)]
    database: Option<PostgresAddress>,
    /// Secret of at least 32 characters that the servers of one farm share, so that several may run on one database and one store.
    #[arg(long, value_name = "SECRET", env = "SDFARM_CLUSTER_SECRET", hide_env_values = true, requires_all = ["database", "store"])]
    cluster_secret: Option<ClusterSecret>,
    /// Bucket of an S3 store for pictures and tiles; keys, region and endpoint come from the usual AWS variables [default: the data folder].
    #[arg(long, value_name = "s3://BUCKET/PREFIX", env = "SDFARM_STORE")]
    store: Option<StoreLocation>,
    /// Send clients to the store for stored pictures of more than 1 MiB, by an address that is valid for five minutes.
    #[arg(long, env = "SDFARM_REDIRECT_PICTURES", requires = "store", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    redirect_pictures: bool,
    /// Age below which objects are never swept; for tests.
    #[arg(long, hide = true, value_name = "SECONDS", requires = "store")]
    object_sweep_seconds: Option<u64>,
    /// Workers on this machine [default: one for each GPU, otherwise one with every core].
    #[arg(long, value_name = "N", env = "SDFARM_WORKERS", value_parser = clap::value_parser!(u32).range(0..=i64::from(MAX_POOL_WORKERS)))]
    workers: Option<u32>,
    /// Device of the workers: auto, cpu, cuda or cuda:N; several GPUs are assigned in turn.
    #[arg(long, env = "SDFARM_DEVICE", default_value = "auto")]
    device: DeviceChoice,
    /// Vector instructions of the workers; every choice gives the same pictures.
    #[arg(long, env = "SDFARM_SIMD", default_value = "auto", value_parser = simd_parser())]
    simd: Simd,
    /// Threads that CPU workers share [default: one for each core].
    #[arg(long, value_name = "N", env = "SDFARM_THREADS", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_THREADS)))]
    threads: Option<u32>,
    /// Maximum memory for the cells of a frame with many shapes, in each worker, such as 500MB or 2GiB [default: up to 4GiB].
    #[arg(long, value_name = "SIZE", env = "SDFARM_CELL_MEMORY")]
    cell_memory: Option<Size>,
    /// Edge of a tile, in pixels [default: about a second of work].
    #[arg(long, value_name = "PIXELS", env = "SDFARM_TILE", value_parser = clap::value_parser!(u32).range(1..))]
    tile: Option<u32>,
    /// Seconds without a sync after which a worker's tiles are leased to others.
    #[arg(long, value_name = "SECONDS", env = "SDFARM_LEASE_SECONDS", default_value_t = 30, value_parser = clap::value_parser!(u64).range(1..=3600))]
    lease_seconds: u64,
    /// Maximum seconds that rendering one tile may take; a job may set a lower limit. A tile above its limit has failed.
    #[arg(long, value_name = "SECONDS", env = "SDFARM_MAX_TILE_SECONDS", default_value_t = MAX_TILE_SECONDS, value_parser = clap::value_parser!(u32).range(1..=TILE_SECONDS_LIMIT))]
    max_tile_seconds: u32,
    /// Certificate chain (PEM), the server's own certificate first; enables https.
    #[arg(long, value_name = "FILE", env = "SDFARM_TLS_CERT", requires = "tls_key")]
    tls_cert: Option<PathBuf>,
    /// Private key of the certificate (PEM); both files are reloaded when they change.
    #[arg(long, value_name = "FILE", env = "SDFARM_TLS_KEY", requires = "tls_cert")]
    tls_key: Option<PathBuf>,
    /// Maximum open connections; above it, the connections idle longest are closed.
    #[arg(long, value_name = "N", env = "SDFARM_MAX_CONNECTIONS", default_value_t = MAX_CONNECTIONS, value_parser = clap::value_parser!(u32).range(1..))]
    max_connections: u32,
    /// Maximum open connections of one address that is not loopback; above it, new ones are closed [default: a quarter of --max-connections].
    #[arg(long, value_name = "N", env = "SDFARM_MAX_CONNECTIONS_PER_ADDRESS", value_parser = clap::value_parser!(u32).range(1..))]
    max_connections_per_address: Option<u32>,
    /// Maximum requests of one key's name in progress (of one address, without a key), with event streams and unread responses.
    #[arg(long, value_name = "N", env = "SDFARM_MAX_REQUESTS_PER_CALLER", default_value_t = MAX_REQUESTS_PER_CALLER, value_parser = clap::value_parser!(u32).range(1..))]
    max_requests_per_caller: u32,
    /// Maximum number of unfinished jobs; above it, submissions are rejected because the queue is full.
    #[arg(long, value_name = "N", env = "SDFARM_MAX_QUEUED_JOBS", default_value_t = MAX_QUEUED_JOBS, value_parser = clap::value_parser!(u32).range(1..=i64::from(QUEUED_JOBS_LIMIT)))]
    max_queued_jobs: u32,
    /// Maximum number of unfinished jobs of a key's name, unless the key has its own.
    #[arg(long, value_name = "N", env = "SDFARM_MAX_JOBS_PER_NAME", default_value_t = MAX_JOBS_PER_NAME, value_parser = clap::value_parser!(u32).range(1..))]
    max_jobs_per_name: u32,
    /// Maximum number of camera rays of the unfinished jobs of a key's name, unless the key has its own.
    #[arg(long, value_name = "N", env = "SDFARM_MAX_RAYS_PER_NAME", default_value_t = MAX_RAYS_PER_NAME, value_parser = clap::value_parser!(u64).range(1..))]
    max_rays_per_name: u64,
    /// Maximum number of paused jobs of a key's name.
    #[arg(long, value_name = "N", env = "SDFARM_MAX_PAUSED_PER_NAME", default_value_t = MAX_PAUSED_PER_NAME)]
    max_paused_per_name: u32,
    /// Percentage of the results of remote workers that another worker renders again; 0 for none.
    #[arg(long, value_name = "PERCENT", env = "SDFARM_VERIFY_SHARE", default_value_t = VERIFY_PERCENT, value_parser = percentage)]
    verify_share: f64,
    /// Minutes after its registration in which all results of a remote worker are rendered again.
    #[arg(long, value_name = "MINUTES", env = "SDFARM_VERIFY_NEW_MINUTES", default_value_t = VERIFY_NEW_MINUTES, value_parser = clap::value_parser!(u64).range(0..=1440))]
    verify_new_minutes: u64,
    /// Retention of finished jobs that do not set their own: 36h, 30d, forever.
    #[arg(long, value_name = "AGE", env = "SDFARM_KEEP_JOBS", default_value = "forever")]
    keep_jobs: Retention,
    /// Size of pictures and tiles above which the jobs that finished first are deleted: 500MB, 20GiB [default: none].
    #[arg(long, value_name = "SIZE", env = "SDFARM_MAX_STORE")]
    max_store: Option<Size>,
    /// Listen beyond loopback without keys: every client that reaches the port may use the farm.
    #[arg(long, env = "SDFARM_INSECURE", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    insecure: bool,
    /// Refuse changes that browsers ask for, so that the page only shows; commands and programs change the farm as before.
    #[arg(long, env = "SDFARM_READ_ONLY_PAGE", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    read_only_page: bool,
    /// Host names of this server, in addition to loopback names and IP addresses.
    #[arg(long, value_name = "NAME", env = "SDFARM_HOST", value_delimiter = ',')]
    host: Vec<String>,
    /// Addresses that webhooks may reach although they are not on the public internet, such as
    /// 10.0.0.0/8.
    #[arg(long, value_name = "RANGE", env = "SDFARM_ALLOW_WEBHOOK_TO", value_delimiter = ',')]
    allow_webhook_to: Vec<AddressRange>,
    #[command(flatten)]
    rates: RateArguments,
    /// Secret that signs webhooks: whsec_ and base64 [default: created once, stored in the data folder].
    #[arg(long, value_name = "SECRET", env = "SDFARM_WEBHOOK_SECRET", hide_env_values = true)]
    webhook_secret: Option<Secret>,
}

impl Arguments {
    fn config(self) -> anyhow::Result<Config> {
        let mut worker_env = crate::logs::child_env();
        worker_env.extend(self.cell_memory.map(|Size(bytes)| ("SDFARM_CELL_MEMORY".to_owned(), bytes.to_string())));
        Ok(Config {
            listen: self.listen,
            data: self.data,
            database: self.database,
            cluster_secret: self.cluster_secret,
            store: self.store.unwrap_or_default(),
            redirect_pictures: self.redirect_pictures,
            object_sweep_age: self.object_sweep_seconds.map(Duration::from_secs),
            workers: self.workers,
            devices: devices(self.device)?,
            simd: self.simd.to_string(),
            threads: self.threads.map(|threads| threads as usize),
            tile_edge_px: self.tile,
            lease: Duration::from_secs(self.lease_seconds),
            max_tile_seconds: self.max_tile_seconds,
            insecure: self.insecure,
            read_only_page: self.read_only_page,
            tls: self.tls_cert.zip(self.tls_key).map(|(certificate, key)| TlsFiles { certificate, key }),
            max_connections: self.max_connections,
            max_connections_per_address: self.max_connections_per_address,
            max_requests_per_caller: self.max_requests_per_caller,
            max_queued_jobs: self.max_queued_jobs,
            max_jobs_per_name: self.max_jobs_per_name,
            max_rays_per_name: self.max_rays_per_name,
            max_paused_per_name: self.max_paused_per_name,
            verify_share: self.verify_share / 100.0,
            verify_new: Duration::from_mins(self.verify_new_minutes),
            allowed_hosts: self.host,
            job_retention: match self.keep_jobs {
                Retention::Forever => None,
                Retention::For(time) => Some(time),
            },
            max_store_bytes: self.max_store.map(|Size(bytes)| bytes),
            allowed_webhook_ranges: self.allow_webhook_to,
            rates: self.rates.rates(),
            webhook_secret: self.webhook_secret,
            worker_program: current_executable()?,
            job_reader: Some(current_executable()?),
            worker_env,
            ..Config::default()
        })
    }
}

/// Parses `--listen`.
fn address(text: &str) -> Result<SocketAddr, String> {
    text.parse()
        .map_err(|_| "use an IP address and a port, such as 127.0.0.1:8080, 0.0.0.0:8080 or [::1]:8080".to_owned())
}

/// Parses `--verify-share`.
fn percentage(text: &str) -> Result<f64, String> {
    let percent = text.trim_end_matches('%').parse().ok().filter(|percent| (0.0..=100.0).contains(percent));
    percent.ok_or_else(|| "use a number from 0 to 100".to_owned())
}

/// Serves until SIGINT or SIGTERM.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    // Settings that no worker could use are rejected here, once.
    CpuRenderer::new(Some(1), arguments.simd)?;
    let signals = Signals::install()?;
    let shutdown = CancellationToken::new();
    let server = Server::start(arguments.config()?).await?;
    let url = server.url();
    print_line(&format!("sdfarm serves {url} (its API: {url}/docs)"))?;
    systemd::serving(&url);
    signals.cancel_then_exit(shutdown.clone());
    let stopping = shutdown.clone();
    tokio::spawn(async move {
        stopping.cancelled().await;
        systemd::stopping();
    });
    server.run(shutdown).await?;
    Ok(())
}

/// Path of this program, which local workers run.
pub(crate) fn current_executable() -> anyhow::Result<PathBuf> {
    std::env::current_exe().context("could not find this program's own file, which local workers run")
}

/// Devices of the local workers, in turn: each GPU, else the CPU.
pub(crate) fn devices(device: DeviceChoice) -> Result<Vec<String>, RenderError> {
    let cpu = || vec!["cpu".to_owned()];
    let each = |kind: &str, count: usize| (0..count).map(|gpu| format!("{kind}:{gpu}")).collect();
    match device {
        DeviceChoice::Cpu => Ok(cpu()),
        DeviceChoice::Auto(None) => Ok(worker::cuda::devices().map_or_else(|_| cpu(), |count| each("auto", count))),
        DeviceChoice::Auto(Some(gpu)) => Ok(vec![format!("auto:{gpu}")]),
        DeviceChoice::Cuda(None) => worker::cuda::devices().map(|count| each("cuda", count)),
        DeviceChoice::Cuda(Some(gpu)) => worker::cuda::devices().map(|_| vec![format!("cuda:{gpu}")]),
    }
}
