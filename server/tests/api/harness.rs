//! Test harness: a server on a free port with its own folder, and a worker that pretends to render.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use proto::client_auth::client_builder;
use proto::job::{JobState, JobView};
use proto::worker_protocol::{
    self, Batch, BatchWork, LeaseOutcome, LeaseReport, RegisterRequest, RegisterResponse, SyncRequest, SyncResponse,
    TileRecord, WorkerMetrics,
};
use proto::{JobId, LeaseId, Problem, Rect, WorkerId};
use reqwest::{Client, Method, Response, StatusCode};
use serde_json::{Value, json};
use server::{Clock, Config, ManualClock, Server};
use tempfile::TempDir;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use super::documented::assert_documented;
use super::fake_pictures;
use crate::postgres_server;

/// Timeout of every operation; an operation that takes longer has failed.
const DEADLINE: Duration = Duration::from_mins(1);
/// Length of a lease in these tests, by the manual clock.
pub(crate) const LEASE: Duration = Duration::from_secs(30);

/// Waits for a future, up to the timeout.
pub(crate) async fn in_time<T>(work: impl Future<Output = T>) -> T {
    tokio::time::timeout(DEADLINE, work).await.expect("it takes too long")
}

/// A running server.
pub(crate) struct Farm {
    pub(crate) folder: TempDir,
    pub(crate) address: SocketAddr,
    pub(crate) client: Client,
    pub(crate) hand: ManualClock,
    shutdown: CancellationToken,
    task: JoinHandle<Result<(), server::ServeError>>,
}

/// The configuration of a server for tests: no local workers, any free port.
pub(crate) fn config(data: &Path) -> Config {
    Config {
        listen: ([127, 0, 0, 1], 0).into(),
        data: data.to_owned(),
        database: postgres_server::database_of(data).map(|address| address.parse().expect("an address")),
        workers: Some(0),
        lease: LEASE,
        verify_share: 0.0,
        verify_new: Duration::ZERO,
        worker_program: "/nonexistent/sdfarm".into(),
        ..Config::default()
    }
}

impl Farm {
    pub(crate) async fn start() -> Self {
        Self::start_in(tempfile::tempdir().expect("a temporary folder"), |_| {}).await
    }

    pub(crate) async fn start_in(folder: TempDir, change: impl FnOnce(&mut Config)) -> Self {
        let mut config = config(folder.path());
        change(&mut config);
        let (clock, hand) = Clock::manual();
        let server = Server::start_with_clock(config, clock).await.expect("the server starts");
        let address = server.address();
        let shutdown = CancellationToken::new();
        let task = tokio::spawn(server.run(shutdown.clone()));
        Self { folder, address, client: client_builder().build().expect("a client"), hand, shutdown, task }
    }

    /// Stops the server gracefully; its folder is kept.
    pub(crate) async fn stop(self) -> TempDir {
        self.shutdown.cancel();
        in_time(self.task).await.expect("the server does not panic").expect("the server shuts down without an error");
        self.folder
    }

    pub(crate) fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.address)
    }

    pub(crate) async fn get(&self, path: &str) -> Response {
        in_time(self.client.get(self.url(path)).send()).await.expect("the server responds")
    }

    pub(crate) async fn post(&self, path: &str, body: impl Into<reqwest::Body>) -> Response {
        in_time(self.client.post(self.url(path)).body(body).send()).await.expect("the server responds")
    }

    /// Sends a request with a key, if there is one.
    async fn send_as(&self, key: Option<&str>, method: Method, path: &str, body: Vec<u8>) -> Response {
        let mut request = self.client.request(method, self.url(path)).body(body);
        if let Some(key) = key {
            request = request.bearer_auth(key);
        }
        in_time(request.send()).await.expect("the server responds")
    }

    /// Submits three jobs of many tiles, one after another by their priorities.
    pub(crate) async fn submit_three_large(&self) {
        for seed in 0..3 {
            let mut large = job(4096, 4096, 4);
            large["image"]["seed"] = seed.into();
            large["priority"] = (-seed).into();
            self.submit(&large).await;
        }
    }

    pub(crate) async fn submit(&self, job: &Value) -> JobView {
        let response = self.post("/v1/jobs", job.to_string()).await;
        read(response, StatusCode::CREATED).await
    }

    pub(crate) async fn job(&self, id: JobId) -> JobView {
        read(self.get(&format!("/v1/jobs/{id}")).await, StatusCode::OK).await
    }

    pub(crate) async fn worker(&self, name: &str) -> Worker<'_> {
        Worker::register(self, None, name, "cpu", None).await
    }

    /// Worker whose requests have this key.
    pub(crate) async fn worker_of(&self, key: &str, name: &str) -> Worker<'_> {
        Worker::register(self, Some(key), name, "cpu", None).await
    }

    /// Worker that renders only scenes with at most this many nodes.
    pub(crate) async fn small_worker(&self, name: &str, max_nodes: u32) -> Worker<'_> {
        Worker::register(self, None, name, "cpu", Some(max_nodes)).await
    }

    /// Worker on a GPU that renders only scenes with at most this many nodes.
    pub(crate) async fn gpu_worker(&self, name: &str, max_nodes: u32) -> Worker<'_> {
        Worker::register(self, None, name, "cuda:0", Some(max_nodes)).await
    }
}

/// Reads a response that must have this status.
pub(crate) async fn read<T: serde::de::DeserializeOwned>(response: Response, status: StatusCode) -> T {
    let actual = response.status();
    let text = in_time(response.text()).await.expect("the response has a body");
    assert_eq!(actual, status, "{text}");
    serde_json::from_str(&text).unwrap_or_else(|error| panic!("{error}: {text}"))
}

/// Reads a response that must be this problem, and one that its route documents.
pub(crate) async fn refused(response: Response, status: u16, code: &str) -> Problem {
    assert_eq!(response.headers()["content-type"], "application/problem+json");
    let id = response.headers()["x-request-id"].to_str().expect("text").to_owned();
    let path = response.url().path().to_owned();
    let problem: Problem = read(response, StatusCode::from_u16(status).expect("a status")).await;
    assert_eq!((problem.status, problem.code.as_str()), (status, code), "{problem:?}");
    assert_eq!(problem.request_id.as_deref(), Some(id.as_str()));
    assert!(!problem.detail.is_empty() && !problem.detail.ends_with('.'), "{problem:?}");
    assert_documented(&path, status, code);
    problem
}

/// A valid job of this size.
pub(crate) fn job(width: u32, height: u32, samples: u32) -> Value {
    json!({
        "name": "test",
        "scene": {
            "camera": { "position": [0, 0, 5], "look_at": [0, 0, 0] },
            "objects": [{ "material": { "normals": {} }, "shape": { "sphere": { "radius": 1 } } }]
        },
        "image": { "width": width, "height": height, "samples": samples }
    })
}

/// A job of one tile, different for each seed.
pub(crate) fn small_job(seed: u32) -> Value {
    let mut job = job(64, 64, 1);
    job["image"]["seed"] = seed.into();
    job
}

/// Tile or frame of a lease.
#[derive(Clone)]
struct LeasedTile {
    job: Arc<scene::Job>,
    frame: u32,
    rect: Rect,
}

/// A worker that pretends to render.
pub(crate) struct Worker<'a> {
    farm: &'a Farm,
    key: Option<String>,
    jobs: Mutex<HashMap<JobId, Arc<scene::Job>>>,
    places: Mutex<HashMap<LeaseId, LeasedTile>>,
    pub(crate) id: WorkerId,
    pub(crate) rays_per_second: Option<f64>,
}

/// Content of a worker's sync, except its id.
#[derive(Default)]
pub(crate) struct Said {
    pub(crate) holding: Vec<LeaseId>,
    pub(crate) results: Vec<LeaseReport>,
    pub(crate) records: Vec<TileRecord>,
    pub(crate) wants_work: bool,
    pub(crate) beside: bool,
    pub(crate) wait: Duration,
    pub(crate) measured: WorkerMetrics,
}

impl<'a> Worker<'a> {
    async fn register(farm: &'a Farm, key: Option<&str>, name: &str, device: &str, max_nodes: Option<u32>) -> Self {
        let hello = RegisterRequest {
            name: name.to_owned(),
            device: device.to_owned(),
            picture_version: scene::PICTURE_VERSION,
            max_nodes,
            process: 1,
        };
        let hello = serde_json::to_vec(&hello).expect("json");
        let registered = farm.send_as(key, Method::POST, worker_protocol::REGISTER_PATH, hello).await;
        let welcome: RegisterResponse = read(registered, StatusCode::OK).await;
        assert_eq!(welcome.lease_ms, LEASE.as_millis() as u64);
        let (jobs, places) = Default::default();
        let key = key.map(ToOwned::to_owned);
        Self { farm, key, jobs, places, id: welcome.worker, rays_per_second: None }
    }

    async fn send(&self, method: Method, path: &str, body: Vec<u8>) -> Response {
        self.farm.send_as(self.key.as_deref(), method, path, body).await
    }

    pub(crate) async fn try_sync(&self, said: Said) -> Response {
        let request = SyncRequest {
            worker: self.id,
            rays_per_second: self.rays_per_second.and_then(proto::bounded::RaysPerSecond::new),
            held_leases: said.holding,
            reports: said.results,
            records: said.records,
            wants_work: said.wants_work,
            beside: said.beside,
            max_batches: 1,
            wait_ms: said.wait.as_millis() as u64,
            shutting_down: false,
            metrics: said.measured,
        };
        self.send(Method::POST, worker_protocol::SYNC_PATH, serde_json::to_vec(&request).expect("json")).await
    }

    pub(crate) async fn sync(&self, said: Said) -> SyncResponse {
        let reply: SyncResponse = read(self.try_sync(said).await, StatusCode::OK).await;
        if let Some(run) = &reply.batch {
            self.remember(run).await;
        }
        reply
    }

    /// Remembers what the leases of a batch ask for.
    async fn remember(&self, run: &Batch) {
        let known = self.jobs.lock().expect("no holder panics").get(&run.job).cloned();
        let job = if let Some(job) = known {
            job
        } else {
            let file = self.send(Method::GET, &worker_protocol::job_path(run.job), Vec::new()).await;
            let text = in_time(file.bytes()).await;
            let Ok(job) = scene::parse(&text.expect("a body")) else { return };
            let job = Arc::new(job);
            self.jobs.lock().expect("no holder panics").insert(run.job, Arc::clone(&job));
            job
        };
        let rect = Rect::full(job.image.width, job.image.height);
        let rects: Vec<(LeaseId, Rect)> = match &run.work {
            BatchWork::Render { tiles, .. } => tiles.iter().map(|tile| (tile.lease, tile.rect)).collect(),
            BatchWork::Stitch { lease, .. } => vec![(*lease, rect)],
        };
        let places = rects
            .into_iter()
            .map(|(lease, rect)| (lease, LeasedTile { job: Arc::clone(&job), frame: run.frame, rect }));
        self.places.lock().expect("no holder panics").extend(places);
    }

    fn place(&self, lease: LeaseId) -> Option<LeasedTile> {
        self.places.lock().expect("no holder panics").get(&lease).cloned()
    }

    /// Claims a batch, if one is ready at once.
    pub(crate) async fn claim(&self) -> Option<Batch> {
        self.sync(Said { wants_work: true, ..Said::default() }).await.batch
    }

    /// Waits for a batch.
    pub(crate) async fn next(&self) -> Batch {
        self.sync(Said { wants_work: true, wait: DEADLINE, ..Said::default() }).await.batch.expect("a run in time")
    }

    pub(crate) async fn report(&self, results: Vec<LeaseReport>) -> SyncResponse {
        self.sync(Said { results, ..Said::default() }).await
    }

    pub(crate) async fn put(&self, path: &str, bytes: Vec<u8>) -> Response {
        self.send(Method::PUT, path, bytes).await
    }

    /// Stores a picture with this text and reports it for these leases.
    pub(crate) async fn picture(&self, leases: &[LeaseId], text: &[u8]) -> Vec<LeaseReport> {
        let place = leases.first().and_then(|lease| self.place(*lease));
        let place = place.expect("this worker claimed the lease");
        self.raw_picture(leases, &fake_pictures::picture(&place.job, place.frame, text)).await
    }

    /// Stores any bytes as a picture and reports it for these leases.
    pub(crate) async fn raw_picture(&self, leases: &[LeaseId], bytes: &[u8]) -> Vec<LeaseReport> {
        let hash = blake3::hash(bytes).to_hex().to_string();
        let put = self.put(&worker_protocol::picture_path(&hash), bytes.to_vec()).await;
        assert_eq!(put.status(), StatusCode::NO_CONTENT);
        let size_bytes = bytes.len() as u64;
        leases
            .iter()
            .map(|&lease| LeaseReport { lease, outcome: LeaseOutcome::Picture { hash: hash.clone(), size_bytes } })
            .collect()
    }

    /// Stores a blob with this text and reports it.
    pub(crate) async fn blob(&self, lease: LeaseId, text: &[u8]) -> LeaseReport {
        let place = self.place(lease).expect("this worker claimed the lease");
        self.raw_blob(lease, &fake_pictures::blob(&place.job, place.rect, text)).await
    }

    /// Stores any bytes as a blob and reports it.
    pub(crate) async fn raw_blob(&self, lease: LeaseId, bytes: &[u8]) -> LeaseReport {
        let hash = blake3::hash(bytes).to_hex().to_string();
        let put = self.put(&worker_protocol::blob_path(&hash), bytes.to_vec()).await;
        assert_eq!(put.status(), StatusCode::NO_CONTENT);
        LeaseReport { lease, outcome: LeaseOutcome::Blob { hash, size_bytes: bytes.len() as u64 } }
    }

    /// Renders one batch as a correct worker does; false if there is none.
    pub(crate) async fn work_once(&self) -> bool {
        let Some(run) = self.claim().await else { return false };
        let results = self.results(&run).await;
        let reply = self.report(results).await;
        assert_eq!(reply.revoked_leases, []);
        true
    }

    /// Reports of a correct worker for a batch.
    pub(crate) async fn results(&self, run: &Batch) -> Vec<LeaseReport> {
        self.remember(run).await;
        let picture = format!("picture of frame {} of {}", run.frame, run.job);
        match &run.work {
            BatchWork::Render { whole_frame: true, .. } | BatchWork::Stitch { .. } => {
                self.picture(&leases(run), picture.as_bytes()).await
            }
            BatchWork::Render { tiles, whole_frame: false } => {
                let mut results = Vec::new();
                for tile in tiles {
                    let bytes = format!("tile {} of {picture}", tile.index);
                    results.push(self.blob(tile.lease, bytes.as_bytes()).await);
                }
                results
            }
        }
    }

    /// Works until nothing is ready.
    pub(crate) async fn work_off(&self) -> usize {
        let mut count = 0;
        while self.work_once().await {
            count += 1;
        }
        count
    }
}

/// All leases of a run.
pub(crate) fn leases(run: &Batch) -> Vec<LeaseId> {
    run.leases().map(|(lease, _)| lease).collect()
}

/// Asserts the state of a job.
pub(crate) async fn assert_state(farm: &Farm, id: JobId, state: JobState) {
    let job = farm.job(id).await;
    assert_eq!(job.state, state, "{job:?}");
}
