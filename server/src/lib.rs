//! The server of sdfarm: a queue in a database, an HTTP API, a pool of local workers.
//!
//! It plans, leases and stores; it touches no pixel.
//!
//! ```
//! use server::{Config, Server};
//! use tokio_util::sync::CancellationToken;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let folder = tempfile::tempdir()?;
//! let config = Config {
//!     listen: ([127, 0, 0, 1], 0).into(),
//!     data: folder.path().to_owned(),
//!     workers: Some(0),
//!     ..Config::default()
//! };
//! tokio::runtime::Runtime::new()?.block_on(async {
//!     let server = Server::start(config).await?;
//!     assert!(server.url().starts_with("http://127.0.0.1:"));
//!
//!     // It serves until the token is cancelled, and leaves a database behind.
//!     let shutdown = CancellationToken::new();
//!     shutdown.cancel();
//!     server.run(shutdown).await?;
//!     assert!(folder.path().read_dir()?.count() > 0);
//!     Ok(())
//! })
//! # }
//! ```

mod admission;
mod alerts;
mod api_keys;
mod archive;
mod audit_log;
mod blobs;
mod budget;
mod clock;
mod cluster;
mod cluster_secret;
mod config;
mod counters;
mod data_folder;
mod db;
mod delivery_check;
mod estimate;
mod events;
mod fair_queue;
mod farm_events;
mod histograms;
mod host;
mod http;
mod integrity;
mod job_reader;
mod listen;
mod lock;
mod maintenance;
mod orphans;
mod pictures;
mod pool;
#[cfg(test)]
#[path = "../../tests/postgres_server.rs"]
#[expect(dead_code, reason = "only other tests run SQL")]
mod postgres_server;
mod preview_helper;
mod private_files;
mod queue;
mod retention;
mod scaling;
#[cfg(test)]
#[path = "../../tests/seaweedfs.rs"]
mod seaweedfs;
pub mod shipped_scenes;
mod shutdown;
mod signed_links;
#[cfg(test)]
#[path = "../../tests/skip.rs"]
mod skip;
mod space_reserve;
mod startup;
mod submissions;
mod telemetry;
mod tile_plan;
mod upload_ledger;
mod virtual_queue;
mod webhooks;
mod worker_sync;

use std::net::SocketAddr;
use std::time::Duration;

use tokio_util::sync::CancellationToken;

pub use api_keys::{OfflineApiKeys, OfflineApiKeysError};
pub use blobs::{BucketError, ClaimError, ParseStoreError, StoreLocation};
pub use clock::{Clock, ManualClock};
pub use cluster_secret::{ClusterSecret, ShortSecretError};
pub use config::{
    Config, MAX_CONNECTIONS, MAX_JOBS_PER_NAME, MAX_PAUSED_PER_NAME, MAX_QUEUED_JOBS, MAX_RAYS_PER_NAME,
    MAX_REQUESTS_PER_CALLER, MAX_TILE_SECONDS, TlsFiles, VERIFY_NEW_MINUTES, VERIFY_PERCENT,
};
pub use data_folder::{
    Backup, DataFolderError, Depth, Finding, Migrated, MovedDatabase, MovedPictures, Repair, Restored, Severity,
    back_up, migrate, move_database, move_pictures, restore, run_checks,
};
pub use db::{DatabaseError, ParseDatabaseError, PostgresAddress};
pub use integrity::{DoneTile, IntegrityError, IntegrityReport, check_integrity};
pub use job_reader::{READER_COMMAND, run as read_jobs};
pub use private_files::ExposedFile;
pub use startup::StartError;
pub use virtual_queue::{VirtualQueue, VirtualQueueError, VirtualTurn};
pub use webhooks::{AddressRange, SecretError, webhook_secret};

use startup::Started;

/// Time for the last responses after the pool has ended.
const RESPONSE_DRAIN_TIMEOUT: Duration = Duration::from_secs(5);

/// Error that stops a running server.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The listener failed.
    #[error("the server cannot accept connections any more")]
    Listen(#[source] std::io::Error),
}

/// A server that has locked its data folder, opened its database and bound its address.
#[derive(Debug)]
pub struct Server(Started);

impl Server {
    /// Locks the data folder, opens the database, repairs the state that the last server left, and binds the
    /// address. Local workers start with [`Server::run`].
    pub async fn start(config: Config) -> Result<Self, StartError> {
        Self::start_with_clock(config, Clock::system()).await
    }

    /// Starts a server with the given clock.
    pub async fn start_with_clock(config: Config, clock: Clock) -> Result<Self, StartError> {
        startup::start(config, clock).await.map(Self)
    }

    /// Address on which it listens.
    pub fn address(&self) -> SocketAddr {
        self.0.listeners.address()
    }

    /// Its address as clients write it: `http://HOST:PORT`, or `https://HOST:PORT` with a certificate.
    pub fn url(&self) -> String {
        let scheme = if self.0.config.tls.is_some() { "https" } else { "http" };
        format!("{scheme}://{}", self.address())
    }

    /// Serves until `shutdown`; then rejects new jobs, lets local workers finish or release their leases,
    /// and closes the database.
    pub async fn run(self, shutdown: CancellationToken) -> Result<(), ServeError> {
        let Started { config, listeners, state, tasks, pool, queue, shutdown: stages, database, lock } = self.0;
        let router = http::router(state);
        let (address, pool_address) = (listeners.address(), listeners.pool_address());
        let mut serving = tokio::spawn(listeners.serve(router, stages.closing().clone()));
        let tasks = tasks.start(stages.closing());
        let workers = pool.start(&config, pool_address, queue.clone());
        tracing::info!(%address, "serving");
        let failed = tokio::select! {
            () = shutdown.cancelled() => None,
            ended = &mut serving => Some(ended),
        };
        stages.begun().cancel();
        workers.end(config.shutdown_grace).await;
        stages.closing().cancel();
        let ended = match failed {
            Some(ended) => Some(ended),
            None => tokio::time::timeout(RESPONSE_DRAIN_TIMEOUT, serving).await.ok(),
        };
        for (task, name) in tasks {
            if let Err(error) = task.await {
                tracing::error!(%error, "{name} panicked");
            }
        }
        if let Err(error) = queue.end_server().await {
            tracing::warn!(%error, "the other servers will notice that this one has ended");
        }
        database.close().await;
        drop(lock);
        tracing::info!("ended");
        match ended {
            Some(Ok(Err(error))) => Err(ServeError::Listen(error)),
            Some(Err(error)) => Err(ServeError::Listen(std::io::Error::other(error))),
            Some(Ok(Ok(()))) | None => Ok(()),
        }
    }
}
