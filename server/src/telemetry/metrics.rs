//! All metrics by name: those counted as they happen, and those set when `/metrics` is read.
//!
//! Names and meanings are in `docs/operations.md`, which a test compares with this file. Nothing here waits or
//! does I/O.

use std::sync::atomic::AtomicU64;
use std::time::Duration;

use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::{Metric, Registry};
use proto::worker_protocol::{Phase, Timing};

use crate::blobs::StoreLocation;
use crate::db::CommitTimes;
use crate::histograms::seconds;

/// Labels of a sample.
pub(super) type Labels = Vec<(&'static str, String)>;
/// Gauge metric.
pub(super) type FloatGauge = Gauge<f64, AtomicU64>;
/// Gauges by labels.
pub(super) type GaugeFamily = Family<Labels, FloatGauge>;
/// Histograms of durations by labels.
type HistogramFamily = Family<Labels, Histogram>;

/// HTTP methods with a label value of their own; all others share one.
const METHODS: [&str; 7] = ["GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"];

/// Every metric.
#[derive(Debug)]
pub(crate) struct Metrics {
    registry: Registry,
    pub(super) uptime_seconds: FloatGauge,
    pub(super) jobs: GaugeFamily,
    pub(super) tiles: GaugeFamily,
    pub(super) workers: GaugeFamily,
    pub(super) pool_workers: FloatGauge,
    pub(super) oldest_seconds: FloatGauge,
    pub(super) oldest_queued_seconds: FloatGauge,
    pub(super) rays_left: FloatGauge,
    pub(super) work_seconds: FloatGauge,
    pub(super) rays_per_second: GaugeFamily,
    pub(super) expired: Counter,
    pub(super) fenced: Counter,
    pub(super) nondeterministic: Counter,
    pub(super) rejected: Counter,
    pub(super) verified: Counter,
    pub(super) refuted: Counter,
    pub(super) unverified: Counter,
    pub(super) webhook_failures: Counter,
    pub(super) hints_sent: Counter,
    pub(super) hints_received: Counter,
    pub(super) servers: FloatGauge,
    pub(super) requests: GaugeFamily,
    pub(super) body_bytes: FloatGauge,
    pub(super) database_bytes: FloatGauge,
    pub(super) wal_bytes: FloatGauge,
    pub(super) store_bytes: GaugeFamily,
    pub(super) disk_free_bytes: FloatGauge,
    pub(super) disk_bytes: FloatGauge,
    pub(super) gpu_used_bytes: GaugeFamily,
    pub(super) gpu_bytes: GaugeFamily,
    pub(super) resident_bytes: FloatGauge,
    pub(super) cpu_seconds: Counter<f64, AtomicU64>,
    pub(super) open_files: FloatGauge,
    pub(super) max_files: FloatGauge,
    rays: Family<Labels, Counter>,
    render: HistogramFamily,
    encode: HistogramFamily,
    deliver: HistogramFamily,
    claim: Histogram,
    responses: Family<Labels, Counter>,
    http: HistogramFamily,
}

struct Registrar(Registry);

impl Registrar {
    fn add<M: Metric + Clone>(&mut self, name: &str, help: &str, metric: M) -> M {
        self.0.register(name, help, metric.clone());
        metric
    }

    fn gauge(&mut self, name: &str, help: &str) -> FloatGauge {
        self.add(name, help, FloatGauge::default())
    }

    fn gauges(&mut self, name: &str, help: &str) -> GaugeFamily {
        self.add(name, help, GaugeFamily::default())
    }

    fn counter(&mut self, name: &str, help: &str) -> Counter {
        self.add(name, help, Counter::default())
    }

    fn histograms(&mut self, name: &str, help: &str) -> HistogramFamily {
        self.add(name, help, HistogramFamily::new_with_constructor(seconds))
    }
}

impl Metrics {
    /// Creates all metrics, including the database writer's.
    pub(super) fn new(commits: &CommitTimes, location: &StoreLocation) -> Self {
        let mut book = Registrar(Registry::default());
        let build = vec![
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("picture_version", scene::PICTURE_VERSION.to_string()),
        ];
        book.0.register("sdfarm_build", "Version of the server", Info::new(build));
        let store = vec![("kind", location.kind().to_owned()), ("location", location.to_string())];
        book.0.register("sdfarm_store", "Store of pictures and tiles", Info::new(store));
        book.add("sdfarm_commit_seconds", "Duration of a database commit", commits.seconds.clone());
        let longest = "Longest database transaction since the start";
        book.add("sdfarm_commit_longest_seconds", longest, commits.longest_seconds.clone());
        book.add("sdfarm_commit_operations", "Operations in one database commit", commits.operations.clone());
        let begin = "Time until a database transaction that writes has begun, with the wait for other servers";
        book.add("sdfarm_commit_begin_seconds", begin, commits.begin_seconds.clone());
        let lost = "Connections to the database that ended while the server used them to write";
        book.add("sdfarm_database_connections_lost", lost, commits.connections_lost.clone());
        Self {
            uptime_seconds: book.gauge("sdfarm_uptime_seconds", "Time since the server started"),
            jobs: book.gauges("sdfarm_jobs", "Jobs by state"),
            tiles: book.gauges("sdfarm_tiles", "Tiles of unfinished jobs by state"),
            workers: book.gauges("sdfarm_workers", "Workers by state"),
            pool_workers: book.gauge("sdfarm_pool_workers", "Target number of local workers"),
            oldest_seconds: book.gauge("sdfarm_queue_oldest_job_seconds", "Age of the oldest unfinished job"),
            oldest_queued_seconds: book
                .gauge("sdfarm_queue_oldest_queued_job_seconds", "Age of the oldest job without a leased tile"),
            rays_left: book.gauge("sdfarm_queue_rays", "Camera rays of unfinished jobs still to be rendered"),
            work_seconds: book
                .gauge("sdfarm_queue_work_seconds", "Time to finish the queue at the speed of the ready workers"),
            rays_per_second: book
                .gauges("sdfarm_rays_per_second", "Measured camera rays per second of ready workers, by device"),
            expired: book.counter("sdfarm_leases_expired", "Expired leases"),
            fenced: book.counter("sdfarm_results_fenced", "Results without effect because their lease had ended"),
            nondeterministic: book
                .counter("sdfarm_nondeterministic_tiles", "Tiles that two workers rendered differently"),
            rejected: book.counter("sdfarm_results_rejected", "Results that were not what was asked for"),
            verified: book.counter("sdfarm_results_verified", "Results that another worker rendered again identically"),
            refuted: book.counter("sdfarm_results_refuted", "Results that another worker rendered again differently"),
            unverified: book
                .counter("sdfarm_results_unverified", "Results chosen for verification that no other worker rendered"),
            webhook_failures: book.counter("sdfarm_webhook_failures", "Failed attempts to deliver a webhook"),
            hints_sent: book.counter("sdfarm_hints_sent", "Messages to the other servers of the database"),
            hints_received: book.counter("sdfarm_hints_received", "Messages of the other servers of the database"),
            servers: book.gauge("sdfarm_servers", "Servers of the database"),
            requests: book.gauges(
                "sdfarm_requests_in_progress",
                "Requests in progress, with unread responses, by class of caller",
            ),
            body_bytes: book.gauge("sdfarm_body_bytes", "Bytes of request bodies in memory"),
            database_bytes: book.gauge("sdfarm_database_bytes", "Size of the database's file"),
            wal_bytes: book.gauge("sdfarm_wal_bytes", "Size of the database's write-ahead log"),
            store_bytes: book.gauges("sdfarm_store_bytes", "Stored bytes, by kind"),
            disk_free_bytes: book.gauge("sdfarm_disk_free_bytes", "Free space on the data folder's disk"),
            disk_bytes: book.gauge("sdfarm_disk_bytes", "Size of the data folder's disk"),
            gpu_used_bytes: book.gauges("sdfarm_gpu_memory_used_bytes", "Used memory of a worker's GPU"),
            gpu_bytes: book.gauges("sdfarm_gpu_memory_bytes", "Memory of a worker's GPU"),
            resident_bytes: book.gauge("process_resident_memory_bytes", "Memory of the server's process"),
            cpu_seconds: book.add("process_cpu_seconds", "CPU time of the server's process", Counter::default()),
            open_files: book.gauge("process_open_fds", "Open files of the server's process"),
            max_files: book.gauge("process_max_fds", "Maximum number of open files of the server's process"),
            rays: book.add("sdfarm_rays", "Rendered camera rays, by device", Family::default()),
            render: book
                .histograms("sdfarm_render_seconds", "Time to render tiles that were sent to the device together"),
            encode: book.histograms("sdfarm_encode_seconds", "Time to encode a picture"),
            deliver: book.histograms("sdfarm_deliver_seconds", "Time to deliver a blob or a picture to the server"),
            claim: book.add("sdfarm_claim_seconds", "Time to find work for a worker's request", seconds()),
            responses: book.add("sdfarm_http_answers", "Responses by route, method and status", Family::default()),
            http: book.histograms("sdfarm_http_seconds", "Time to the first byte of a response, by route"),
            registry: book.0,
        }
    }

    /// All metrics as text, in the `OpenMetrics` format.
    pub(super) fn text(&self) -> String {
        let mut text = String::new();
        encode(&mut text, &self.registry).expect("writing to a string");
        text
    }

    /// Records a response.
    pub(crate) fn record_response(&self, route: &str, method: &str, status: u16, took: Duration) {
        let route = if route.is_empty() { "none" } else { route }.to_owned();
        let method = METHODS.into_iter().find(|known| *known == method).unwrap_or("other").to_owned();
        self.http.get_or_create(&vec![("route", route.clone())]).observe(took.as_secs_f64());
        let labels = vec![("route", route), ("method", method), ("status", status.to_string())];
        self.responses.get_or_create(&labels).inc();
    }

    /// Records a claim.
    pub(crate) fn record_claim(&self, took: Duration) {
        self.claim.observe(took.as_secs_f64());
    }

    /// Records a measurement of a worker on a device of this kind.
    pub(super) fn record_timing(&self, device: &str, timing: &Timing) {
        let (times, device) = match timing.phase {
            Phase::Render => (&self.render, device),
            Phase::Encode => (&self.encode, device),
            Phase::Deliver => (&self.deliver, device),
        };
        let labels = vec![("device", device.to_owned())];
        times.get_or_create(&labels).observe(timing.took_ms / 1e3);
        if timing.rays > 0 {
            self.rays.get_or_create(&labels).inc_by(timing.rays);
        }
    }
}

/// Sets a metric's gauges to these values and removes all others.
pub(super) fn replace(levels: &GaugeFamily, values: impl IntoIterator<Item = (Labels, f64)>) {
    levels.clear();
    for (labels, value) in values {
        levels.get_or_create(&labels).set(value);
    }
}
