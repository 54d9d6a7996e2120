//! Client requests about one job: submitting it idempotently, following its events, changing it, fetching its
//! frames.

use std::io::Write;

use reqwest::header::{ACCEPT, CACHE_CONTROL, CONTENT_TYPE, HeaderValue};
use reqwest::{Method, Response, StatusCode};

use super::{Client, ClientError, job_body};
use crate::event::{JobEvent, SseMessage, SseParser};
use crate::frame::FramePage;
use crate::job::{DeleteDryRun, JobMove, JobPatch};
use crate::job::{JobPage, JobView};
use crate::{JobId, Retention};

/// Options of a submission.
#[derive(Clone, Debug, Default)]
pub struct SubmitOptions {
    /// Render it even if its pictures are stored already.
    pub no_cache: bool,
    /// Idempotency key: repeating the request with it returns the same job.
    pub idempotency_key: Option<String>,
    /// Webhook addresses to notify when it has finished.
    pub webhooks: Vec<String>,
    /// Retention after it finishes; `None` means the server's default.
    pub keep: Option<Retention>,
    /// Time limit for rendering a tile, in seconds; `None` means the server's maximum.
    pub tile_seconds: Option<u32>,
    /// Keep its tiles, so that another job may be based on it.
    pub record: bool,
    /// A recorded job, whose pixels it keeps where they can't differ.
    pub based_on: Option<JobId>,
}

/// Stream of a job's events.
#[derive(Debug)]
pub struct EventStream {
    client: Client,
    response: Response,
    lines: SseParser,
    ready: std::collections::VecDeque<SseMessage>,
    last_id: Option<String>,
}

impl EventStream {
    /// Next event of a type that this version knows; `None` when the server has ended the stream.
    pub async fn next(&mut self) -> Result<Option<JobEvent>, ClientError> {
        loop {
            while let Some(message) = self.ready.pop_front() {
                if message.id.is_some() {
                    self.last_id = message.id;
                }
                if let Some(event) = JobEvent::parse(&message.event, &message.data) {
                    return Ok(Some(event));
                }
            }
            let chunk = self.response.chunk().await.map_err(|source| self.client.connection_lost(source))?;
            let Some(chunk) = chunk else { return Ok(None) };
            self.ready.extend(self.lines.push(&chunk));
        }
    }

    /// Id of the last event, from which the stream can be resumed.
    pub fn last_id(&self) -> Option<&str> {
        self.last_id.as_deref()
    }
}

impl Client {
    /// Submits a job file.
    pub async fn submit_with(&self, job: Vec<u8>, options: &SubmitOptions) -> Result<JobView, ClientError> {
        let mut request = job_body::attach(self.request(Method::POST, "/v1/jobs"), job);
        if options.no_cache {
            request = request.header(CACHE_CONTROL, "no-cache");
        }
        if let Some(key) = &options.idempotency_key {
            request = request.header("idempotency-key", key);
        }
        if let Some(keep) = options.keep {
            request = request.query(&[("keep", keep.to_string())]);
        }
        if let Some(limit) = options.tile_seconds {
            request = request.query(&[("tile_seconds", limit)]);
        }
        if options.record {
            request = request.query(&[("record", true)]);
        }
        if let Some(id) = options.based_on {
            request = request.query(&[("based_on", id.to_string())]);
        }
        for webhook in &options.webhooks {
            request = request.query(&[("webhook", webhook)]);
        }
        self.json(request).await
    }

    /// Subscribes to a job's events, from the first or after the given one; `None` if no event will follow that
    /// one.
    pub async fn events(&self, id: JobId, after: Option<&str>) -> Result<Option<EventStream>, ClientError> {
        let mut request =
            self.request(Method::GET, &format!("/v1/jobs/{id}/events")).header(ACCEPT, "text/event-stream");
        if let Some(after) = after {
            request = request.header("last-event-id", after);
        }
        let response = self.send(request).await?;
        if response.status() == StatusCode::NO_CONTENT {
            return Ok(None);
        }
        let kind = response.headers().get(CONTENT_TYPE).map(HeaderValue::as_bytes);
        if !kind.is_some_and(|kind| kind.starts_with(b"text/event-stream")) {
            return Err(self.unexpected_response(response.status().as_u16(), b"no event stream"));
        }
        Ok(Some(EventStream {
            client: self.clone(),
            response,
            lines: SseParser::default(),
            ready: std::collections::VecDeque::new(),
            last_id: after.map(ToOwned::to_owned),
        }))
    }

    /// Requeues a failed job's dead tiles.
    pub async fn retry(&self, id: JobId) -> Result<JobView, ClientError> {
        self.json(self.request(Method::POST, &format!("/v1/jobs/{id}/retry"))).await
    }

    /// Changes a job.
    pub async fn patch(&self, id: JobId, patch: &JobPatch) -> Result<JobView, ClientError> {
        self.json(self.request(Method::PATCH, &format!("/v1/jobs/{id}")).json(patch)).await
    }

    /// Moves a job in the queue.
    pub async fn reorder_job(&self, id: JobId, place: &JobMove) -> Result<JobView, ClientError> {
        self.json(self.request(Method::POST, &format!("/v1/jobs/{id}/move")).json(place)).await
    }

    /// Jobs that match a name, a part of an id, or `latest`, newest first.
    pub async fn jobs_like(&self, text: &str, limit: u32) -> Result<JobPage, ClientError> {
        let limit = limit.to_string();
        self.json(self.request(Method::GET, "/v1/jobs").query(&[("match", text), ("limit", &limit)])).await
    }

    /// Writes a job's file to `out`; returns its size in bytes.
    pub async fn file(&self, id: JobId, out: &mut (dyn Write + Send)) -> Result<u64, ClientError> {
        self.download(self.request(Method::GET, &format!("/v1/jobs/{id}/file")), out).await
    }

    /// Submits a job's file again, changed by a JSON merge patch (RFC 7396) if there is one.
    pub async fn resubmit(&self, id: JobId, patch: Option<String>, no_cache: bool) -> Result<JobView, ClientError> {
        let mut request = self.request(Method::POST, &format!("/v1/jobs/{id}/resubmit"));
        if let Some(patch) = patch {
            request = request.header(CONTENT_TYPE, "application/merge-patch+json").body(patch);
        }
        if no_cache {
            request = request.header(CACHE_CONTROL, "no-cache");
        }
        self.json(request).await
    }

    /// Dry run of a deletion: the contents that it would remove.
    pub async fn delete_dry_run(&self, id: JobId) -> Result<DeleteDryRun, ClientError> {
        self.json(self.request(Method::DELETE, &format!("/v1/jobs/{id}")).query(&[("dry_run", "true")])).await
    }

    /// A page of a job's frames; `cursor` is the `next_cursor` of the page before.
    pub async fn frames(&self, id: JobId, cursor: Option<&str>) -> Result<FramePage, ClientError> {
        let request = self.request(Method::GET, &format!("/v1/jobs/{id}/frames")).query(&[("limit", "1000")]);
        self.json(match cursor {
            Some(cursor) => request.query(&[("cursor", cursor)]),
            None => request,
        })
        .await
    }

    /// Writes all of a job's pictures to `out` as one ZIP archive; returns its size in bytes.
    pub async fn archive(&self, id: JobId, partial: bool, out: &mut (dyn Write + Send)) -> Result<u64, ClientError> {
        let request = self.request(Method::GET, &format!("/v1/jobs/{id}/frames.zip"));
        let request = if partial { request.query(&[("partial", "true")]) } else { request };
        let mut response = self.send(request).await?;
        let mut size_bytes = 0;
        while let Some(chunk) = response.chunk().await.map_err(|source| self.connection_lost(source))? {
            out.write_all(&chunk).map_err(ClientError::Write)?;
            size_bytes += chunk.len() as u64;
        }
        Ok(size_bytes)
    }
}
