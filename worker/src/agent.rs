//! Runs a worker: registers with a server, takes batches of tiles, renders and delivers them, until it is
//! drained or stopped.
//!
//! Stateless: if it is killed at any instant, its tiles are leased again.

mod back_off;
mod beside;
mod changes;
mod device_use;
mod executor;
mod job_cache;
mod metrics;
mod pending_sync;
mod rendering;
mod server_client;
mod session;
mod stitching;
mod store_access;
mod throughput;
mod upload;

use std::io::Read;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use proto::worker_protocol::{RegisterRequest, RegisterResponse};
use proto::{ClientAuth, ClientAuthError};
use tokio_util::sync::CancellationToken;

use crate::image::Encoders;
use crate::renderer::Renderer;
use back_off::BackOff;
use server_client::{ServerClient, ServerError};
use session::{Session, SessionEnd};

/// Settings of an agent.
#[derive(Clone, Debug)]
pub struct AgentConfig {
    /// Addresses of the farm's servers: `http://127.0.0.1:8080`. The next one is called once one cannot be reached.
    pub servers: Vec<String>,
    /// Label for display.
    pub name: String,
    /// Certificates and key for calling the server.
    pub auth: ClientAuth,
    /// Scratch folder for data that does not fit in memory, in unnamed files.
    pub scratch: PathBuf,
    /// Grace period: how long after a shutdown it continues its leases before it releases them.
    pub grace: Duration,
    /// Whether a server on this machine started it: then it exits at once when standard input closes, and
    /// writes directly into the server's folders. Folder paths from any other server are ignored.
    pub is_pool_worker: bool,
}

impl AgentConfig {
    /// Default settings, with this name and servers.
    pub fn new(servers: Vec<String>, name: impl Into<String>) -> Self {
        Self {
            servers,
            name: name.into(),
            auth: ClientAuth::default(),
            scratch: std::env::temp_dir(),
            grace: Duration::from_secs(8),
            is_pool_worker: false,
        }
    }
}

/// Works until the server drains the worker or `shutdown` is cancelled; then finishes or releases its leases.
/// Waits for a server that is unreachable.
pub async fn run(
    config: AgentConfig,
    renderer: Arc<dyn Renderer>,
    shutdown: CancellationToken,
) -> Result<(), AgentError> {
    if config.is_pool_worker {
        std::thread::spawn(exit_when_stdin_closes);
    }
    let encoders = Encoders::new(renderer.encoder_threads()).map_err(AgentError::Encoders)?;
    let link = Arc::new(ServerClient::new(&config.servers, config.auth.clone())?);
    loop {
        let registered = tokio::select! {
            registered = register(&link, &config, &*renderer) => registered?,
            () = shutdown.cancelled() => return Ok(()),
        };
        let session = Session::new(&config, registered, link.clone(), renderer.clone(), encoders.clone());
        match session.work(&shutdown).await.map_err(|error| rejected(&link, &error))? {
            SessionEnd::Drained => return Ok(()),
            SessionEnd::DeviceLost(reason) => return Err(AgentError::DeviceLost { reason }),
            SessionEnd::Stuck(reason) => return Err(AgentError::Stuck { reason }),
            SessionEnd::NotRegistered => tracing::warn!("the server no longer knows this worker; registering again"),
        }
    }
}

async fn register(
    link: &ServerClient,
    config: &AgentConfig,
    renderer: &dyn Renderer,
) -> Result<RegisterResponse, AgentError> {
    let hello = RegisterRequest {
        name: config.name.clone(),
        device: renderer.device(),
        picture_version: scene::PICTURE_VERSION,
        max_nodes: renderer.max_nodes(),
        process: std::process::id(),
    };
    let mut back_off = BackOff::new(Duration::from_millis(50), Duration::from_secs(2));
    let mut is_reported = false;
    loop {
        match link.register(&hello).await {
            Ok(welcome) => {
                tracing::info!(worker = %welcome.worker, server = link.address(), device = hello.device, "registered");
                return Ok(welcome);
            }
            Err(error) if error.is_transient() => {
                if !is_reported {
                    tracing::warn!(error = %error, server = link.address(), "waiting for a server: start one with `sdfarm serve`, or pass another address with --server");
                    is_reported = true;
                }
                back_off.pause().await;
            }
            Err(error) => return Err(rejected(link, &error)),
        }
    }
}

fn rejected(link: &ServerClient, error: &ServerError) -> AgentError {
    AgentError::Refused { server: link.address().to_owned(), reason: error.to_string() }
}

fn exit_when_stdin_closes() {
    let mut unread = [0; 256];
    let mut input = std::io::stdin().lock();
    loop {
        match input.read(&mut unread) {
            Ok(0) => std::process::exit(0),
            Ok(_) => {}
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(_) => std::process::exit(0),
        }
    }
}

/// Error that stops an agent.
#[derive(Debug, thiserror::Error)]
pub enum AgentError {
    /// The server's address is invalid.
    #[error(transparent)]
    Access(#[from] ClientAuthError),
    /// The HTTP client could not be built.
    #[error("could not prepare to call the server")]
    Client(#[source] reqwest::Error),
    /// The encoding threads could not be started.
    #[error("could not start the encoding threads")]
    Encoders(#[source] rayon::ThreadPoolBuildError),
    /// The server rejected the registration.
    #[error("the server {server} rejected this worker: {reason}")]
    Refused {
        /// The server.
        server: String,
        /// Reason.
        reason: String,
    },
    /// The device is lost; its leases have been released.
    #[error("the device is lost: {reason}")]
    DeviceLost {
        /// Reason.
        reason: String,
    },
    /// A render does not stop, so its process must exit; all leases have been released.
    #[error("{reason}: this worker exits, and its tiles are leased to others")]
    Stuck {
        /// Reason.
        reason: String,
    },
}
