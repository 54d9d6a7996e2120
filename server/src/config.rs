//! Settings of a server, chosen by its operator.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::time::Duration;

use proto::Secret;
use proto::pool::MAX_POOL_WORKERS;
use proto::price::{DEFAULT_CURRENCY, Rates};

use crate::blobs::StoreLocation;
use crate::cluster_secret::ClusterSecret;
use crate::db::PostgresAddress;
use crate::webhooks::AddressRange;

/// Default maximum of unfinished jobs.
pub const MAX_QUEUED_JOBS: u32 = 100_000;

/// Default maximum time limit for rendering a tile, in seconds: 600 times what a tile of ordinary size takes.
pub const MAX_TILE_SECONDS: u32 = 600;

/// Default maximum of unfinished jobs of a key's name.
pub const MAX_JOBS_PER_NAME: u32 = 10_000;

/// Default maximum of camera rays of the unfinished jobs of a key's name: 57 jobs of the largest size.
pub const MAX_RAYS_PER_NAME: u64 = 1_000_000_000_000_000;

/// Default maximum of paused jobs of a key's name.
pub const MAX_PAUSED_PER_NAME: u32 = 1_000;

/// Default maximum of open connections.
pub const MAX_CONNECTIONS: u32 = 16_384;

/// Default maximum of a caller's requests in progress, event streams and unread responses included.
pub const MAX_REQUESTS_PER_CALLER: u32 = 1024;

/// Default percentage of the results of remote workers that are verified.
pub const VERIFY_PERCENT: f64 = 5.0;

/// Default time in which all results of a new remote worker are verified, in minutes.
pub const VERIFY_NEW_MINUTES: u64 = 3;

/// Files of a certificate and its private key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TlsFiles {
    /// PEM file of a certificate chain, the server's own certificate first.
    pub certificate: PathBuf,
    /// PEM file of its private key.
    pub key: PathBuf,
}

/// Settings of a server. `Config::default()` has the defaults of `serve`.
#[derive(Clone, Debug)]
pub struct Config {
    /// Address to listen on; port 0 takes any free port.
    pub listen: SocketAddr,
    /// Folder of the database and, unless they are in a store, the pictures; created if missing.
    pub data: PathBuf,
    /// Database on a PostgreSQL server; `None` is a file in the data folder.
    pub database: Option<PostgresAddress>,
    /// Secret that the servers of a farm share; there may be several then, on one database and one store.
    pub cluster_secret: Option<ClusterSecret>,
    /// Where pictures and tiles are stored.
    pub store: StoreLocation,
    /// Whether clients are sent to the store for stored pictures of more than 1 MiB, if it is a bucket of S3.
    pub redirect_pictures: bool,
    /// Age below which objects of a bucket are never swept; `None` is the default. For tests.
    pub object_sweep_age: Option<Duration>,
    /// Local workers; `None` is one for each of `devices`.
    pub workers: Option<u32>,
    /// `--device` of the local workers in turn: `["cpu"]`, or one for each GPU. Empty means `["auto"]`.
    pub devices: Vec<String>,
    /// `--simd` of the local workers.
    pub simd: String,
    /// Threads that CPU workers share; `None` means one for each core.
    pub threads: Option<usize>,
    /// Edge of a tile, in pixels; `None` sizes tiles by their rays.
    pub tile_edge_px: Option<u32>,
    /// Length of a lease.
    pub lease: Duration,
    /// Maximum time limit for rendering a tile, in seconds, and that of jobs without their own.
    pub max_tile_seconds: u32,
    /// Whether to listen beyond loopback although there are no keys.
    pub insecure: bool,
    /// Whether changes that browsers ask for are refused.
    pub read_only_page: bool,
    /// TLS certificate; without one the server speaks plain HTTP.
    pub tls: Option<TlsFiles>,
    /// Maximum number of open connections; the system's limit of open files may lower it.
    pub max_connections: u32,
    /// Maximum number of open connections of one address that is not loopback; `None` is a quarter of all.
    pub max_connections_per_address: Option<u32>,
    /// Maximum number of requests of one key's name in progress, or of one address without a key.
    pub max_requests_per_caller: u32,
    /// Maximum number of unfinished jobs.
    pub max_queued_jobs: u32,
    /// Maximum number of unfinished jobs of a key's name; a key can have its own.
    pub max_jobs_per_name: u32,
    /// Maximum number of camera rays of the unfinished jobs of a key's name; a key can have its own.
    pub max_rays_per_name: u64,
    /// Maximum number of paused jobs of a key's name.
    pub max_paused_per_name: u32,
    /// Fraction of the results of remote workers that another worker renders again.
    pub verify_share: f64,
    /// Time after a remote worker's registration in which all its results are rendered again.
    pub verify_new: Duration,
    /// Host names, without port, that the `Host` header may contain in addition to loopback names and IP
    /// addresses.
    pub allowed_hosts: Vec<String>,
    /// Address ranges that webhooks may reach although they are not on the public internet.
    pub allowed_webhook_ranges: Vec<AddressRange>,
    /// Prices of the machines' time.
    pub rates: Rates,
    /// Secret that signs webhooks; `None` means the one in the data folder.
    pub webhook_secret: Option<Secret>,
    /// Program of the local workers, called with `worker` as first argument.
    pub worker_program: PathBuf,
    /// Program that reads job files in processes with limits, called with [`READER_COMMAND`](crate::READER_COMMAND) as
    /// argument; `None` means on threads of this process, without limits.
    pub job_reader: Option<PathBuf>,
    /// Retention of finished jobs that do not set their own; `None` means forever.
    pub job_retention: Option<Duration>,
    /// Maximum size of pictures and tiles; above it the jobs that finished first are deleted. `None`
    /// means no limit.
    pub max_store_bytes: Option<u64>,
    /// Environment variables for local workers.
    pub worker_env: Vec<(String, String)>,
    /// How long local workers may continue their leases at shutdown.
    pub shutdown_grace: Duration,
}

impl Config {
    /// Number of workers that the pool starts with.
    pub(crate) fn pool_workers(&self) -> u32 {
        let one_for_each = || u32::try_from(self.devices.len()).unwrap_or(MAX_POOL_WORKERS).clamp(1, MAX_POOL_WORKERS);
        self.workers.unwrap_or_else(one_for_each)
    }

    /// Threads that the pool's CPU workers share.
    pub(crate) fn cpu_threads(&self) -> usize {
        self.threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from))
    }
}

impl Default for Config {
    fn default() -> Self {
        Self {
            listen: SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 8080),
            data: PathBuf::from("sdfarm-data"),
            database: None,
            cluster_secret: None,
            store: StoreLocation::Folder,
            redirect_pictures: false,
            object_sweep_age: None,
            workers: None,
            devices: vec!["auto".to_owned()],
            simd: "auto".to_owned(),
            threads: None,
            tile_edge_px: None,
            lease: Duration::from_secs(30),
            max_tile_seconds: MAX_TILE_SECONDS,
            insecure: false,
            read_only_page: false,
            tls: None,
            max_connections: MAX_CONNECTIONS,
            max_connections_per_address: None,
            max_requests_per_caller: MAX_REQUESTS_PER_CALLER,
            max_queued_jobs: MAX_QUEUED_JOBS,
            max_jobs_per_name: MAX_JOBS_PER_NAME,
            max_rays_per_name: MAX_RAYS_PER_NAME,
            max_paused_per_name: MAX_PAUSED_PER_NAME,
            verify_share: VERIFY_PERCENT / 100.0,
            verify_new: Duration::from_secs(60 * VERIFY_NEW_MINUTES),
            allowed_hosts: Vec::new(),
            allowed_webhook_ranges: Vec::new(),
            rates: Rates { currency: DEFAULT_CURRENCY.to_owned(), ..Rates::default() },
            webhook_secret: None,
            worker_program: PathBuf::from("sdfarm"),
            job_reader: None,
            job_retention: None,
            max_store_bytes: None,
            worker_env: Vec::new(),
            shutdown_grace: Duration::from_secs(10),
        }
    }
}
