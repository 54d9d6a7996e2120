//! Startup: checks everything about the server's environment before it serves, with an error and its fix for
//! each problem.

use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;

use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use crate::Server;
use crate::admission::Doors;
use crate::clock::Clock;
use crate::config::Config;
use crate::content_store::Pictures;
use crate::database::{OpenError, Store, StoreError};
use crate::events::Events;
use crate::farm::{Farm, Totals};
use crate::job_cache::Jobs;
use crate::listen::Entrance;
use crate::lock::{FolderLock, LockError};
use crate::pool::Pool;
use crate::preview_helper::Sketches;
use crate::queue::Queue;
use crate::signed_links::Links;
use crate::telemetry::Watch;
use crate::webhooks::{Guard, SecretError, Signer, Webhooks, webhook_secret};

/// Error that prevents the start, with its fix.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The address is not loopback's, and there are no keys.
    #[error(
        "refusing to listen on {0}: it is not a loopback address, there are no keys, and anyone who reaches it could \
         use the farm; make a key (sdfarm key new NAME --scope admin --data FOLDER), listen on 127.0.0.1, or say \
         --insecure if that is meant"
    )]
    Exposed(SocketAddr),
    /// The data folder can't be used.
    #[error("the data folder {folder} can't be used: {source}; make it writable, or name another with --data")]
    DataFolder {
        /// The folder.
        folder: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// Another server has the data folder.
    #[error(
        "data folder {folder} is in use by another server (pid {holder}): stop that one, or name another folder with --data"
    )]
    InUse {
        /// The folder.
        folder: PathBuf,
        /// The other server's process id.
        holder: String,
    },
    /// The database can't be used.
    #[error("the database {file} can't be used: {reason}; {cure}")]
    Database {
        /// The file.
        file: PathBuf,
        /// Reason.
        reason: String,
        /// Fix.
        cure: &'static str,
    },
    /// The certificate can't be used.
    #[error("can't offer TLS: {0}; name PEM files with --tls-cert and --tls-key")]
    Tls(String),
    /// There is no secret to sign webhooks with.
    #[error("{0}; set SDFARM_WEBHOOK_SECRET, or move the file away to have a new one made")]
    WebhookSecret(#[from] SecretError),
    /// The address can't be had.
    #[error("can't listen on {address}: {source}; stop what listens there, or choose another address with --listen")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Error of the system.
        source: io::Error,
    },
}

const RESTORE: &str = "restore it from a backup, or move it away to start with an empty farm";
const MAKE_ROOM: &str = "make room on its disk";
const MAKE_WRITABLE: &str = "make it and its folder writable, or name another folder with --data";
const UPGRADE: &str = "it may be of a newer release: run that one";

/// See [`Server::start`].
pub(crate) async fn start(config: Config, clock: Clock) -> Result<Server, StartError> {
    let folder = |source| StartError::DataFolder { folder: config.data.clone(), source };
    std::fs::create_dir_all(&config.data).map_err(folder)?;
    let lock = FolderLock::take(&config.data).map_err(|error| match error {
        LockError::Held(holder) => StartError::InUse { folder: config.data.clone(), holder },
        LockError::Io(source) => folder(source),
    })?;
    let pictures = Pictures::open(&config.data).map_err(folder)?;
    let links = Links::open(&config.data).map_err(folder)?;
    let sketches = Sketches::open(&config.data, &config.worker_program).map_err(folder)?;
    let entrance = Entrance::open(&config).await?;
    let file = Store::file(&config.data);
    let store = Arc::new(Store::open(&config.data).await.map_err(|error| explain(file.clone(), error))?);
    let lease_ms = i64::try_from(config.lease.as_millis()).unwrap_or(i64::MAX / 4).max(1);
    let doors =
        Doors::open(Arc::clone(&store), clock.clone()).await.map_err(|error| explain_store(file.clone(), &error))?;
    if !entrance.address().ip().is_loopback() && !config.insecure && doors.keys.live() == 0 {
        store.close().await;
        return Err(StartError::Exposed(config.listen));
    }
    let (queue, recovered) =
        Queue::open(Arc::clone(&store), clock, lease_ms).await.map_err(|error| explain_store(file, &error))?;
    tracing::info!(
        data = %config.data.display(), boot = recovered.generation, unfinished_jobs = recovered.jobs,
        handed_back = recovered.leases, "opened the data folder"
    );
    let webhooks = webhooks(&config)?;
    let (left, leftovers) = mpsc::unbounded_channel();
    let farm = Arc::new(Farm {
        events: Events::new(queue.clone()),
        webhooks,
        queue,
        pictures,
        jobs: Jobs::new(),
        doors,
        pool: Pool::new(config.pool_workers()),
        sketches,
        links,
        totals: Totals::default(),
        watch: Watch::new(config.data.clone(), &store),
        leftovers: left,
        closing: CancellationToken::new(),
        ending: CancellationToken::new(),
        config,
    });
    Ok(Server { entrance, farm, store, leftovers, lock })
}

/// Creates the sender of webhooks, with the operator's secret or the data folder's own.
fn webhooks(config: &Config) -> Result<Webhooks, StartError> {
    let secret = match &config.webhook_secret {
        Some(secret) => secret.clone(),
        None => webhook_secret(&config.data)?,
    };
    Ok(Webhooks::new(Guard::new(&config.allow_webhooks_to), Signer::new(&secret)?))
}

fn explain(file: PathBuf, error: OpenError) -> StartError {
    match error {
        OpenError::Sql(error) | OpenError::Migrate(sqlx::migrate::MigrateError::Execute(error)) => {
            explain_store(file, &error.into())
        }
        OpenError::Migrate(error) => StartError::Database { file, reason: error.to_string(), cure: UPGRADE },
        OpenError::Damaged(verdict) => {
            StartError::Database { file, reason: format!("it is damaged ({verdict})"), cure: RESTORE }
        }
    }
}

fn explain_store(file: PathBuf, error: &StoreError) -> StartError {
    let reason = match error {
        StoreError::Sql(error) => error.to_string(),
        StoreError::Rows { .. } | StoreError::Value { .. } | StoreError::Closed => error.to_string(),
    };
    let cure = if error.is_full() {
        MAKE_ROOM
    } else if error.is_damage() {
        RESTORE
    } else {
        MAKE_WRITABLE
    };
    StartError::Database { file, reason, cure }
}
