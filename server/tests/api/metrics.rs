//! Metrics: their names, their values, and their documentation.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use proto::worker_protocol::{DeviceMemory, Phase, Timing, WorkerMetrics};
use reqwest::StatusCode;

use super::harness::{Farm, LEASE, Said, in_time, job, read, small_job};

/// Samples of a metric: the text after its name, and the value.
pub(crate) struct Metrics(String);

impl Metrics {
    pub(crate) async fn of(farm: &Farm) -> Self {
        let answer = farm.get("/metrics").await;
        assert_eq!(answer.status(), StatusCode::OK);
        let kind = answer.headers()["content-type"].to_str().expect("text").to_owned();
        assert!(kind.starts_with("application/openmetrics-text; version=1.0.0"), "{kind}");
        Self(in_time(answer.text()).await.expect("text"))
    }

    /// Value of a sample, by its name with labels.
    pub(crate) fn value(&self, sample: &str) -> f64 {
        let line = self.0.lines().find_map(|line| line.strip_prefix(sample)?.strip_prefix(' '));
        line.unwrap_or_else(|| panic!("no {sample} in {}", self.0)).parse().expect("a number")
    }

    /// Metrics by name, with their kinds.
    fn kinds(&self) -> BTreeMap<String, String> {
        let lines = self.0.lines().filter_map(|line| line.strip_prefix("# TYPE "));
        lines.map(|line| line.split_once(' ').expect("a name and a kind")).map(|(a, b)| (a.into(), b.into())).collect()
    }
}

/// A farm in which every event that has a label has happened.
async fn busy_farm() -> Farm {
    let farm = Farm::start().await;
    farm.submit(&job(1920, 1080, 4)).await;
    let worker = farm.worker("gpu").await;
    let timing = |phase, took_ms, rays| Timing { phase, took_ms, rays };
    let measured = WorkerMetrics {
        timings: vec![
            timing(Phase::Render, 250.0, 1_000_000),
            timing(Phase::Encode, 20.0, 0),
            timing(Phase::Deliver, 3.0, 0),
            timing(Phase::Deliver, 1e300, 0),
            timing(Phase::Deliver, -1.0, 0),
        ],
        memory: Some(DeviceMemory { used_bytes: 1 << 30, total_bytes: 8 << 30 }),
    };
    worker.sync(Said { measured, ..Said::default() }).await;
    assert!(worker.work_once().await);
    farm
}

#[tokio::test]
async fn the_documentation_lists_exactly_the_metrics() {
    let farm = busy_farm().await;
    let metrics = Metrics::of(&farm).await;
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/operations.md");
    let page = std::fs::read_to_string(page).expect("the page is there");
    let received: BTreeMap<String, String> = page
        .lines()
        .filter_map(|line| {
            let cells: Vec<&str> = line.strip_prefix("| `")?.split(" | ").collect();
            let kind = cells.get(1).filter(|kind| ["counter", "gauge", "histogram", "info"].contains(*kind))?;
            let name = cells[0].split(['`', '{']).next()?;
            let name = name.strip_suffix("_total").or(name.strip_suffix("_info")).unwrap_or(name);
            Some((name.to_owned(), (*kind).to_owned()))
        })
        .collect();
    assert_eq!(metrics.kinds(), received, "left: measured; right: documented in docs/operations.md");
    farm.stop().await;
}

#[tokio::test]
async fn worker_measurements_are_reported_by_device() {
    let farm = busy_farm().await;
    let metrics = Metrics::of(&farm).await;
    for (sample, value) in [
        ("sdfarm_render_seconds_sum{device=\"cpu\"}", 0.25),
        ("sdfarm_render_seconds_count{device=\"cpu\"}", 1.0),
        ("sdfarm_encode_seconds_count{device=\"cpu\"}", 1.0),
        ("sdfarm_deliver_seconds_count{device=\"cpu\"}", 1.0),
        ("sdfarm_rays_total{device=\"cpu\"}", 1e6),
        ("sdfarm_gpu_memory_used_bytes{worker=\"gpu\",device=\"cpu\"}", f64::from(1 << 30)),
        ("sdfarm_http_answers_total{route=\"/v1/jobs\",method=\"POST\",status=\"201\"}", 1.0),
    ] {
        assert_eq!(metrics.value(sample), value, "{sample}");
    }
    assert!(metrics.value("sdfarm_commit_seconds_count") > 2.0);
    assert!(metrics.value("sdfarm_commit_operations_sum") >= metrics.value("sdfarm_commit_operations_count"));
    assert!(metrics.value("sdfarm_claim_seconds_count") >= 1.0);
    assert!(metrics.value("sdfarm_database_bytes") + metrics.value("sdfarm_wal_bytes") > 4096.0);
    assert!(metrics.value("sdfarm_disk_bytes") >= metrics.value("sdfarm_disk_free_bytes"));
    assert!(metrics.value("process_resident_memory_bytes") > 1e6);
    farm.stop().await;
}

#[tokio::test]
async fn queue_metrics_report_waiting_work_and_age() {
    let farm = Farm::start().await;
    farm.submit(&small_job(1)).await;
    farm.hand.advance(Duration::from_secs(90));
    let metrics = Metrics::of(&farm).await;
    assert_eq!(metrics.value("sdfarm_queue_rays"), 4096.0);
    assert!(metrics.value("sdfarm_queue_work_seconds").is_infinite(), "there is no worker");
    assert_eq!(metrics.value("sdfarm_queue_oldest_job_seconds"), 90.0);
    assert_eq!(metrics.value("sdfarm_queue_oldest_queued_job_seconds"), 90.0);
    assert_eq!(metrics.value("sdfarm_tiles{state=\"unopened\"}"), 1.0);
    farm.stop().await;
}

#[tokio::test]
async fn expired_leases_are_counted() {
    let farm = Farm::start().await;
    farm.submit(&small_job(1)).await;
    farm.worker("slow").await.claim().await.expect("work");
    farm.hand.advance(LEASE);
    farm.worker("quick").await.claim().await.expect("the tile again");
    assert_eq!(Metrics::of(&farm).await.value("sdfarm_leases_expired_total"), 1.0);
    farm.stop().await;
}

#[tokio::test]
async fn unknown_methods_and_routes_share_one_label() {
    let farm = Farm::start().await;
    for number in 0..20 {
        let method = reqwest::Method::from_bytes(format!("ODD{number}").as_bytes()).expect("a method");
        let url = farm.url(&format!("/no/such/{number}"));
        in_time(farm.client.request(method, url).send()).await.expect("a response");
    }
    let metrics = Metrics::of(&farm).await;
    assert_eq!(metrics.0.lines().filter(|line| line.starts_with("sdfarm_http_answers_total")).count(), 1);
    farm.stop().await;
}

#[tokio::test]
async fn the_trace_of_a_submission_is_sent_to_its_worker() {
    let farm = Farm::start().await;
    let trace = "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01";
    for (seed, sent, heard) in [(1, Some(trace), Some(trace)), (2, None, None), (3, Some("00-nonsense"), None)] {
        let request = farm.client.post(farm.url("/v1/jobs")).body(small_job(seed).to_string());
        let request = sent.into_iter().fold(request, |request, trace| request.header("traceparent", trace));
        let _: proto::job::JobView =
            read(in_time(request.send()).await.expect("a response"), StatusCode::CREATED).await;
        let worker = farm.worker("traced").await;
        let reply = worker.sync(Said { wants_work: true, ..Said::default() }).await;
        assert_eq!(reply.trace.as_deref(), heard, "{sent:?}");
        worker.report(worker.results(&reply.batch.expect("work")).await).await;
    }
    farm.stop().await;
}

#[tokio::test]
async fn a_tile_rendered_differently_is_counted() {
    let farm = Farm::start().await;
    farm.submit(&job(1920, 1080, 4)).await;
    let worker = farm.worker("odd").await;
    let run = worker.claim().await.expect("work");
    let results = worker.results(&run).await;
    worker.report(results.clone()).await;
    let other = worker.blob(results[0].lease, b"another result").await;
    worker.report(vec![other]).await;
    assert_eq!(Metrics::of(&farm).await.value("sdfarm_nondeterministic_tiles_total"), 1.0);
    farm.stop().await;
}
