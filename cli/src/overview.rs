//! State of a farm as its server reports it: collected once, shown as text, JSON or live.

mod openmetrics;

use proto::alert::{AlertSeverity, AlertView};
use proto::job::{JobState, JobView};
use proto::pool::{PoolView, WorkerView};
use proto::scaling::ScalingView;
use proto::{Client, ClientError, rounding};
use serde::Serialize;

use crate::counted::counted;
use openmetrics::Metrics;

/// Unfinished jobs that are listed, at most.
const JOBS: u32 = 50;
/// Fraction of a GPU's memory that counts as full.
const FULL_GPU: f64 = 0.95;

/// State of a farm.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Overview {
    /// The server's address.
    pub(crate) server: String,
    /// `ready`, `degraded`, or the reason why neither holds.
    pub(crate) health: String,
    /// The release.
    pub(crate) version: String,
    /// Seconds since its start.
    pub(crate) uptime_seconds: f64,
    /// Whether the farm is paused: no new tiles are leased until it is resumed.
    pub(crate) paused: bool,
    /// Remaining work.
    pub(crate) queue: QueueOverview,
    /// Counters since the start.
    pub(crate) totals: TotalsOverview,
    /// The local pool.
    pub(crate) pool: PoolView,
    /// Workers that have not exited or vanished.
    pub(crate) workers: Vec<WorkerView>,
    /// Workers that would finish the backlog in ten minutes.
    pub(crate) scaling: ScalingView,
    /// Unfinished jobs, running ones first.
    pub(crate) jobs: Vec<JobView>,
    /// The data folder.
    pub(crate) disk: DiskOverview,
    /// Conditions that need an operator, as the server says.
    pub(crate) alerts: Vec<AlertView>,
    /// Warnings: the alerts, and what the counters show.
    pub(crate) warnings: Vec<String>,
}

/// Workers that there are, and that are wanted.
#[derive(Debug)]
struct Capacity {
    pool: PoolView,
    workers: Vec<WorkerView>,
    scaling: ScalingView,
}

/// Remaining work.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct QueueOverview {
    /// Jobs without any lease so far.
    pub(crate) queued: u64,
    /// Running jobs.
    pub(crate) running: u64,
    /// Tiles that could be leased.
    pub(crate) tiles_ready: u64,
    /// Live leases.
    pub(crate) tiles_leased: u64,
    /// Seconds of work; `None` without workers.
    pub(crate) work_seconds: Option<f64>,
    /// Age of the oldest unfinished job.
    pub(crate) oldest_seconds: f64,
    /// Camera rays a second, of all ready workers.
    pub(crate) rays_per_second: f64,
}

/// Counters since the start.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct TotalsOverview {
    /// Expired leases.
    pub(crate) expired: u64,
    /// Fenced results: their lease had ended.
    pub(crate) fenced: u64,
    /// Tiles that two workers rendered differently.
    pub(crate) nondeterministic: u64,
    /// Failed webhook deliveries.
    pub(crate) webhook_failures: u64,
    /// Responses with status 429.
    pub(crate) rate_limited: u64,
    /// Responses with status 5xx.
    pub(crate) server_errors: u64,
}

/// The data folder.
#[derive(Clone, Copy, Debug, Serialize)]
#[expect(clippy::struct_field_names, reason = "units come last in names")]
pub(crate) struct DiskOverview {
    /// Free space.
    pub(crate) free_bytes: u64,
    /// Size of the disk.
    pub(crate) total_bytes: u64,
    /// Pictures and tiles.
    pub(crate) store_bytes: u64,
    /// The database and its log.
    pub(crate) database_bytes: u64,
}

/// Collects the state from the server.
pub(crate) async fn fetch(client: &Client) -> Result<Overview, ClientError> {
    let health = match client.ready().await {
        Ok(ready) => ready.status,
        Err(ClientError::Problem(problem)) => problem.detail.clone(),
        Err(error) => return Err(error),
    };
    let samples = Metrics::read(&client.metrics().await?);
    let (pool, workers) = (client.pool().await?, client.workers().await?.workers);
    let capacity = Capacity { pool, workers, scaling: client.scaling().await? };
    let (paused, alerts) = (client.farm().await?.paused, client.alerts().await?);
    let mut jobs = client.jobs(Some(JobState::Running), JOBS, None).await?.jobs;
    jobs.extend(client.jobs(Some(JobState::Queued), JOBS, None).await?.jobs);
    Ok(Overview::from_parts(client.server(), health, &samples, paused, capacity, jobs, alerts))
}

impl Overview {
    fn from_parts(
        server: &str,
        health: String,
        samples: &Metrics,
        paused: bool,
        capacity: Capacity,
        jobs: Vec<JobView>,
        alerts: Vec<AlertView>,
    ) -> Self {
        let Capacity { pool, workers, scaling } = capacity;
        let sum = |name: &str| samples.sum(name, &[]);
        let count = |name: &str, labels: &[(&str, &str)]| samples.sum(name, labels) as u64;
        let answers =
            |matches: &dyn Fn(&str) -> bool| samples.sum_where("sdfarm_http_answers_total", "status", matches);
        let queue = QueueOverview {
            queued: count("sdfarm_jobs", &[("state", "queued")]),
            running: count("sdfarm_jobs", &[("state", "running")]),
            tiles_ready: count("sdfarm_tiles", &[("state", "ready")]),
            tiles_leased: count("sdfarm_tiles", &[("state", "leased")]),
            work_seconds: Some(sum("sdfarm_queue_work_seconds"))
                .filter(|seconds| seconds.is_finite())
                .map(rounding::seconds),
            oldest_seconds: rounding::seconds(sum("sdfarm_queue_oldest_job_seconds")),
            rays_per_second: rounding::rate(sum("sdfarm_rays_per_second")),
        };
        let totals = TotalsOverview {
            expired: count("sdfarm_leases_expired_total", &[]),
            fenced: count("sdfarm_results_fenced_total", &[]),
            nondeterministic: count("sdfarm_nondeterministic_tiles_total", &[]),
            webhook_failures: count("sdfarm_webhook_failures_total", &[]),
            rate_limited: answers(&|status| status == "429") as u64,
            server_errors: answers(&|status| status.starts_with('5')) as u64,
        };
        let disk = DiskOverview {
            free_bytes: count("sdfarm_disk_free_bytes", &[]),
            total_bytes: count("sdfarm_disk_bytes", &[]),
            store_bytes: count("sdfarm_store_bytes", &[]),
            database_bytes: count("sdfarm_database_bytes", &[]) + count("sdfarm_wal_bytes", &[]),
        };
        let mut overview = Self {
            server: server.to_owned(),
            health,
            version: samples.label("sdfarm_build_info", "version").unwrap_or("unknown").to_owned(),
            uptime_seconds: rounding::seconds(sum("sdfarm_uptime_seconds")),
            paused,
            queue,
            totals,
            pool,
            workers,
            scaling,
            jobs,
            disk,
            alerts,
            warnings: Vec::new(),
        };
        overview.warnings = overview.warnings(samples);
        overview
    }

    /// Whether the farm is ready or degraded.
    pub(crate) fn is_healthy(&self) -> bool {
        ["ready", "degraded"].contains(&self.health.as_str())
    }

    fn warnings(&self, samples: &Metrics) -> Vec<String> {
        let mut worries: Vec<String> =
            self.alerts.iter().map(|alert| format!("{}: {}", alert.message, alert.cure)).collect();
        let is_explained = self.alerts.iter().any(|alert| alert.severity == AlertSeverity::Critical);
        let mut worry = |is_so: bool, text: String| {
            if is_so {
                worries.push(text);
            }
        };
        let TotalsOverview { expired, fenced, server_errors, .. } = self.totals;
        worry(!self.is_healthy() && !is_explained, self.health.clone());
        worry(expired > 0, format!("{} expired", counted(expired, "lease")));
        worry(fenced > 0, format!("{} arrived too late", counted(fenced, "result")));
        worry(server_errors > 0, format!("{} failed in the server", counted(server_errors, "request")));
        let (used, all) =
            (samples.sum("sdfarm_gpu_memory_used_bytes", &[]), samples.sum("sdfarm_gpu_memory_bytes", &[]));
        worry(all > 0.0 && used / all > FULL_GPU, "the GPUs' memory is almost full".to_owned());
        worries
    }
}

/// Formats a duration in its two largest units: `3 h 20 min`.
pub(crate) fn duration(seconds: f64) -> String {
    let whole = seconds.max(0.0).round() as u64;
    let (days, hours, minutes) = (whole / 86_400, whole / 3600 % 24, whole / 60 % 60);
    match (days, hours, minutes) {
        (0, 0, 0) if seconds < 10.0 => format!("{:.1} s", seconds.max(0.0)),
        (0, 0, 0) => format!("{whole} s"),
        (0, 0, minutes) => format!("{minutes} min {} s", whole % 60),
        (0, hours, minutes) => format!("{hours} h {minutes} min"),
        (days, hours, _) => format!("{days} d {hours} h"),
    }
}

/// Formats a number in thousands, millions, and so on.
pub(crate) fn scaled(number: f64) -> String {
    let units = [(1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k")];
    let found = units.into_iter().find(|(unit, _)| number >= *unit);
    found.map_or_else(|| format!("{number:.0} "), |(unit, name)| format!("{:.1} {name}", number / unit))
}

#[cfg(test)]
pub(crate) mod tests {
    use proto::scaling::DeviceScaling;

    use super::*;

    /// Sample of an unhealthy farm.
    pub(crate) fn unhealthy() -> Overview {
        let samples = Metrics::read(
            "sdfarm_build_info{version=\"1.2.3\",picture_version=\"4\"} 1\n\
             sdfarm_uptime_seconds 12000.0\n\
             sdfarm_jobs{state=\"queued\"} 4.0\nsdfarm_jobs{state=\"running\"} 1.0\n\
             sdfarm_tiles{state=\"ready\"} 90.0\nsdfarm_tiles{state=\"leased\"} 8.0\n\
             sdfarm_queue_work_seconds 3700.0\nsdfarm_queue_oldest_job_seconds 7300.0\n\
             sdfarm_rays_per_second{device=\"cpu\"} 2000000.0\nsdfarm_rays_per_second{device=\"cuda:0\"} 9000000.0\n\
             sdfarm_nondeterministic_tiles_total 2\nsdfarm_leases_expired_total 3\n\
             sdfarm_http_answers_total{route=\"/v1/jobs\",method=\"POST\",status=\"429\"} 5\n\
             sdfarm_http_answers_total{route=\"/v1/jobs\",method=\"POST\",status=\"507\"} 1\n\
             sdfarm_disk_free_bytes 1000000000.0\nsdfarm_disk_bytes 9000000000.0\n\
             sdfarm_store_bytes{kind=\"pictures\"} 500.0\nsdfarm_store_bytes{kind=\"tiles\"} 70.0\n# EOF\n",
        );
        let worker = r#"{"id": "01890a5d-ac96-774b-bcce-b302099a8057", "name": "pool-1", "device": "cpu",
            "state": "ready", "rays_per_second": 2000000.0, "leases": 8}"#;
        let job = r#"{"id": "01890a5d-ac96-774b-bcce-b302099a8058", "name": "fjord", "state": "running",
            "progress": 0.25, "tiles": {"done": 2, "total": 8}, "frames": {"done": 0, "total": 1}, "errors": [],
            "warnings": [], "created_at": "2026-01-01T00:00:00Z", "started_at": null, "finished_at": null,
            "eta_seconds": 75.0}"#;
        let held =
            job.replace("\"state\"", "\"paused\": true, \"state\"").replace("fjord", "lantern").replace("75.0", "null");
        Overview::from_parts(
            "http://127.0.0.1:8080",
            "ready".to_owned(),
            &samples,
            true,
            Capacity {
                pool: PoolView { workers: 2, ready: 1 },
                workers: vec![serde_json::from_str(worker).expect("a worker")],
                scaling: ScalingView {
                    target_seconds: 600,
                    jobs: 2,
                    tiles: 100,
                    rays: 4_000_000_000,
                    cpu: DeviceScaling { wanted_workers: 4, ..DeviceScaling::default() },
                    cuda: DeviceScaling { wanted_workers: 1, ..DeviceScaling::default() },
                },
            },
            vec![serde_json::from_str(job).expect("a job"), serde_json::from_str(&held).expect("a job")],
            vec![AlertView {
                code: "farm_paused".to_owned(),
                severity: AlertSeverity::Warning,
                message: "the farm is paused".to_owned(),
                cure: "`sdfarm resume` continues it".to_owned(),
                since: "2026-01-01T00:00:00Z".to_owned(),
            }],
        )
    }

    #[test]
    fn overview_lists_its_warnings() {
        let overview = unhealthy();
        assert_eq!(
            overview.warnings,
            ["the farm is paused: `sdfarm resume` continues it", "3 leases expired", "1 request failed in the server",]
        );
        assert_eq!((overview.version.as_str(), overview.totals.rate_limited), ("1.2.3", 5));
        assert_eq!((overview.queue.rays_per_second, overview.disk.store_bytes), (11e6, 570));
    }

    #[test]
    fn durations_and_numbers_are_abbreviated() {
        let times = [(0.25, "0.2 s"), (42.0, "42 s"), (75.0, "1 min 15 s"), (3700.0, "1 h 1 min"), (2e5, "2 d 7 h")];
        for (seconds, text) in times {
            assert_eq!(duration(seconds), text);
        }
        for (number, text) in [(12.0, "12 "), (1.5e3, "1.5 k"), (11e6, "11.0 M"), (3e9, "3.0 G")] {
            assert_eq!(scaled(number), text);
        }
    }
}
