//! The workers' protocol, `/v1/worker/`: see `proto::worker_protocol`. Not for users.

use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures_util::TryStreamExt;
use proto::WorkerId;
use proto::fail_point::{self, FailPoint};
use proto::worker_protocol::{
    ContentFolders, MAX_BATCHES, RegisterRequest, RegisterResponse, SyncRequest, SyncResponse, TracedBatch,
};
use tracing::Instrument;

use crate::blobs::{BlobStore, ContentHash, ContentKind, WRITE_CHUNK_BYTES};
use crate::clock::monotonic_now;
use crate::http::auth::{Caller, KEYLESS_SUBMITTER};
use crate::http::body::{self, RequestBody};
use crate::http::error::ApiError;
use crate::http::jobs::job_id;
use crate::http::state::handle_group;
use crate::http::workers::trace_context;
use crate::orphans::Orphans;
use crate::pool::Pool;
use crate::queue::{
    LeaseNeed, MAX_WORKERS_OF_KEY, NewWorker, NextWork, PassedJobs, Queue, SyncInput, SyncOutcome, UploadNeed,
};
use crate::shutdown::Shutdown;
use crate::space_reserve::SpaceReserve;
use crate::telemetry::Telemetry;
use crate::upload_ledger::UploadLedger;
use crate::worker_sync::WorkerSync;

/// Maximum size of a registration; valid ones are smaller.
const MAX_REGISTER_BYTES: usize = 16 << 10;
/// Maximum size of a sync; the results of the largest frame fit.
const MAX_SYNC_BYTES: usize = 384 << 10;
/// Maximum time that a sync waits for work.
const MAX_WAIT: Duration = Duration::from_secs(30);
/// Maximum wait of a draining worker that still has leases.
const MAX_DRAINING_WAIT: Duration = Duration::from_millis(250);

handle_group! {
    /// Handles of registrations.
    Registrar {
        /// Has the workers.
        queue: Queue,
        /// Knows the local workers.
        pool: Arc<Pool>,
        /// Shows their devices.
        telemetry: Arc<Telemetry>,
        /// Has the folders that they write to.
        content: Arc<BlobStore>,
    }
}

handle_group! {
    /// Handles of syncs.
    SyncHandles {
        /// Runs them.
        worker_sync: Arc<WorkerSync>,
        /// Wakes those that wait.
        queue: Queue,
        /// Records measurements.
        telemetry: Arc<Telemetry>,
        /// Ends waits.
        shutdown: Shutdown,
    }
}

handle_group! {
    /// Handles of uploads.
    Uploads {
        /// Has the leases.
        queue: Queue,
        /// Takes the bytes.
        content: Arc<BlobStore>,
        /// Says whether there is room.
        reserve: Arc<SpaceReserve>,
        /// Bounds what a key sends.
        ledger: Arc<UploadLedger>,
        /// Takes what a key has sent and not reported.
        orphans: Orphans,
    }
}

/// Registers a worker.
pub(in crate::http) async fn register(
    State(registrar): State<Registrar>,
    caller: Caller,
    headers: HeaderMap,
    request: RequestBody,
) -> Result<Json<RegisterResponse>, ApiError> {
    let hello: RegisterRequest = body::read_json(&headers, request, MAX_REGISTER_BYTES).await?;
    if hello.picture_version != scene::PICTURE_VERSION {
        return Err(ApiError::WrongPictureVersion { found: hello.picture_version, wanted: scene::PICTURE_VERSION });
    }
    let label = matches!(caller, Caller::Pool).then(|| registrar.pool.label(hello.process)).flatten();
    let (pool, device, owner) = (label.is_some(), hello.device.clone(), caller.owner().to_owned());
    let name = label.unwrap_or_else(|| hello.name.clone());
    let new = NewWorker { request: hello, pool, name: name.clone(), owner: owner.clone() };
    let Some(registration) = registrar.queue.register(new).await? else {
        let limit = MAX_WORKERS_OF_KEY;
        return Err(ApiError::TooManyAtOnce { name: owner, what: "registered workers", limit });
    };
    let worker = registration.worker;
    registrar.telemetry.record_worker(worker, &name, &device);
    tracing::info!(%worker, %name, pool, "worker registered");
    let folders = if pool { folders(&registrar.content) } else { None };
    let lease_ms = registrar.queue.lease_ms().unsigned_abs();
    Ok(Json(RegisterResponse { worker, lease_ms, folders, max_batches: MAX_BATCHES, gives_way: true }))
}

/// Folders that a pool worker writes to directly; `None` if the store is no folder, or a folder's name is not UTF-8.
fn folders(content: &BlobStore) -> Option<ContentFolders> {
    let data = content.folder()?;
    let folder = |kind: ContentKind| {
        let folder = std::path::absolute(kind.path(data)).ok()?;
        folder.into_os_string().into_string().ok()
    };
    Some(ContentFolders { blobs: folder(ContentKind::Blob)?, pictures: folder(ContentKind::Picture)? })
}

/// Runs a worker's sync, and waits until there is work, a lease has ended, or the worker must drain.
///
/// Results are confirmed at once. If the client disconnects, the wait ends with its connection.
pub(in crate::http) async fn sync(
    State(syncs): State<SyncHandles>,
    caller: Caller,
    headers: HeaderMap,
    request: RequestBody,
) -> Result<Json<SyncResponse>, ApiError> {
    let request: SyncRequest = body::read_json(&headers, request, MAX_SYNC_BYTES).await?;
    let mut deadline = monotonic_now() + max_wait(&syncs.queue, &request);
    let mut turn = SyncInput {
        worker: request.worker,
        owner: caller.owner().to_owned(),
        rays_per_second: request.rays_per_second,
        held_leases: request.held_leases,
        reports: request.reports,
        records: request.records,
        rejected: Vec::new(),
        checked: None,
        wants_work: request.wants_work,
        beside: request.beside,
        max_batches: request.max_batches.clamp(1, MAX_BATCHES),
        shutting_down: request.shutting_down,
        opening: None,
        passed: PassedJobs::default(),
        next_openings: Vec::new(),
    };
    let mut metrics = Some(request.metrics);
    loop {
        let signals = syncs.queue.wake_signals();
        let (mut work, mut news) = (pin!(signals.work.notified()), pin!(signals.updates.notified()));
        // Subscribes before the first attempt, so that no wake signal is missed.
        work.as_mut().enable();
        news.as_mut().enable();
        let prompt = turn.has_reports() || turn.beside && turn.wants_work;
        let again = turn.without_reports();
        let begun = monotonic_now();
        let Some(mut synced) = syncs.worker_sync.sync(turn).await? else {
            return Err(unknown_worker(&syncs.queue, again.worker).await?);
        };
        let could_work_beside = again.beside && !again.wants_work;
        if could_work_beside && !prompt {
            synced.others_wait = syncs.queue.others_wait(again.worker).await?;
        }
        if let Some(metrics) = metrics.take() {
            syncs.telemetry.record_metrics(again.worker, &metrics).await;
        }
        let now = monotonic_now();
        if again.wants_work {
            syncs.telemetry.metrics.record_claim(now - begun);
        }
        if synced.drain && !again.held_leases.is_empty() {
            // The worker may already know that it must drain; it must not poll continuously while it finishes.
            deadline = deadline.min(now + MAX_DRAINING_WAIT);
        }
        let drains = synced.drain && again.held_leases.is_empty();
        if prompt || drains || synced.needs_response() || now >= deadline || syncs.shutdown.closing().is_cancelled() {
            return Ok(Json(reply(&syncs.telemetry, again.worker, synced).await));
        }
        let wake = synced.retry_in().map_or(deadline, |wait| deadline.min(now + wait));
        loop {
            tokio::select! {
                () = &mut work, if again.wants_work || could_work_beside => {
                    if again.wants_work {
                        break;
                    }
                    work.set(signals.work.notified());
                    work.as_mut().enable();
                    if syncs.queue.others_wait(again.worker).await? {
                        synced.others_wait = true;
                        return Ok(Json(reply(&syncs.telemetry, again.worker, synced).await));
                    }
                }
                () = &mut news => break,
                () = tokio::time::sleep_until(wake) => break,
                () = syncs.shutdown.closing().cancelled() => break,
            }
        }
        turn = again;
    }
}

/// Error of a sync for a worker that the caller may not speak for. A worker that registered before the farm had keys
/// registers again.
async fn unknown_worker(queue: &Queue, worker: WorkerId) -> Result<ApiError, ApiError> {
    let owner = queue.worker_owner(worker).await?;
    Ok(match owner.filter(|owner| owner != KEYLESS_SUBMITTER) {
        Some(_) => ApiError::ForeignWorker(worker.to_string()),
        None => ApiError::UnknownWorker(worker.to_string()),
    })
}

/// Rejects a transfer by a key whose workers hold no lease that needs it. The pool's own workers, and clients of a farm
/// without keys, may transfer everything.
async fn check_lease(queue: &Queue, caller: &Caller, needs: LeaseNeed<'_>) -> Result<(), ApiError> {
    match caller.key() {
        Some(key) if !queue.has_lease(key.id(), needs).await? => Err(ApiError::NoLease),
        Some(_) | None => Ok(()),
    }
}

/// Wait of a worker with leases: it needs the response in time to renew them.
fn max_wait(queue: &Queue, request: &SyncRequest) -> Duration {
    let asked = Duration::from_millis(request.wait_ms).min(MAX_WAIT);
    let third = Duration::from_millis(queue.lease_ms().unsigned_abs() / 3);
    asked.min(third)
}

async fn reply(telemetry: &Telemetry, worker: WorkerId, synced: SyncOutcome) -> SyncResponse {
    let run = match synced.next {
        NextWork::Run(run) => {
            fail_point::trigger_infallible(FailPoint::Claimed);
            Some(run)
        }
        NextWork::OpenFrame { .. } | NextWork::Nothing(_) => None,
    };
    let trace = match &run {
        Some(run) => trace_context::batch_traceparent(telemetry, worker, run).await,
        None => None,
    };
    let mut more = Vec::with_capacity(synced.more.len());
    for batch in synced.more {
        let trace = trace_context::batch_traceparent(telemetry, worker, &batch).await;
        more.push(TracedBatch { batch, trace });
    }
    SyncResponse {
        batch: run,
        revoked_leases: synced.revoked_leases,
        drain: synced.drain,
        trace,
        more,
        others_wait: synced.others_wait,
    }
}

/// Returns the JSON of a job, as it was submitted.
pub(in crate::http) async fn job(
    State(queue): State<Queue>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<Response, ApiError> {
    let job = job_id(&id)?;
    check_lease(&queue, &caller, LeaseNeed::JobFile(job)).await?;
    let text = queue.file(job).await?.ok_or(ApiError::UnknownJob(id))?;
    Ok(([(header::CONTENT_TYPE, "application/json")], text).into_response())
}

impl Uploads {
    async fn put(
        &self,
        caller: &Caller,
        kind: ContentKind,
        hash: String,
        headers: &HeaderMap,
        request: RequestBody,
    ) -> Result<StatusCode, ApiError> {
        let name = ContentHash::parse(&hash).ok_or_else(|| ApiError::WrongHash(hash.clone()))?;
        let need = match caller.key() {
            Some(key) => Some((key, self.queue.upload_need(key.id()).await?)),
            None => None,
        };
        let max_bytes = match &need {
            Some((_, need)) if *need == UploadNeed::default() => return Err(ApiError::NoLease),
            Some((_, need)) if kind == ContentKind::Picture => need.picture_bytes,
            Some((_, need)) => need.blob_bytes,
            None => u64::MAX,
        };
        if self.reserve.is_released() {
            return Err(ApiError::DiskFull);
        }
        let length = headers.get(header::CONTENT_LENGTH).and_then(|length| length.to_str().ok()?.parse().ok());
        let size_bytes: u64 = length.unwrap_or(max_bytes).min(max_bytes);
        let reservation = match need {
            Some((key, need)) => {
                let limit_bytes = need.total_bytes;
                let reserved = self.ledger.reserve(key.id(), (kind, hash.clone()), size_bytes, need);
                let mut reserved = reserved.ok_or(ApiError::UnneededBytes { limit_bytes })?;
                for (kind, name) in std::mem::take(&mut reserved.replaces) {
                    self.orphans.sweep_later(kind, vec![name]);
                }
                Some(reserved)
            }
            None => None,
        };
        let (bytes, _room) = request.into_stream(WRITE_CHUNK_BYTES)?;
        let bytes = bytes.map_err(std::io::Error::other);
        let span = tracing::info_span!("store", ?kind, %hash);
        self.content.put(kind, &name, bytes, max_bytes).instrument(span).await?;
        if let Some(reservation) = reservation {
            reservation.stored();
        }
        fail_point::trigger_infallible(match kind {
            ContentKind::Blob => FailPoint::BlobStored,
            ContentKind::Picture => FailPoint::PictureStored,
        });
        Ok(StatusCode::NO_CONTENT)
    }
}

/// Stores a tile's blob.
pub(in crate::http) async fn put_blob(
    State(uploads): State<Uploads>,
    caller: Caller,
    Path(hash): Path<String>,
    headers: HeaderMap,
    request: RequestBody,
) -> Result<StatusCode, ApiError> {
    uploads.put(&caller, ContentKind::Blob, hash, &headers, request).await
}

/// Stores a frame's picture; it is durable when the response is sent.
pub(in crate::http) async fn put_picture(
    State(uploads): State<Uploads>,
    caller: Caller,
    Path(hash): Path<String>,
    headers: HeaderMap,
    request: RequestBody,
) -> Result<StatusCode, ApiError> {
    uploads.put(&caller, ContentKind::Picture, hash, &headers, request).await
}

/// Returns a tile's blob.
pub(in crate::http) async fn get_blob(
    State(queue): State<Queue>,
    State(content): State<Arc<BlobStore>>,
    caller: Caller,
    Path(hash): Path<String>,
) -> Result<Response, ApiError> {
    let Some(name) = ContentHash::parse(&hash) else { return Err(ApiError::WrongHash(hash)) };
    check_lease(&queue, &caller, LeaseNeed::Blob(&hash)).await?;
    match content.get(ContentKind::Blob, &name, None).await? {
        Some((length_bytes, bytes)) => {
            Ok(([(header::CONTENT_LENGTH, length_bytes)], Body::from_stream(bytes)).into_response())
        }
        None => Err(ApiError::UnknownBlob(hash)),
    }
}
