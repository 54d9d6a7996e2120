//! Startup: checks everything in the server's environment before it serves; each problem has an error with its
//! fix.

use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;

use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use crate::Server;
use crate::admission::{Admission, Shares};
use crate::blobs::{BlobStore, BucketError, ContentKind, OpenStoreError, StoreLocation};
use crate::clock::Clock;
use crate::config::Config;
use crate::database::{Database, DatabaseError, OpenError};
use crate::estimate;
use crate::events::EventHub;
use crate::farm::{Farm, ServerCounters};
use crate::job_cache::JobCache;
use crate::listen::Listeners;
use crate::lock::{FolderLock, LockError};
use crate::pool::Pool;
use crate::preview_helper::PreviewHelper;
use crate::private_files::{self, ExposedFile};
use crate::queue::{Queue, VerificationPolicy};
use crate::signed_links::LinkSigner;
use crate::space_reserve::SpaceReserve;
use crate::telemetry::Telemetry;
use crate::webhooks::{AddressPolicy, SecretError, Signer, Webhooks, webhook_secret};

/// Error that prevents the start, with its fix.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The address is not loopback, and there are no keys.
    #[error(
        "refusing to listen on {0}: it is not a loopback address, there are no keys, and anyone who reaches it could \
         use the farm; create a key (sdfarm key new NAME --scope admin --data FOLDER), listen on 127.0.0.1, or pass \
         --insecure if that is intended"
    )]
    NoKeysBeyondLoopback(SocketAddr),
    /// The data folder cannot be used.
    #[error("the data folder {folder} cannot be used: {source}; make it writable, or pass another with --data")]
    DataFolder {
        /// The folder.
        folder: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// The store cannot be used.
    #[error(transparent)]
    Store(#[from] BucketError),
    /// The farm's pictures are in another store.
    #[error(
        "the farm in {folder} has its pictures in {recorded}, not in {given}: start it with the store it has \
         (--store s3://BUCKET/PREFIX, none for the data folder); or, to move it, copy pictures/ to the new store, and \
         replace the line in {folder}/{} by it (remove the file for the data folder)",
        crate::blobs::RECORD_FILE
    )]
    OtherStore {
        /// The data folder.
        folder: PathBuf,
        /// Store of its pictures.
        recorded: StoreLocation,
        /// Store in the configuration.
        given: StoreLocation,
    },
    /// Others may read the data folder's secrets.
    #[error(transparent)]
    Exposed(#[from] ExposedFile),
    /// Another server uses the data folder.
    #[error(
        "data folder {folder} is in use by another server (pid {holder}): stop that server, or pass another folder with --data"
    )]
    InUse {
        /// The folder.
        folder: PathBuf,
        /// The other server's process id.
        holder: String,
    },
    /// The database cannot be used.
    #[error("the database {file} cannot be used: {reason}; {cure}")]
    Database {
        /// The file.
        file: PathBuf,
        /// Reason.
        reason: String,
        /// Fix.
        cure: &'static str,
    },
    /// The certificate cannot be used.
    #[error("cannot set up TLS: {0}; pass PEM files with --tls-cert and --tls-key")]
    Tls(String),
    /// The webhook secret cannot be used.
    #[error("{0}; set SDFARM_WEBHOOK_SECRET, or move the file away so that a new secret is created")]
    WebhookSecret(#[from] SecretError),
    /// The server cannot listen on the address.
    #[error(
        "cannot listen on {address}: {source}; stop the program that uses it, or choose another address with --listen"
    )]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Error of the system.
        source: io::Error,
    },
}

const RESTORE_FIX: &str = "restore it from a backup, or move it away to start with an empty farm";
const MAKE_ROOM_FIX: &str = "free space on its disk";
const MAKE_WRITABLE_FIX: &str = "make it and its folder writable, or pass another folder with --data";
const UPGRADE_FIX: &str = "it may be from a newer release: run that one";

/// See [`Server::start`].
pub(crate) async fn start(config: Config, clock: Clock) -> Result<Server, StartError> {
    let folder = |source| StartError::DataFolder { folder: config.data.clone(), source };
    private_files::create_folder(&config.data).map_err(folder)?;
    // First of all, because everything that follows needs a little space.
    let reserve = SpaceReserve::open(&config.data);
    let lock = FolderLock::acquire(&config.data).map_err(|error| match error {
        LockError::InUse(holder) => StartError::InUse { folder: config.data.clone(), holder },
        LockError::Io(source) => folder(source),
    })?;
    private_files::restrict(&config.data)?;
    let content = open_store(&config).await?;
    let links = LinkSigner::open(&config.data).map_err(folder)?;
    let sketches = PreviewHelper::open(&config.data, &config.worker_program).map_err(folder)?;
    let entrance = Listeners::open(&config).await?;
    let file = Database::file(&config.data);
    let store = Arc::new(Database::open(&config.data).await.map_err(|error| database_error(file.clone(), error))?);
    let lease_ms = i64::try_from(config.lease.as_millis()).unwrap_or(i64::MAX / 4).max(1);
    let shares = Shares::new(entrance.connections(), config.max_requests_per_caller as usize);
    let admission = Admission::open(Arc::clone(&store), clock.clone(), shares)
        .await
        .map_err(|error| explain_store(file.clone(), &error))?;
    if !entrance.address().ip().is_loopback() && !config.insecure && admission.keys.live() == 0 {
        store.close().await;
        return Err(StartError::NoKeysBeyondLoopback(config.listen));
    }
    let (queue, recovered) =
        Queue::open(Arc::clone(&store), clock, lease_ms).await.map_err(|error| explain_store(file, &error))?;
    let verification = VerificationPolicy {
        share: config.verify_share,
        new_worker_ms: i64::try_from(config.verify_new.as_millis()).unwrap_or(i64::MAX / 4),
    };
    let queue = queue.with_verification(verification);
    tracing::info!(
        data = %config.data.display(), boot = recovered.generation, unfinished_jobs = recovered.jobs,
        handed_back = recovered.leases, "opened the data folder"
    );
    let webhooks = webhooks(&config)?;
    let (left, leftovers) = mpsc::unbounded_channel();
    let farm = Arc::new(Farm {
        events: EventHub::new(queue.clone()),
        webhooks,
        queue,
        telemetry: Telemetry::new(config.data.clone(), &store, content.location()),
        content,
        reserve,
        jobs: JobCache::new(),
        admission,
        pool: Pool::new(config.pool_workers()),
        estimates: estimate::turns(),
        preview_helper: sketches,
        links,
        totals: ServerCounters::default(),
        orphans: left,
        is_shutting_down: CancellationToken::new(),
        shutdown: CancellationToken::new(),
        config,
    });
    Ok(Server { listeners: entrance, farm, store, orphans: leftovers, lock })
}

/// Opens the farm's store, which must be the one that the data folder records.
async fn open_store(config: &Config) -> Result<BlobStore, StartError> {
    let folder = |source| StartError::DataFolder { folder: config.data.clone(), source };
    let recorded = StoreLocation::recorded(&config.data).map_err(folder)?;
    let is_recorded = recorded != StoreLocation::Folder;
    if is_recorded && recorded != config.store {
        let given = config.store.clone();
        return Err(StartError::OtherStore { folder: config.data.clone(), recorded, given });
    }
    let opened = BlobStore::open(&config.store, &config.data, config.object_sweep_age).await;
    let content = opened.map_err(|error| match error {
        OpenStoreError::Folder(source) => folder(source),
        OpenStoreError::Bucket(error) => error.into(),
    })?;
    let has_pictures = || {
        let entries = std::fs::read_dir(ContentKind::Picture.path(&config.data));
        entries.is_ok_and(|mut entries| entries.next().is_some())
    };
    if content.folder().is_none() && !is_recorded && has_pictures() {
        tracing::warn!(store = %config.store, "the pictures in the data folder are not used: copy them to the store's pictures/, or they are rendered again");
    }
    config.store.record(&config.data).map_err(folder)?;
    Ok(content)
}

/// Creates the sender of webhooks, with the operator's secret or the data folder's own.
fn webhooks(config: &Config) -> Result<Webhooks, StartError> {
    let secret = match &config.webhook_secret {
        Some(secret) => secret.clone(),
        None => webhook_secret(&config.data)?,
    };
    Ok(Webhooks::new(AddressPolicy::new(&config.allowed_webhook_ranges), Signer::new(&secret)?))
}

fn database_error(file: PathBuf, error: OpenError) -> StartError {
    match error {
        OpenError::Sql(error) | OpenError::Migrate(sqlx::migrate::MigrateError::Execute(error)) => {
            explain_store(file, &error.into())
        }
        OpenError::Migrate(error) => StartError::Database { file, reason: error.to_string(), cure: UPGRADE_FIX },
        OpenError::Damaged(verdict) => {
            StartError::Database { file, reason: format!("it is damaged ({verdict})"), cure: RESTORE_FIX }
        }
    }
}

fn explain_store(file: PathBuf, error: &DatabaseError) -> StartError {
    let reason = match error {
        DatabaseError::Sql(error) => error.to_string(),
        DatabaseError::Rows { .. } | DatabaseError::Value { .. } | DatabaseError::Closed => error.to_string(),
    };
    let cure = if error.is_full() {
        MAKE_ROOM_FIX
    } else if error.is_corruption() {
        RESTORE_FIX
    } else {
        MAKE_WRITABLE_FIX
    };
    StartError::Database { file, reason, cure }
}
