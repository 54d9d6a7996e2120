//! Fake server that implements the workers' protocol in memory, and can be stopped like a killed process and
//! restarted at the same address.

use std::collections::{HashMap, HashSet, VecDeque};
use std::net::{SocketAddr, TcpListener};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use axum::body::Bytes;
use axum::extract::{DefaultBodyLimit, Path, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post, put};
use axum::{Json, Router};
use proto::worker_protocol::{
    self, Batch, BatchWork, LeaseOutcome, LeaseReport, LeasedTile, RegisterRequest, RegisterResponse, SyncRequest,
    SyncResponse, TracedBatch,
};
use proto::{JobId, LeaseId, Rect, WorkerId};
use tokio::runtime::Runtime;
use tokio::sync::Notify;

/// Timeout, sufficient on the slowest machine; a test that reaches it has failed.
const DEADLINE: Duration = Duration::from_secs(20);

/// State of the server, and what it has received.
#[derive(Default)]
pub(crate) struct Farm {
    pub(crate) lease_ms: u64,
    /// Maximum number of batches in a response; 0 is one.
    pub(crate) max_batches: u32,
    /// Time limit for a tile of the batches given from now on.
    pub(crate) tile_seconds: Option<u32>,
    pub(crate) jobs: HashMap<JobId, String>,
    pub(crate) queue: VecDeque<Batch>,
    pub(crate) live: HashSet<LeaseId>,
    pub(crate) drain: bool,
    /// Status and body of responses to registrations.
    pub(crate) refusal: Option<(StatusCode, String)>,
    /// Status of the response to the next PUTs, and the number of PUTs left.
    pub(crate) put_refusals: VecDeque<StatusCode>,
    /// While this is set, PUTs of pictures wait.
    pub(crate) hold_puts: bool,
    /// Number of waiting PUTs of pictures.
    pub(crate) putting: usize,
    pub(crate) hellos: Vec<RegisterRequest>,
    pub(crate) workers: HashSet<WorkerId>,
    pub(crate) syncs: Vec<SyncRequest>,
    pub(crate) reports: Vec<LeaseReport>,
    pub(crate) blobs: HashMap<String, Vec<u8>>,
    pub(crate) pictures: HashMap<String, Vec<u8>>,
    pub(crate) jobs_read: usize,
    pub(crate) waiting: usize,
}

impl Farm {
    /// Queues a batch; returns its leases.
    pub(crate) fn give(&mut self, job: JobId, rects: &[Rect], whole_frame: bool) -> Vec<LeaseId> {
        let tiles: Vec<LeasedTile> =
            (0..).zip(rects).map(|(index, &rect)| LeasedTile { lease: LeaseId::new(), index, rect }).collect();
        let leases = tiles.iter().map(|tile| tile.lease).collect();
        self.queue.push_back(Batch {
            job,
            frame: 3,
            tile_seconds: self.tile_seconds,
            work: BatchWork::Render { tiles, whole_frame },
            recording: None,
        });
        leases
    }

    pub(crate) fn add_job(&mut self, text: String) -> JobId {
        let id = JobId::new();
        self.jobs.insert(id, text);
        id
    }

    /// Outcome of a lease, if it was reported.
    pub(crate) fn outcome(&self, lease: LeaseId) -> Option<&LeaseOutcome> {
        self.reports.iter().find(|report| report.lease == lease).map(|report| &report.outcome)
    }

    fn lost(&self, sync: &SyncRequest) -> Vec<LeaseId> {
        sync.held_leases.iter().copied().filter(|lease| !self.live.contains(lease)).collect()
    }
}

#[derive(Clone, Default)]
struct Shared {
    farm: Arc<(Mutex<Farm>, Condvar)>,
    news: Arc<Notify>,
}

impl Shared {
    fn farm(&self) -> MutexGuard<'_, Farm> {
        self.farm.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes the state, and wakes all waiters.
    fn change<T>(&self, change: impl FnOnce(&mut Farm) -> T) -> T {
        let changed = change(&mut self.farm());
        self.farm.1.notify_all();
        self.news.notify_waiters();
        changed
    }
}

/// The fake server.
pub(crate) struct FakeServer {
    shared: Shared,
    address: SocketAddr,
    runtime: Option<Runtime>,
}

impl FakeServer {
    /// A server that is not running yet, but whose address is known.
    pub(crate) fn down(lease_ms: u64) -> Self {
        let shared = Shared::default();
        shared.farm().lease_ms = lease_ms;
        let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        Self { shared, address, runtime: None }
    }

    pub(crate) fn start(lease_ms: u64) -> Self {
        let mut server = Self::down(lease_ms);
        server.up();
        server
    }

    pub(crate) fn up(&mut self) {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        let app = router(self.shared.clone());
        let listener = runtime.block_on(tokio::net::TcpListener::bind(self.address)).unwrap();
        runtime.spawn(async move { axum::serve(listener, app).await });
        self.runtime = Some(runtime);
    }

    /// Stops like a killed process: every connection is closed.
    pub(crate) fn kill(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_timeout(DEADLINE);
        }
    }

    pub(crate) fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    pub(crate) fn change<T>(&self, change: impl FnOnce(&mut Farm) -> T) -> T {
        self.shared.change(change)
    }

    /// Waits until the state is as wanted, and returns what the condition finds.
    pub(crate) fn until<T>(&self, what: &str, mut condition: impl FnMut(&mut Farm) -> Option<T>) -> T {
        let end = Instant::now() + DEADLINE;
        let mut farm = self.shared.farm();
        loop {
            if let Some(found) = condition(&mut farm) {
                return found;
            }
            let left = end.saturating_duration_since(Instant::now());
            assert!(!left.is_zero(), "timed out waiting until {what}; reports: {:?}", farm.reports);
            farm = self.shared.farm.1.wait_timeout(farm, left).unwrap().0;
        }
    }

    /// Waits until all these leases are reported, and returns the outcomes.
    pub(crate) fn outcomes(&self, leases: &[LeaseId]) -> Vec<LeaseOutcome> {
        self.until("all leases are reported", |farm| leases.iter().map(|&lease| farm.outcome(lease).cloned()).collect())
    }
}

impl Drop for FakeServer {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

fn router(shared: Shared) -> Router {
    Router::new()
        .route(worker_protocol::REGISTER_PATH, post(register))
        .route(worker_protocol::SYNC_PATH, post(sync))
        .route("/v1/worker/jobs/{job}", get(read_job))
        .route("/v1/worker/blobs/{hash}", put(put_blob).get(read_blob))
        .route("/v1/worker/pictures/{hash}", put(put_picture))
        .layer(DefaultBodyLimit::disable())
        .with_state(shared)
}

async fn register(State(shared): State<Shared>, Json(hello): Json<RegisterRequest>) -> Response {
    shared.change(|farm| {
        if let Some((status, body)) = &farm.refusal {
            return (*status, body.clone()).into_response();
        }
        farm.hellos.push(hello);
        let worker = WorkerId::new();
        farm.workers.insert(worker);
        let max_batches = farm.max_batches.max(1);
        Json(RegisterResponse { worker, lease_ms: farm.lease_ms, folders: None, max_batches, gives_way: false })
            .into_response()
    })
}

async fn sync(State(shared): State<Shared>, Json(sync): Json<SyncRequest>) -> Response {
    let known = shared.change(|farm| {
        for report in &sync.reports {
            if farm.live.remove(&report.lease) {
                farm.reports.push(report.clone());
            }
        }
        farm.syncs.push(sync.clone());
        farm.workers.contains(&sync.worker)
    });
    if !known {
        return StatusCode::NOT_FOUND.into_response();
    }
    let end = tokio::time::Instant::now() + Duration::from_millis(sync.wait_ms);
    loop {
        let rung = shared.news.notified();
        tokio::pin!(rung);
        rung.as_mut().enable();
        if let Some(reply) = answer(&shared, &sync) {
            return Json(reply).into_response();
        }
        // Wakes the test only: the other signal would wake this call itself.
        shared.farm().waiting += 1;
        shared.farm.1.notify_all();
        if tokio::time::timeout_at(end, rung).await.is_err() {
            return Json(SyncResponse {
                batch: None,
                revoked_leases: Vec::new(),
                drain: false,
                trace: None,
                more: Vec::new(),
                others_wait: false,
            })
            .into_response();
        }
    }
}

/// Response that is available at once.
fn answer(shared: &Shared, sync: &SyncRequest) -> Option<SyncResponse> {
    let mut farm = shared.farm();
    let lost = farm.lost(sync);
    let run = if sync.wants_work && !farm.drain { farm.queue.pop_front() } else { None };
    let more = if run.is_some() { sync.max_batches as usize - 1 } else { 0 };
    let count = more.min(farm.queue.len());
    let more: Vec<Batch> = farm.queue.drain(..count).collect();
    for batch in run.iter().chain(&more) {
        match &batch.work {
            BatchWork::Render { tiles, .. } => farm.live.extend(tiles.iter().map(|tile| tile.lease)),
            BatchWork::Stitch { lease, .. } => _ = farm.live.insert(*lease),
        }
    }
    let more = more.into_iter().map(|batch| TracedBatch { batch, trace: None }).collect();
    let drain = farm.drain;
    shared.farm.1.notify_all();
    (run.is_some() || !lost.is_empty() || drain).then_some(SyncResponse {
        batch: run,
        revoked_leases: lost,
        drain,
        trace: None,
        more,
        others_wait: false,
    })
}

async fn read_job(State(shared): State<Shared>, Path(job): Path<JobId>) -> Response {
    shared.change(|farm| {
        farm.jobs_read += 1;
        farm.jobs.get(&job).cloned().ok_or(StatusCode::NOT_FOUND).into_response()
    })
}

async fn put_blob(State(shared): State<Shared>, Path(hash): Path<String>, bytes: Bytes) -> StatusCode {
    assert_eq!(blake3::hash(&bytes).to_hex().as_str(), hash);
    shared.change(|farm| {
        if let Some(status) = farm.put_refusals.pop_front() {
            return status;
        }
        farm.blobs.insert(hash, bytes.into());
        StatusCode::CREATED
    })
}

async fn read_blob(State(shared): State<Shared>, Path(hash): Path<String>) -> Response {
    shared.change(|farm| farm.blobs.get(&hash).cloned().ok_or(StatusCode::NOT_FOUND).into_response())
}

async fn put_picture(State(shared): State<Shared>, Path(hash): Path<String>, bytes: Bytes) -> StatusCode {
    assert_eq!(blake3::hash(&bytes).to_hex().as_str(), hash);
    shared.change(|farm| farm.putting += 1);
    loop {
        let rung = shared.news.notified();
        tokio::pin!(rung);
        rung.as_mut().enable();
        if !shared.farm().hold_puts {
            break;
        }
        rung.await;
    }
    shared.change(|farm| {
        farm.putting -= 1;
        if let Some(status) = farm.put_refusals.pop_front() {
            return status;
        }
        farm.pictures.insert(hash, bytes.into());
        StatusCode::CREATED
    })
}
