//! A typed client of the users' HTTP API.
//!
//! It sends requests and names errors; display, retries and waiting are up to its caller.

mod farm;
mod health;
mod job_body;
mod jobs;
mod pictures;

use std::io::Write;
use std::time::Duration;

use reqwest::header::CACHE_CONTROL;
use reqwest::{Method, RequestBuilder, Response};
use serde::de::DeserializeOwned;

use crate::audit::AuditPage;
use crate::client_auth::{ClientAuth, ClientAuthError, server_url};
use crate::farm::FarmView;
use crate::job::{DryRun, JobPage, JobState, JobView};
use crate::pool::{PoolSize, PoolView};
use crate::price::Price;
use crate::scaling::ScalingView;
use crate::{JobId, Problem};

pub use farm::WorkerChange;
pub use jobs::{EventStream, SubmitOptions};

const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);
/// Timeout: every route of the users' API sends something sooner.
const READ_TIMEOUT: Duration = Duration::from_mins(2);
/// Maximum length of an unexpected response in an error, in characters.
const MAX_QUOTED_CHARS: usize = 200;

/// Error of a request, or the server's rejection.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The server rejected the request.
    #[error("{}", .0.detail)]
    Problem(Box<Problem>),
    /// No server listens there.
    #[error("no server responds at {server}: start one with `sdfarm serve`, or pass another address with --server")]
    Unreachable {
        /// The address that was tried.
        server: String,
        /// Error of the connection.
        #[source]
        source: reqwest::Error,
    },
    /// The server's address, the key or the CA certificates are invalid.
    #[error(transparent)]
    Auth(#[from] ClientAuthError),
    /// The connection was interrupted, or the server was silent for too long.
    #[error("the connection to {server} was interrupted: see the server's log, and retry")]
    ConnectionLost {
        /// The address.
        server: String,
        /// Error of the connection.
        #[source]
        source: reqwest::Error,
    },
    /// The response is not one of an sdfarm server.
    #[error("{server} responded {status}, but is not an sdfarm server ({body:?}): check --server")]
    UnexpectedResponse {
        /// The address.
        server: String,
        /// The HTTP status.
        status: u16,
        /// Beginning of the response.
        body: String,
    },
    /// A picture arrived, but could not be written.
    #[error("could not write the picture")]
    Write(#[source] std::io::Error),
}

impl ClientError {
    /// The problem's stable code, if the server responded with a problem.
    pub fn code(&self) -> Option<&str> {
        match self {
            Self::Problem(problem) => Some(&problem.code),
            Self::Unreachable { .. }
            | Self::Auth(_)
            | Self::ConnectionLost { .. }
            | Self::UnexpectedResponse { .. }
            | Self::Write(_) => None,
        }
    }
}

/// Client of one server.
#[derive(Clone, Debug)]
pub struct Client {
    http: reqwest::Client,
    server: String,
    access: ClientAuth,
}

impl Client {
    /// Client without a key for the server at `http://HOST:PORT`; sends nothing yet.
    pub fn new(server: &str) -> Result<Self, ClientError> {
        Self::with_auth(server, ClientAuth::default())
    }

    /// Client for the server at `http://HOST:PORT` or `https://HOST:PORT`; sends nothing yet.
    pub fn with_auth(server: &str, access: ClientAuth) -> Result<Self, ClientError> {
        let url = server_url(server)?;
        let server = server.trim_end_matches('/');
        let http = access
            .client(&url)
            .connect_timeout(CONNECT_TIMEOUT)
            .read_timeout(READ_TIMEOUT)
            .build()
            .map_err(|source| ClientError::ConnectionLost { server: server.to_owned(), source })?;
        Ok(Self { http, server: server.to_owned(), access })
    }

    /// The server's address, without a trailing slash.
    pub fn server(&self) -> &str {
        &self.server
    }

    /// Submits a job file. With `no_cache` it is rendered even if its pictures are already stored.
    pub async fn submit(&self, job: Vec<u8>, no_cache: bool) -> Result<JobView, ClientError> {
        let request = job_body::attach(self.request(Method::POST, "/v1/jobs"), job);
        let request = if no_cache { request.header(CACHE_CONTROL, "no-cache") } else { request };
        self.json(request).await
    }

    /// Validates a job file without submitting it.
    pub async fn dry_run(&self, job: Vec<u8>) -> Result<DryRun, ClientError> {
        let request = self.request(Method::POST, "/v1/jobs").query(&[("dry_run", "true")]);
        self.json(job_body::attach(request, job)).await
    }

    /// Price of a job on the farm's workers, with a map of its time if asked for.
    pub async fn price(&self, job: Vec<u8>, has_map: bool) -> Result<Price, ClientError> {
        let request = self.request(Method::POST, "/v1/price").query(&[("map", has_map)]);
        self.json(job_body::attach(request, job)).await
    }

    /// Reads a job.
    pub async fn job(&self, id: JobId) -> Result<JobView, ClientError> {
        self.json(self.request(Method::GET, &format!("/v1/jobs/{id}"))).await
    }

    /// A page of jobs, newest first; `cursor` is the `next_cursor` of the page before.
    pub async fn jobs(
        &self,
        state: Option<JobState>,
        limit: u32,
        cursor: Option<&str>,
    ) -> Result<JobPage, ClientError> {
        let mut request = self.request(Method::GET, "/v1/jobs").query(&[("limit", limit)]);
        if let Some(state) = state {
            request = request.query(&[("state", state.name())]);
        }
        if let Some(cursor) = cursor {
            request = request.query(&[("cursor", cursor)]);
        }
        self.json(request).await
    }

    /// Cancels a job.
    pub async fn cancel(&self, id: JobId) -> Result<JobView, ClientError> {
        self.json(self.request(Method::POST, &format!("/v1/jobs/{id}/cancel"))).await
    }

    /// Pauses a job: no more of its tiles are leased until it is resumed.
    pub async fn pause(&self, id: JobId) -> Result<JobView, ClientError> {
        self.json(self.request(Method::POST, &format!("/v1/jobs/{id}/pause"))).await
    }

    /// Resumes a paused job.
    pub async fn resume(&self, id: JobId) -> Result<JobView, ClientError> {
        self.json(self.request(Method::POST, &format!("/v1/jobs/{id}/resume"))).await
    }

    /// State of the farm.
    pub async fn farm(&self) -> Result<FarmView, ClientError> {
        self.json(self.request(Method::GET, "/v1/farm")).await
    }

    /// Pauses the farm: no more tiles are leased until it is resumed.
    pub async fn pause_farm(&self) -> Result<FarmView, ClientError> {
        self.json(self.request(Method::POST, "/v1/farm/pause")).await
    }

    /// Resumes a paused farm.
    pub async fn resume_farm(&self) -> Result<FarmView, ClientError> {
        self.json(self.request(Method::POST, "/v1/farm/resume")).await
    }

    /// Deletes a job that is not running.
    pub async fn delete(&self, id: JobId) -> Result<(), ClientError> {
        self.send(self.request(Method::DELETE, &format!("/v1/jobs/{id}"))).await.map(|_| ())
    }

    /// Writes a frame's stored picture to `out` as it arrives; returns its size in bytes.
    pub async fn image(&self, id: JobId, frame: u32, out: &mut (dyn Write + Send)) -> Result<u64, ClientError> {
        self.download(self.request(Method::GET, &format!("/v1/jobs/{id}/frames/{frame}/image")), out).await
    }

    async fn download(&self, request: RequestBuilder, out: &mut (dyn Write + Send)) -> Result<u64, ClientError> {
        let mut response = self.send(request).await?;
        let mut size_bytes = 0;
        while let Some(chunk) = response.chunk().await.map_err(|source| self.connection_lost(source))? {
            out.write_all(&chunk).map_err(ClientError::Write)?;
            size_bytes += chunk.len() as u64;
        }
        Ok(size_bytes)
    }

    /// State of the local pool.
    pub async fn pool(&self) -> Result<PoolView, ClientError> {
        self.json(self.request(Method::GET, "/v1/pool")).await
    }

    /// Workers that would finish the backlog in time, by kind of device.
    pub async fn scaling(&self) -> Result<ScalingView, ClientError> {
        self.json(self.request(Method::GET, "/v1/scaling")).await
    }

    /// Sets the target number of workers of the local pool.
    pub async fn set_pool(&self, size: PoolSize) -> Result<PoolView, ClientError> {
        self.json(self.request(Method::PUT, "/v1/pool").json(&size)).await
    }

    /// A page of the audit log, newest first; `cursor` is the `next_cursor` of the page before.
    pub async fn audit(&self, limit: u32, cursor: Option<&str>) -> Result<AuditPage, ClientError> {
        let request = self.request(Method::GET, "/v1/audit").query(&[("limit", limit)]);
        self.json(match cursor {
            Some(cursor) => request.query(&[("cursor", cursor)]),
            None => request,
        })
        .await
    }

    fn request(&self, method: Method, path: &str) -> RequestBuilder {
        self.access.authorize(self.http.request(method, format!("{}{path}", self.server)))
    }

    async fn json<T: DeserializeOwned>(&self, request: RequestBuilder) -> Result<T, ClientError> {
        let response = self.send(request).await?;
        let status = response.status().as_u16();
        let body = response.bytes().await.map_err(|source| self.connection_lost(source))?;
        serde_json::from_slice(&body).map_err(|_| self.unexpected_response(status, &body))
    }

    /// Sends a request; an unsuccessful response is an error.
    async fn send(&self, request: RequestBuilder) -> Result<Response, ClientError> {
        let response = request.send().await.map_err(|source| {
            if source.is_connect() {
                ClientError::Unreachable { server: self.server.clone(), source }
            } else {
                self.connection_lost(source)
            }
        })?;
        if response.status().is_success() {
            return Ok(response);
        }
        let status = response.status().as_u16();
        let body = response.bytes().await.map_err(|source| self.connection_lost(source))?;
        Err(match serde_json::from_slice(&body) {
            Ok(problem) => ClientError::Problem(Box::new(problem)),
            Err(_) => self.unexpected_response(status, &body),
        })
    }

    fn connection_lost(&self, source: reqwest::Error) -> ClientError {
        ClientError::ConnectionLost { server: self.server.clone(), source }
    }

    fn unexpected_response(&self, status: u16, body: &[u8]) -> ClientError {
        let body = String::from_utf8_lossy(body).chars().take(MAX_QUOTED_CHARS).collect();
        ClientError::UnexpectedResponse { server: self.server.clone(), status, body }
    }
}
