//! Metrics and status for operators, and how they are collected.
//!
//! It only reads and counts; nothing in the farm depends on it. Counting is limited to a fraction of the time:
//! counts are cached for 1 s, or longer if counting took long.

mod metrics;

use std::collections::{HashMap, VecDeque};
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use proto::farm::{DiskView, FarmCounts};
use proto::job::JobState;
use proto::worker_protocol::{DeviceMemory, MAX_TIMINGS, WorkerMetrics};
use proto::{JobId, WorkerId};
use tokio::time::Instant;

use crate::admission::Shares;
use crate::blobs::{BlobStore, ContentKind};
use crate::clock::monotonic_now;
use crate::counters::ServerCounters;
use crate::db::{Database, DatabaseError};
use crate::host::{self, Disk, Process};
use crate::queue::{Queue, QueueStats};
use crate::scaling::Demand;
pub(crate) use metrics::Metrics;
use metrics::{Labels, replace};

/// Minimum time for which counts are cached.
const COUNTS_TTL: Duration = Duration::from_secs(1);
/// Time for which the sizes of folders are cached.
const SIZES_TTL: Duration = Duration::from_secs(30);
/// Time for which the sizes in a bucket are cached, because listing it costs money.
const BUCKET_SIZES_TTL: Duration = Duration::from_mins(10);
/// Inverse of the maximum fraction of time spent on counting.
const MAX_COUNTING_FRACTION: u32 = 20;
/// Time for which a worker's GPU is shown after its last report.
const DEVICE_TTL: Duration = Duration::from_mins(2);
/// Number of jobs whose traces are cached.
const MAX_CACHED_TRACES: usize = 64;
/// Maximum duration of a phase; longer ones are rejected as invalid.
const MAX_TOOK_MS: f64 = 1e9;

/// Metrics and caches of the server.
#[derive(Debug)]
pub(crate) struct Telemetry {
    /// Metrics counted as they happen.
    pub(crate) metrics: Metrics,
    queue: Queue,
    content: Arc<BlobStore>,
    counters: Arc<ServerCounters>,
    started: Instant,
    data: PathBuf,
    counts: tokio::sync::Mutex<Option<Expiring<QueueStats>>>,
    demand: tokio::sync::Mutex<Option<Expiring<Demand>>>,
    sizes: tokio::sync::Mutex<Option<Expiring<FolderSizes>>>,
    devices: Mutex<HashMap<WorkerId, DeviceStatus>>,
    traces: Mutex<VecDeque<(JobId, Option<String>)>>,
}

/// Sizes in the data folder.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FolderSizes {
    pictures_bytes: u64,
    blobs_bytes: u64,
    disk: Disk,
}

/// Cached value with its expiry.
#[derive(Debug)]
struct Expiring<T> {
    value: T,
    until: Instant,
}

impl<T: Clone> Expiring<T> {
    fn get(kept: Option<&Self>) -> Option<T> {
        kept.filter(|kept| monotonic_now() < kept.until).map(|kept| kept.value.clone())
    }

    fn new(value: T, begun: Instant, keep: Duration) -> Self {
        Self { value, until: monotonic_now() + keep.max(begun.elapsed() * MAX_COUNTING_FRACTION) }
    }
}

async fn bucket_sizes(content: &BlobStore, last: FolderSizes, disk: Disk) -> FolderSizes {
    let measured = tokio::try_join!(content.size_bytes(ContentKind::Picture), content.size_bytes(ContentKind::Blob));
    match measured {
        Ok((pictures_bytes, blobs_bytes)) => FolderSizes { pictures_bytes, blobs_bytes, disk },
        Err(error) => {
            tracing::warn!(%error, "could not list the store");
            FolderSizes { disk, ..last }
        }
    }
}

/// Device of a worker.
#[derive(Debug)]
struct DeviceStatus {
    name: String,
    device: String,
    memory: Option<DeviceMemory>,
    at: Instant,
}

impl Telemetry {
    /// Metrics of a server that starts now.
    pub(crate) fn new(
        data: PathBuf,
        database: &Database,
        queue: Queue,
        content: Arc<BlobStore>,
        counters: Arc<ServerCounters>,
    ) -> Self {
        Self {
            metrics: Metrics::new(database.commits(), content.location()),
            queue,
            content,
            counters,
            started: monotonic_now(),
            data,
            counts: tokio::sync::Mutex::default(),
            demand: tokio::sync::Mutex::default(),
            sizes: tokio::sync::Mutex::default(),
            devices: Mutex::default(),
            traces: Mutex::default(),
        }
    }

    /// Records a worker's registration.
    pub(crate) fn record_worker(&self, worker: WorkerId, name: &str, device: &str) {
        let mut devices = self.devices.lock().expect("no holder panics");
        devices.retain(|_, seen| seen.at.elapsed() < DEVICE_TTL);
        let seen = DeviceStatus { name: name.to_owned(), device: device.to_owned(), memory: None, at: monotonic_now() };
        devices.insert(worker, seen);
    }

    /// Records a worker's measurements; it may have registered with another server.
    pub(crate) async fn record_metrics(&self, worker: WorkerId, measured: &WorkerMetrics) {
        let is_known = self.devices.lock().expect("no holder panics").contains_key(&worker);
        if !is_known && let Ok(Some((name, device))) = self.queue.worker_device(worker).await {
            self.record_worker(worker, &name, &device);
        }
        let mut devices = self.devices.lock().expect("no holder panics");
        let Some(seen) = devices.get_mut(&worker) else { return };
        seen.at = monotonic_now();
        seen.memory = measured.memory.or(seen.memory);
        let is_sound = |took_ms: f64| (0.0..MAX_TOOK_MS).contains(&took_ms);
        for timing in measured.timings.iter().take(MAX_TIMINGS).filter(|timing| is_sound(timing.took_ms)) {
            self.metrics.record_timing(&seen.device, timing);
        }
    }

    /// Trace of a job; the newest jobs' are cached.
    pub(crate) async fn trace_of(&self, job: JobId) -> Result<Option<String>, DatabaseError> {
        let known = |traces: &VecDeque<(JobId, Option<String>)>| {
            traces.iter().find(|(id, _)| *id == job).map(|(_, trace)| trace.clone())
        };
        if let Some(trace) = known(&self.traces.lock().expect("no holder panics")) {
            return Ok(trace);
        }
        let trace = self.queue.trace_of(job).await?;
        let mut traces = self.traces.lock().expect("no holder panics");
        traces.push_front((job, trace.clone()));
        traces.truncate(MAX_CACHED_TRACES);
        Ok(trace)
    }

    /// Time since the start.
    pub(crate) fn uptime(&self) -> Duration {
        self.started.elapsed()
    }

    /// Current counts, cached for at least 1 s.
    pub(crate) async fn counts(&self) -> Result<QueueStats, DatabaseError> {
        let mut kept = self.counts.lock().await;
        if let Some(counts) = Expiring::get(kept.as_ref()) {
            return Ok(counts);
        }
        let begun = monotonic_now();
        let counts = self.queue.counts().await?;
        *kept = Some(Expiring::new(counts.clone(), begun, COUNTS_TTL));
        Ok(counts)
    }

    /// Numbers of the farm; the numbers of jobs and workers are cached.
    pub(crate) async fn farm_counts(&self) -> Result<FarmCounts, DatabaseError> {
        let counts = self.counts().await?;
        let jobs = |state: JobState| counts.jobs_in(state.name()).unsigned_abs();
        let ready = counts.workers.iter().filter(|group| group.state == "ready").map(|group| group.number).sum::<i64>();
        Ok(FarmCounts {
            paused: self.queue.is_paused().await?,
            queued: jobs(JobState::Queued),
            running: jobs(JobState::Running),
            succeeded: jobs(JobState::Succeeded),
            failed: jobs(JobState::Failed),
            cancelled: jobs(JobState::Cancelled),
            workers_ready: ready.unsigned_abs(),
        })
    }

    /// Current backlog and workers, cached like the counts.
    pub(crate) async fn demand(&self) -> Result<Demand, DatabaseError> {
        let mut kept = self.demand.lock().await;
        if let Some(demand) = Expiring::get(kept.as_ref()) {
            return Ok(demand);
        }
        let begun = monotonic_now();
        let demand = self.queue.demand().await?;
        *kept = Some(Expiring::new(demand.clone(), begun, COUNTS_TTL));
        Ok(demand)
    }

    /// Sizes of the store and of the data folder's disk, cached for 30 s, or for 10 min of a bucket. If the bucket cannot
    /// be listed, its sizes are the last known ones.
    async fn sizes(&self) -> FolderSizes {
        let mut kept = self.sizes.lock().await;
        if let Some(sizes) = Expiring::get(kept.as_ref()) {
            return sizes;
        }
        let (begun, data) = (monotonic_now(), self.data.clone());
        let (sizes, keep) = if self.content.folder().is_some() {
            let measure = move || FolderSizes {
                pictures_bytes: host::folder_bytes(&data.join("pictures")),
                blobs_bytes: host::folder_bytes(&data.join("tiles")),
                disk: host::disk(&data),
            };
            (tokio::task::spawn_blocking(measure).await.unwrap_or_default(), SIZES_TTL)
        } else {
            let last = kept.as_ref().map(|kept| kept.value).unwrap_or_default();
            (bucket_sizes(&self.content, last, host::disk(&data)).await, BUCKET_SIZES_TTL)
        };
        *kept = Some(Expiring::new(sizes, begun, keep));
        sizes
    }

    /// The data folder's disk.
    pub(crate) fn disk(&self) -> Disk {
        host::disk(&self.data)
    }

    /// The data folder's disk, and the sizes of the store: a bucket's as they were last listed for the metrics.
    pub(crate) async fn disk_view(&self) -> DiskView {
        let sizes = if self.content.folder().is_some() {
            Some(self.sizes().await)
        } else {
            self.sizes.lock().await.as_ref().map(|kept| kept.value)
        };
        let Disk { free_bytes, total_bytes } = self.disk();
        let (pictures_bytes, blobs_bytes) =
            (sizes.map(|sizes| sizes.pictures_bytes), sizes.map(|sizes| sizes.blobs_bytes));
        DiskView { free_bytes, total_bytes, pictures_bytes, blobs_bytes }
    }

    /// Every metric, in the `OpenMetrics` format; `pool_workers` is the target number of local workers.
    pub(crate) async fn text(&self, pool_workers: u32, shares: &Shares) -> Result<String, DatabaseError> {
        let counts = self.counts().await?;
        let sizes = self.sizes().await;
        self.set_queue(&counts, pool_workers);
        self.set_totals(&self.counters);
        self.set_shares(shares);
        self.set_machine(sizes, host::process());
        self.set_database(self.queue.database_bytes().await?);
        self.set_devices();
        Ok(self.metrics.text())
    }

    fn set_queue(&self, counts: &QueueStats, pool_workers: u32) {
        let metrics = &self.metrics;
        let state = |name: &str| vec![("state", name.to_owned())];
        let jobs = ["queued", "running", "succeeded", "failed", "cancelled"];
        replace(&metrics.jobs, jobs.map(|name| (state(name), counts.jobs_in(name) as f64)));
        let unopened = (counts.tiles_left - counts.tiles_ready - counts.leases).max(0);
        let tiles = [
            ("ready", counts.tiles_ready),
            ("leased", counts.leases),
            ("done", counts.tiles_done),
            ("unopened", unopened),
        ];
        replace(&metrics.tiles, tiles.map(|(name, number)| (state(name), number as f64)));
        let mut workers: HashMap<&str, i64> =
            ["starting", "ready", "draining", "quarantined"].map(|name| (name, 0)).into();
        let mut speeds: HashMap<&str, f64> = HashMap::new();
        for group in &counts.workers {
            *workers.entry(&group.state).or_default() += group.number;
            if group.state == "ready" {
                *speeds.entry(&group.device).or_default() += group.rays_per_second;
            }
        }
        replace(&metrics.workers, workers.into_iter().map(|(name, number)| (state(name), number as f64)));
        let device = |name: &str| vec![("device", name.to_owned())];
        replace(&metrics.rays_per_second, speeds.into_iter().map(|(name, speed)| (device(name), speed)));
        metrics.pool_workers.set(pool_workers.into());
        metrics.oldest_seconds.set(counts.oldest_seconds);
        metrics.oldest_queued_seconds.set(counts.oldest_queued_seconds);
        metrics.rays_left.set(counts.rays_left as f64);
        metrics.work_seconds.set(counts.work_seconds());
    }

    fn set_totals(&self, totals: &ServerCounters) {
        let metrics = &self.metrics;
        for (counter, total) in [
            (&metrics.expired, &totals.expired),
            (&metrics.fenced, &totals.fenced),
            (&metrics.nondeterministic, &totals.nondeterministic),
            (&metrics.rejected, &totals.rejected),
            (&metrics.verified, &totals.verified),
            (&metrics.refuted, &totals.refuted),
            (&metrics.unverified, &totals.unverified),
            (&metrics.webhook_failures, &totals.webhook_failures),
            (&metrics.hints_sent, &totals.hints_sent),
            (&metrics.hints_received, &totals.hints_received),
        ] {
            counter.inner().store(total.load(Ordering::Relaxed), Ordering::Relaxed);
        }
        metrics.servers.set(1.0 + totals.other_servers.load(Ordering::Relaxed) as f64);
    }

    fn set_shares(&self, shares: &Shares) {
        let class = |name: &str| vec![("class", name.to_owned())];
        let requests = shares.requests_in_progress();
        replace(&self.metrics.requests, requests.map(|(name, count)| (class(name), count as f64)));
        self.metrics.body_bytes.set(shares.body_bytes() as f64);
    }

    fn set_machine(&self, sizes: FolderSizes, process: Process) {
        let metrics = &self.metrics;
        let kind = |name: &str| vec![("kind", name.to_owned())];
        let stored = [("pictures", sizes.pictures_bytes), ("tiles", sizes.blobs_bytes)];
        replace(&metrics.store_bytes, stored.map(|(name, bytes)| (kind(name), bytes as f64)));
        for (level, value) in [
            (&metrics.uptime_seconds, self.uptime().as_secs_f64()),
            (&metrics.disk_free_bytes, sizes.disk.free_bytes as f64),
            (&metrics.disk_bytes, sizes.disk.total_bytes as f64),
            (&metrics.resident_bytes, process.resident_bytes as f64),
            (&metrics.open_files, process.open_files as f64),
            (&metrics.max_files, process.max_files as f64),
        ] {
            level.set(value);
        }
        metrics.cpu_seconds.inner().store(process.cpu_seconds.to_bits(), Ordering::Relaxed);
    }

    /// Sets the size of the database, which is `remote_bytes` unless it is a file.
    fn set_database(&self, remote_bytes: Option<u64>) {
        let file = Database::file(&self.data);
        let (database, wal) = match remote_bytes {
            Some(bytes) => (bytes, 0),
            None => (host::file_bytes(&file), host::file_bytes(&file.with_extension("sqlite-wal"))),
        };
        self.metrics.database_bytes.set(database as f64);
        self.metrics.wal_bytes.set(wal as f64);
    }

    fn set_devices(&self) {
        let mut devices = self.devices.lock().expect("no holder panics");
        devices.retain(|_, seen| seen.at.elapsed() < DEVICE_TTL);
        let memories: Vec<(Labels, DeviceMemory)> = devices
            .values()
            .filter_map(|seen| {
                Some((vec![("worker", seen.name.clone()), ("device", seen.device.clone())], seen.memory?))
            })
            .collect();
        let used = memories.iter().map(|(labels, memory)| (labels.clone(), memory.used_bytes as f64));
        replace(&self.metrics.gpu_used_bytes, used);
        let total = memories.iter().map(|(labels, memory)| (labels.clone(), memory.total_bytes as f64));
        replace(&self.metrics.gpu_bytes, total);
    }
}
