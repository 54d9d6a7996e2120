//! Startup: checks everything in the server's environment before it serves; each problem has an error with its
//! fix.
//!
//! It opens everything that can fail; `services` connects it.

mod database;
mod services;

use std::io::{self, Write};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::api_keys::ApiKeys;
use crate::audit_log::AuditLog;
use crate::blobs::{BlobStore, BucketError, ClaimError, ContentKind, OpenStoreError, StoreLocation};
use crate::clock::Clock;
use crate::config::Config;
use crate::db::{Database, DatabaseError};
use crate::http::ApiState;
use crate::listen::{ListenError, Listeners};
use crate::lock::{FolderLock, LockError};
use crate::pool::Pool;
use crate::preview_helper::PreviewHelper;
use crate::private_files::{self, ExposedFile};
use crate::queue::{Queue, VerificationPolicy};
use crate::shutdown::Shutdown;
use crate::signed_links::LinkSigner;
use crate::space_reserve::SpaceReserve;
use crate::webhooks::{AddressPolicy, SecretError, Signer, webhook_secret};
pub(crate) use services::BackgroundTasks;
use services::{Foundation, Opened};

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
    /// Another farm's pictures are in the store.
    #[error(transparent)]
    Claim(#[from] ClaimError),
    /// The farm's pictures are in another store.
    #[error(
        "the farm in {folder} has its pictures in {recorded}, not in {given}: start it with the store it has \
         (--store s3://BUCKET/PREFIX, none for the data folder), or stop all its servers and move the pictures (sdfarm move \
         --data {folder} --store-to s3://BUCKET/PREFIX, or folder); on the machines of its other servers, remove the file \
         `store` of the data folder then"
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
    #[error("the database {database} cannot be used: {reason}; {cure}")]
    Database {
        /// The file, or the address.
        database: String,
        /// Reason.
        reason: String,
        /// Fix.
        cure: &'static str,
    },
    /// The farm's database is another one.
    #[error(
        "the farm in {folder} has its database in {recorded}, not in {given}: start it with the database it has \
         (--database postgres://USER@HOST/NAME, none for the file in the data folder), or pass another folder with --data"
    )]
    OtherDatabase {
        /// The data folder.
        folder: PathBuf,
        /// Database that the folder records.
        recorded: String,
        /// Database in the configuration.
        given: String,
    },
    /// Servers that run have another cluster secret.
    #[error(
        "other servers of this database run with another cluster secret: give all the same SDFARM_CLUSTER_SECRET, or \
         stop them all to change it"
    )]
    OtherSecret,
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

impl From<ListenError> for StartError {
    fn from(error: ListenError) -> Self {
        match error {
            ListenError::Tls(error) => Self::Tls(error.to_string()),
            ListenError::Bind { address, source } => Self::Listen { address, source },
        }
    }
}

/// A server that has locked its data folder, opened its database and bound its address.
#[derive(Debug)]
pub(crate) struct Started {
    /// Settings of the operator.
    pub(crate) config: Arc<Config>,
    /// Bound addresses.
    pub(crate) listeners: Listeners,
    /// State of the router.
    pub(crate) state: ApiState,
    /// Background tasks, not running yet.
    pub(crate) tasks: BackgroundTasks,
    /// Local workers, not running yet.
    pub(crate) pool: Arc<Pool>,
    /// The queue.
    pub(crate) queue: Queue,
    /// Stages of the shutdown.
    pub(crate) shutdown: Shutdown,
    /// The database.
    pub(crate) database: Arc<Database>,
    // Dropped last, so that the lock is held until everything is closed.
    /// Lock of the data folder.
    pub(crate) lock: FolderLock,
}

/// Starts everything but tasks and local workers: locks the data folder, opens the database, and binds the address.
pub(crate) async fn start(config: Config, clock: Clock) -> Result<Started, StartError> {
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
    let links = match &config.cluster_secret {
        Some(secret) => LinkSigner::new(secret.for_links()),
        None => LinkSigner::open(&config.data).map_err(folder)?,
    };
    let server_name = match &config.database {
        Some(_) => server_name(&config.data).map_err(folder)?,
        None => "local".to_owned(),
    };
    let preview_helper = PreviewHelper::open(&config.data, &config.worker_program).map_err(folder)?;
    let listeners = Listeners::open(&config).await?;
    let explain = database::explainer(&config);
    let database = Arc::new(database::open(&config).await?);
    if let Err(error) = claim_store(&config, &database, &content).await {
        database.close().await;
        return Err(error);
    }
    let clock = clock.or_shared(database.shared_time());
    let open_keys = async || ApiKeys::open(Arc::clone(&database), clock.clone()).await;
    let api_keys = database::patiently(DatabaseError::is_unreachable, open_keys).await.map_err(&explain)?;
    if !listeners.address().ip().is_loopback() && !config.insecure && api_keys.live() == 0 {
        database.close().await;
        return Err(StartError::NoKeysBeyondLoopback(config.listen));
    }
    let audit_log = AuditLog::new(Arc::clone(&database), clock.clone());
    let queue = open_queue(&config, Arc::clone(&database), clock, &server_name).await.map_err(&explain)?;
    if let Some(secret) = &config.cluster_secret
        && !queue.agrees_on_secret(secret.fingerprint()).await.map_err(&explain)?
    {
        queue.end_server().await.map_err(&explain)?;
        database.close().await;
        return Err(StartError::OtherSecret);
    }
    let webhook_addresses = Arc::new(AddressPolicy::new(&config.allowed_webhook_ranges));
    let signer = webhook_signer(&config)?;
    let foundation = Foundation {
        queue: queue.clone(),
        content: Arc::new(content),
        reserve: Arc::new(reserve),
        preview_helper: Arc::new(preview_helper),
        counters: Arc::default(),
        config: Arc::new(config),
    };
    Ok(foundation.connect(Opened { listeners, database, api_keys, audit_log, links, webhook_addresses, signer, lock }))
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
    Ok(content)
}

/// Makes the store that of the database's farm, and records it in the data folder.
async fn claim_store(config: &Config, database: &Database, content: &BlobStore) -> Result<(), StartError> {
    let id = async || database.farm_id().await;
    let farm = database::patiently(DatabaseError::is_unreachable, id).await.map_err(database::explainer(config))?;
    content.claim(farm).await?;
    let folder = |source| StartError::DataFolder { folder: config.data.clone(), source };
    config.store.record(&config.data).map_err(folder)
}

/// Opens the queue, and repairs the state that the last server left.
async fn open_queue(
    config: &Config,
    database: Arc<Database>,
    clock: Clock,
    server_name: &str,
) -> Result<Queue, DatabaseError> {
    let lease_ms = i64::try_from(config.lease.as_millis()).unwrap_or(i64::MAX / 4).max(1);
    let open = async || Queue::open(Arc::clone(&database), clock.clone(), lease_ms, server_name).await;
    let (queue, recovered) = database::patiently(DatabaseError::is_unreachable, open).await?;
    tracing::info!(
        data = %config.data.display(), boot = recovered.generation, unfinished_jobs = recovered.jobs,
        handed_back = recovered.leases, "opened the data folder"
    );
    Ok(queue.with_verification(VerificationPolicy {
        share: config.verify_share,
        new_worker_ms: i64::try_from(config.verify_new.as_millis()).unwrap_or(i64::MAX / 4),
    }))
}

/// Signs with the operator's secret or the data folder's own.
fn webhook_signer(config: &Config) -> Result<Signer, StartError> {
    let secret = match (&config.webhook_secret, &config.cluster_secret) {
        (Some(secret), _) => secret.clone(),
        (None, Some(shared)) => shared.for_webhooks(),
        (None, None) => webhook_secret(&config.data)?,
    };
    Ok(Signer::new(&secret)?)
}

/// Name of the server with this data folder: its host's, and a random part that the folder keeps.
fn server_name(data: &Path) -> io::Result<String> {
    let file = data.join(private_files::SERVER_NAME_FILE);
    match std::fs::read_to_string(&file) {
        Ok(name) if !name.trim().is_empty() => return Ok(name.trim().to_owned()),
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        Ok(_) | Err(_) => {}
    }
    let host = rustix::system::uname().nodename().to_string_lossy().into_owned();
    let name = format!("{host}-{}", &uuid::Uuid::new_v4().simple().to_string()[..12]);
    private_files::create_file(&file)?.write_all(format!("{name}\n").as_bytes())?;
    Ok(name)
}
