//! Metrics and status for operators, and how they are collected.
//!
//! It only reads and counts; nothing in the farm depends on it. Counting takes a bounded fraction of the
//! time: counts are cached for 1 s, or longer if counting took long.

pub(crate) mod host;
mod metrics;

use std::collections::{HashMap, VecDeque};
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::Ordering;
use std::time::Duration;

use proto::worker_protocol::{DeviceMemory, MAX_TIMINGS, WorkerMetrics};
use proto::{JobId, WorkerId};
use tokio::time::Instant;

use crate::clock::instant;
use crate::database::{Store, StoreError};
use crate::farm::{Farm, Totals};
use crate::queue::Counts;
use host::{Disk, Process};
use metrics::{Labels, set_all};
pub(crate) use metrics::{Metrics, counts, seconds};

/// How long counts are cached.
const KEEP_COUNTS: Duration = Duration::from_secs(1);
/// How long the sizes of folders are cached.
const KEEP_SIZES: Duration = Duration::from_secs(30);
/// Counting takes at most one part in this many of the time.
const SHARE: u32 = 20;
/// How long a worker's GPU is shown after its last report.
const KEEP_DEVICE: Duration = Duration::from_mins(2);
/// Jobs whose traces are remembered.
const KEPT_TRACES: usize = 64;
/// Longer than any phase of a batch; longer durations are rejected as invalid.
const MAX_TOOK_MS: f64 = 1e9;

/// Metrics and caches of the server.
#[derive(Debug)]
pub(crate) struct Watch {
    /// Metrics counted as they happen.
    pub(crate) metrics: Metrics,
    started: Instant,
    data: PathBuf,
    counts: tokio::sync::Mutex<Option<Kept<Counts>>>,
    sizes: tokio::sync::Mutex<Option<Kept<Sizes>>>,
    devices: Mutex<HashMap<WorkerId, Seen>>,
    traces: Mutex<VecDeque<(JobId, Option<String>)>>,
}

/// Sizes in the data folder.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sizes {
    pictures_bytes: u64,
    blobs_bytes: u64,
    disk: Disk,
}

/// Cached value and its expiry.
#[derive(Debug)]
struct Kept<T> {
    value: T,
    until: Instant,
}

impl<T: Clone> Kept<T> {
    fn get(kept: Option<&Self>) -> Option<T> {
        kept.filter(|kept| instant() < kept.until).map(|kept| kept.value.clone())
    }

    fn new(value: T, begun: Instant, keep: Duration) -> Self {
        Self { value, until: instant() + keep.max(begun.elapsed() * SHARE) }
    }
}

/// A worker's device.
#[derive(Debug)]
struct Seen {
    name: String,
    device: String,
    memory: Option<DeviceMemory>,
    at: Instant,
}

impl Watch {
    /// Watches a server that starts now.
    pub(crate) fn new(data: PathBuf, store: &Store) -> Self {
        Self {
            metrics: Metrics::new(store.commits()),
            started: instant(),
            data,
            counts: tokio::sync::Mutex::default(),
            sizes: tokio::sync::Mutex::default(),
            devices: Mutex::default(),
            traces: Mutex::default(),
        }
    }

    /// A worker registered.
    pub(crate) fn registered(&self, worker: WorkerId, name: &str, device: &str) {
        let mut devices = self.devices.lock().expect("no holder panics");
        devices.retain(|_, seen| seen.at.elapsed() < KEEP_DEVICE);
        let seen = Seen { name: name.to_owned(), device: device.to_owned(), memory: None, at: instant() };
        devices.insert(worker, seen);
    }

    /// Records a worker's measurements. For a worker that registered with an earlier server, only its
    /// speed is known.
    pub(crate) fn measured(&self, worker: WorkerId, measured: &WorkerMetrics) {
        let mut devices = self.devices.lock().expect("no holder panics");
        let Some(seen) = devices.get_mut(&worker) else { return };
        seen.at = instant();
        seen.memory = measured.memory.or(seen.memory);
        let is_sound = |took_ms: f64| (0.0..MAX_TOOK_MS).contains(&took_ms);
        for timing in measured.timings.iter().take(MAX_TIMINGS).filter(|timing| is_sound(timing.took_ms)) {
            self.metrics.took(&seen.device, timing);
        }
    }

    /// The trace that a job belongs to, of which the newest are remembered.
    pub(crate) async fn trace_of(&self, farm: &Farm, job: JobId) -> Result<Option<String>, StoreError> {
        let known = |traces: &VecDeque<(JobId, Option<String>)>| {
            traces.iter().find(|(id, _)| *id == job).map(|(_, trace)| trace.clone())
        };
        if let Some(trace) = known(&self.traces.lock().expect("no holder panics")) {
            return Ok(trace);
        }
        let trace = farm.queue.trace_of(job).await?;
        let mut traces = self.traces.lock().expect("no holder panics");
        traces.push_front((job, trace.clone()));
        traces.truncate(KEPT_TRACES);
        Ok(trace)
    }

    /// Time since the start.
    pub(crate) fn uptime(&self) -> Duration {
        self.started.elapsed()
    }

    /// Current counts, cached for a short time.
    pub(crate) async fn counts(&self, farm: &Farm) -> Result<Counts, StoreError> {
        let mut kept = self.counts.lock().await;
        if let Some(counts) = Kept::get(kept.as_ref()) {
            return Ok(counts);
        }
        let begun = instant();
        let counts = farm.queue.counts().await?;
        *kept = Some(Kept::new(counts.clone(), begun, KEEP_COUNTS));
        Ok(counts)
    }

    /// Sizes in the data folder, cached for 30 s.
    pub(crate) async fn sizes(&self) -> Sizes {
        let mut kept = self.sizes.lock().await;
        if let Some(sizes) = Kept::get(kept.as_ref()) {
            return sizes;
        }
        let (begun, data) = (instant(), self.data.clone());
        let measure = move || Sizes {
            pictures_bytes: host::folder_bytes(&data.join("pictures")),
            blobs_bytes: host::folder_bytes(&data.join("tiles")),
            disk: host::disk(&data),
        };
        let sizes = tokio::task::spawn_blocking(measure).await.unwrap_or_default();
        *kept = Some(Kept::new(sizes, begun, KEEP_SIZES));
        sizes
    }

    /// Every metric, in the `OpenMetrics` format.
    pub(crate) async fn text(&self, farm: &Farm) -> Result<String, StoreError> {
        let counts = self.counts(farm).await?;
        let sizes = self.sizes().await;
        self.set_queue(&counts, farm.pool.wanted());
        self.set_totals(&farm.totals);
        self.set_machine(sizes, host::process());
        self.set_devices();
        Ok(self.metrics.text())
    }

    fn set_queue(&self, counts: &Counts, pool_workers: u32) {
        let metrics = &self.metrics;
        let state = |name: &str| vec![("state", name.to_owned())];
        let jobs = ["queued", "running", "succeeded", "failed", "cancelled"];
        set_all(&metrics.jobs, jobs.map(|name| (state(name), counts.jobs_in(name) as f64)));
        let unopened = (counts.tiles_left - counts.tiles_ready - counts.leases).max(0);
        let tiles = [
            ("ready", counts.tiles_ready),
            ("leased", counts.leases),
            ("done", counts.tiles_done),
            ("unopened", unopened),
        ];
        set_all(&metrics.tiles, tiles.map(|(name, number)| (state(name), number as f64)));
        let mut workers: HashMap<&str, i64> =
            ["starting", "ready", "draining", "quarantined"].map(|name| (name, 0)).into();
        let mut speeds: HashMap<&str, f64> = HashMap::new();
        for group in &counts.workers {
            *workers.entry(&group.state).or_default() += group.number;
            if group.state == "ready" {
                *speeds.entry(&group.device).or_default() += group.rays_per_second;
            }
        }
        set_all(&metrics.workers, workers.into_iter().map(|(name, number)| (state(name), number as f64)));
        let device = |name: &str| vec![("device", name.to_owned())];
        set_all(&metrics.rays_per_second, speeds.into_iter().map(|(name, speed)| (device(name), speed)));
        metrics.pool_workers.set(pool_workers.into());
        metrics.oldest_seconds.set(counts.oldest_seconds);
        metrics.oldest_queued_seconds.set(counts.oldest_queued_seconds);
        metrics.rays_left.set(counts.rays_left as f64);
        metrics.work_seconds.set(counts.work_seconds());
    }

    fn set_totals(&self, totals: &Totals) {
        let metrics = &self.metrics;
        for (counter, total) in [
            (&metrics.expired, &totals.expired),
            (&metrics.fenced, &totals.fenced),
            (&metrics.nondeterministic, &totals.nondeterministic),
            (&metrics.webhook_failures, &totals.webhook_failures),
        ] {
            counter.inner().store(total.load(Ordering::Relaxed), Ordering::Relaxed);
        }
    }

    fn set_machine(&self, sizes: Sizes, process: Process) {
        let metrics = &self.metrics;
        let kind = |name: &str| vec![("kind", name.to_owned())];
        let stored = [("pictures", sizes.pictures_bytes), ("tiles", sizes.blobs_bytes)];
        set_all(&metrics.store_bytes, stored.map(|(name, bytes)| (kind(name), bytes as f64)));
        let file = Store::file(&self.data);
        for (level, value) in [
            (&metrics.uptime_seconds, self.uptime().as_secs_f64()),
            (&metrics.database_bytes, host::file_bytes(&file) as f64),
            (&metrics.wal_bytes, host::file_bytes(&file.with_extension("sqlite-wal")) as f64),
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

    fn set_devices(&self) {
        let mut devices = self.devices.lock().expect("no holder panics");
        devices.retain(|_, seen| seen.at.elapsed() < KEEP_DEVICE);
        let memories: Vec<(Labels, DeviceMemory)> = devices
            .values()
            .filter_map(|seen| {
                Some((vec![("worker", seen.name.clone()), ("device", seen.device.clone())], seen.memory?))
            })
            .collect();
        let used = memories.iter().map(|(labels, memory)| (labels.clone(), memory.used_bytes as f64));
        set_all(&self.metrics.gpu_used_bytes, used);
        let total = memories.iter().map(|(labels, memory)| (labels.clone(), memory.total_bytes as f64));
        set_all(&self.metrics.gpu_bytes, total);
    }
}
