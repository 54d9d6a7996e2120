//! The server of sdfarm: a queue in a database, an HTTP API, a pool of local workers.
//!
//! It plans, leases and stores; it touches no pixel.

mod admission;
mod api_keys;
mod archive;
mod audit_log;
mod budget;
mod clock;
mod config;
mod content_store;
mod data_folder;
mod database;
mod delivery_check;
mod estimate;
mod events;
mod fair_queue;
mod farm;
mod http;
mod integrity;
mod job_cache;
mod listen;
mod lock;
mod maintenance;
mod pool;
mod preview_helper;
mod private_files;
mod queue;
mod retention;
mod signed_links;
pub mod simulation;
mod space_reserve;
mod startup;
mod telemetry;
mod tile_plan;
mod webhooks;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

pub use api_keys::{OfflineApiKeys, OfflineApiKeysError};
pub use clock::{Clock, ManualClock};
pub use config::{
    Config, MAX_CONNECTIONS, MAX_JOBS_PER_NAME, MAX_PAUSED_PER_NAME, MAX_QUEUED_JOBS, MAX_RAYS_PER_NAME,
    MAX_REQUESTS_PER_CALLER, MAX_TILE_SECONDS, TlsFiles, VERIFY_NEW_MINUTES, VERIFY_PERCENT,
};
pub use data_folder::{
    Backup, DataFolderError, Depth, Finding, Repair, Restored, Severity, back_up, restore, run_checks,
};
pub use integrity::{DoneTile, IntegrityError, IntegrityReport, check_integrity};
pub use private_files::ExposedFile;
pub use startup::StartError;
pub use webhooks::{AddressRange, SecretError, webhook_secret};

use database::Database;
use farm::{Farm, OrphanCandidates};
use listen::Listeners;
use lock::FolderLock;

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
pub struct Server {
    listeners: Listeners,
    farm: Arc<Farm>,
    store: Arc<Database>,
    orphans: mpsc::UnboundedReceiver<OrphanCandidates>,
    // Dropped last, so that the lock is held until everything is closed.
    lock: FolderLock,
}

impl Server {
    /// Locks the data folder, opens the database, repairs the state that the last server left, and binds the
    /// address. Local workers start with [`Server::run`].
    pub async fn start(config: Config) -> Result<Self, StartError> {
        Self::start_with_clock(config, Clock::system()).await
    }

    /// Starts a server with the given clock.
    pub async fn start_with_clock(config: Config, clock: Clock) -> Result<Self, StartError> {
        startup::start(config, clock).await
    }

    /// Address on which it listens.
    pub fn address(&self) -> SocketAddr {
        self.listeners.address()
    }

    /// Its address as clients write it: `http://HOST:PORT`, or `https://HOST:PORT` with a certificate.
    pub fn url(&self) -> String {
        let scheme = if self.farm.config.tls.is_some() { "https" } else { "http" };
        format!("{scheme}://{}", self.address())
    }

    /// Serves until `shutdown`; then rejects new jobs, lets local workers finish or release their leases,
    /// and closes the database.
    pub async fn run(self, shutdown: CancellationToken) -> Result<(), ServeError> {
        let Self { listeners: entrance, farm, store, orphans: leftovers, lock } = self;
        let router = http::router(Arc::clone(&farm));
        let (address, pool_address) = (entrance.address(), entrance.pool_address());
        let mut serving = tokio::spawn(entrance.serve(router, farm.shutdown.clone()));
        let janitor = tokio::spawn(maintenance::run(Arc::clone(&farm), leftovers, farm.shutdown.clone()));
        let sending = tokio::spawn(webhooks::run(Arc::clone(&farm), farm.shutdown.clone()));
        let telling = tokio::spawn({
            let farm = Arc::clone(&farm);
            async move { farm.events.run(farm.shutdown.clone()).await }
        });
        let admission = farm.clone();
        let admission_task = tokio::spawn(async move { admission.admission.run(admission.shutdown.clone()).await });
        let pool = farm.pool.start(&farm.config, pool_address, farm.queue.clone());
        tracing::info!(%address, "serving");
        let failed = tokio::select! {
            () = shutdown.cancelled() => None,
            ended = &mut serving => Some(ended),
        };
        farm.is_shutting_down.cancel();
        pool.end(farm.config.shutdown_grace).await;
        farm.shutdown.cancel();
        let ended = match failed {
            Some(ended) => Some(ended),
            None => tokio::time::timeout(RESPONSE_DRAIN_TIMEOUT, serving).await.ok(),
        };
        for (task, name) in [(janitor, "maintenance"), (telling, "event distribution"), (sending, "webhook delivery")] {
            if let Err(error) = task.await {
                tracing::error!(%error, "{name} panicked");
            }
        }
        if let Err(error) = admission_task.await {
            tracing::error!(%error, "admission control panicked");
        }
        store.close().await;
        drop(lock);
        tracing::info!("ended");
        match ended {
            Some(Ok(Err(error))) => Err(ServeError::Listen(error)),
            Some(Err(error)) => Err(ServeError::Listen(std::io::Error::other(error))),
            Some(Ok(Ok(()))) | None => Ok(()),
        }
    }
}
