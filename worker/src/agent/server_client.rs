//! A worker's requests to its server, one function each. Nothing here retries or decides.

use std::fs::File;
use std::io::{self, Seek};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use bytes::Bytes;
use proto::client_auth::server_url;
use proto::worker_protocol::{self, RegisterRequest, RegisterResponse, SyncRequest, SyncResponse};
use proto::{ClientAuth, JobId, Problem};
use reqwest::{Body, Client, Method, RequestBuilder, Response, StatusCode, header};
use serde::de::DeserializeOwned;
use tokio_util::io::ReaderStream;

use super::AgentError;

/// Timeout for responses that the server sends at once.
const SHORT_TIMEOUT: Duration = Duration::from_secs(10);
/// Timeout for transfers of bytes, also over a slow connection.
const TRANSFER_TIMEOUT: Duration = Duration::from_mins(10);

/// Bytes of a picture.
#[derive(Debug)]
pub(super) enum PictureBytes {
    /// In memory.
    Memory(Bytes),
    /// In an unnamed file.
    File(File),
}

impl PictureBytes {
    /// Another reader of the same bytes.
    pub(super) fn try_clone(&self) -> io::Result<Self> {
        Ok(match self {
            Self::Memory(bytes) => Self::Memory(bytes.clone()),
            Self::File(file) => Self::File(file.try_clone()?),
        })
    }
}

/// Client of a farm: calls one of its servers, and the next one once that cannot be reached.
#[derive(Debug)]
pub(super) struct ServerClient {
    servers: Vec<Server>,
    /// Number of changes of the server.
    changes: AtomicUsize,
    access: ClientAuth,
}

/// One server.
#[derive(Debug)]
struct Server {
    client: Client,
    url: String,
}

/// A request, and the number of changes before it.
struct ServerRequest {
    request: RequestBuilder,
    changes: usize,
}

impl ServerRequest {
    fn with(self, change: impl FnOnce(RequestBuilder) -> RequestBuilder) -> Self {
        Self { request: change(self.request), ..self }
    }
}

impl ServerClient {
    pub(super) fn new(servers: &[String], access: ClientAuth) -> Result<Self, AgentError> {
        let connect = |server: &String| {
            let builder = access.client(&server_url(server)?);
            let client = builder.no_proxy().connect_timeout(SHORT_TIMEOUT).build().map_err(AgentError::Client)?;
            Ok(Server { client, url: server.trim_end_matches('/').to_owned() })
        };
        let servers = servers.iter().map(connect).collect::<Result<Vec<_>, AgentError>>()?;
        Ok(Self { servers, changes: AtomicUsize::new(0), access })
    }

    /// Address of the server that is called now.
    pub(super) fn address(&self) -> &str {
        &self.server(self.changes.load(Ordering::Relaxed)).url
    }

    fn server(&self, changes: usize) -> &Server {
        &self.servers[changes % self.servers.len()]
    }

    pub(super) async fn register(&self, hello: &RegisterRequest) -> Result<RegisterResponse, ServerError> {
        let request = self.request(Method::POST, worker_protocol::REGISTER_PATH, SHORT_TIMEOUT);
        self.read_json(request.with(|request| request.json(hello))).await
    }

    pub(super) async fn sync(&self, sync: &SyncRequest, timeout: Duration) -> Result<SyncResponse, ServerError> {
        let request = self.request(Method::POST, worker_protocol::SYNC_PATH, timeout);
        self.read_json(request.with(|request| request.json(sync))).await
    }

    pub(super) async fn job(&self, job: JobId) -> Result<Bytes, ServerError> {
        let request = self.request(Method::GET, &worker_protocol::job_path(job), TRANSFER_TIMEOUT);
        Ok(self.send(request).await?.bytes().await?)
    }

    pub(super) async fn put_blob(&self, hash: &str, bytes: Bytes) -> Result<(), ServerError> {
        let request = self.request(Method::PUT, &worker_protocol::blob_path(hash), TRANSFER_TIMEOUT);
        self.send(request.with(|request| request.body(bytes))).await.map(drop)
    }

    /// Fetches a blob; `None` if the server's blob is not longer than `size_bytes` but has other bytes.
    pub(super) async fn blob(&self, hash: &str, size_bytes: u64) -> Result<Option<Vec<u8>>, ServerError> {
        let request = self.request(Method::GET, &worker_protocol::blob_path(hash), TRANSFER_TIMEOUT);
        let mut response = self.send(request).await?;
        let mut bytes = Vec::new();
        while let Some(chunk) = response.chunk().await? {
            if (bytes.len() + chunk.len()) as u64 > size_bytes {
                return Ok(None);
            }
            bytes.extend_from_slice(&chunk);
        }
        Ok((bytes.len() as u64 == size_bytes).then_some(bytes))
    }

    pub(super) async fn put_picture(
        &self,
        hash: &str,
        content: &PictureBytes,
        size_bytes: u64,
    ) -> Result<(), ServerError> {
        let body = match content.try_clone()? {
            PictureBytes::Memory(bytes) => Body::from(bytes),
            PictureBytes::File(mut file) => {
                file.rewind()?;
                Body::wrap_stream(ReaderStream::with_capacity(tokio::fs::File::from_std(file), 1 << 18))
            }
        };
        let request = self.request(Method::PUT, &worker_protocol::picture_path(hash), TRANSFER_TIMEOUT);
        let request = request.with(|request| request.header(header::CONTENT_LENGTH, size_bytes).body(body));
        self.send(request).await.map(drop)
    }

    fn request(&self, method: Method, path: &str, timeout: Duration) -> ServerRequest {
        let changes = self.changes.load(Ordering::Relaxed);
        let Server { client, url } = self.server(changes);
        let request = client.request(method, format!("{url}{path}")).timeout(timeout);
        let request = self.access.authorize(match proto::trace_context::current_traceparent() {
            Some(trace) => request.header(proto::trace_context::TRACEPARENT, trace),
            None => request,
        });
        ServerRequest { request, changes }
    }

    async fn read_json<T: DeserializeOwned>(&self, request: ServerRequest) -> Result<T, ServerError> {
        let changes = request.changes;
        let body = self.send(request).await?.bytes().await;
        let body = body.map_err(ServerError::from).inspect_err(|_| self.leave(changes))?;
        serde_json::from_slice(&body).map_err(ServerError::InvalidResponse)
    }

    async fn send(&self, request: ServerRequest) -> Result<Response, ServerError> {
        let sent = send(request.request).await;
        if sent.as_ref().is_err_and(ServerError::is_unavailable) {
            self.leave(request.changes);
        }
        sent
    }

    /// Calls the next server from now on, unless another call has changed it already.
    fn leave(&self, changes: usize) {
        let next = changes.wrapping_add(1);
        if self.changes.compare_exchange(changes, next, Ordering::Relaxed, Ordering::Relaxed).is_ok()
            && self.servers.len() > 1
        {
            tracing::warn!(
                server = self.server(changes).url,
                next = self.server(next).url,
                "the server cannot be reached"
            );
        }
    }
}

async fn send(request: RequestBuilder) -> Result<Response, ServerError> {
    let response = request.send().await?;
    let status = response.status();
    if status.is_success() {
        return Ok(response);
    }
    let body = response.bytes().await.unwrap_or_default();
    let detail = match serde_json::from_slice::<Problem>(&body) {
        Ok(problem) => problem.detail,
        Err(_) => status.to_string(),
    };
    Err(ServerError::Status { status, detail })
}

/// Error of a call.
#[derive(Debug, thiserror::Error)]
pub(super) enum ServerError {
    /// No response.
    #[error("the server cannot be reached: {0}")]
    Unreachable(#[from] reqwest::Error),
    /// An error response.
    #[error("{detail}")]
    Status {
        /// The status.
        status: StatusCode,
        /// The server's message.
        detail: String,
    },
    /// The response is not valid.
    #[error("the server's response cannot be read: {0}")]
    InvalidResponse(#[source] serde_json::Error),
    /// The file to send can't be read.
    #[error("the file to send cannot be read: {0}")]
    File(#[from] io::Error),
    /// The server's own folders can't be written to or read.
    #[error("the server's folders cannot be used: {0}")]
    Store(#[source] io::Error),
}

impl ServerError {
    /// Whether repeating the call later may succeed.
    pub(super) fn is_transient(&self) -> bool {
        match self {
            Self::Unreachable(_) => true,
            Self::Status { status, .. } => {
                status.is_server_error()
                    || [StatusCode::REQUEST_TIMEOUT, StatusCode::TOO_MANY_REQUESTS].contains(status)
            }
            Self::InvalidResponse(_) | Self::File(_) | Self::Store(_) => false,
        }
    }

    /// Whether the server is unreachable or starting, rather than rejecting the call.
    pub(super) fn is_unavailable(&self) -> bool {
        match self {
            Self::Unreachable(_) => true,
            Self::Status { status, .. } => {
                [StatusCode::SERVICE_UNAVAILABLE, StatusCode::BAD_GATEWAY, StatusCode::GATEWAY_TIMEOUT].contains(status)
            }
            Self::InvalidResponse(_) | Self::File(_) | Self::Store(_) => false,
        }
    }

    /// Whether the server does not know the requested item or the worker.
    pub(super) fn is_not_found(&self) -> bool {
        matches!(self, Self::Status { status, .. } if [StatusCode::NOT_FOUND, StatusCode::GONE].contains(status))
    }

    /// Whether the server's state has changed so that the call's lease or batch is no longer this worker's.
    pub(super) fn is_conflict(&self) -> bool {
        matches!(self, Self::Status { status, .. } if *status == StatusCode::CONFLICT)
    }
}
