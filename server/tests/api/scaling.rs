//! The number of wanted workers that autoscalers read.

use std::time::Duration;

use proto::job::JobState;
use proto::pool::WorkerList;
use proto::scaling::{DeviceScaling, ScalingView};
use reqwest::StatusCode;
use serde_json::{Value, json};

use super::harness::{Farm, LEASE, Said, assert_state, in_time, job, read, refused, small_job};

/// Reads the route once: its counts are cached, so each test changes the farm before.
async fn scaling(farm: &Farm, query: &str) -> ScalingView {
    read(farm.get(&format!("/v1/scaling{query}")).await, StatusCode::OK).await
}

#[tokio::test]
async fn wanted_workers_follow_from_backlog_and_reported_speeds() {
    let farm = Farm::start().await;
    farm.submit(&job(1000, 1000, 4)).await;
    let mut cpu = farm.worker("cpu").await;
    cpu.rays_per_second = Some(1000.0);
    cpu.sync(Said::default()).await;
    let all = scaling(&farm, "?target_seconds=1000").await;
    assert_eq!((all.target_seconds, all.jobs, all.rays), (1000, 1, 4_000_000));
    let expected = DeviceScaling {
        wanted_workers: 4,
        ready_workers: 1,
        rays_per_second: Some(1000.0),
        work_seconds: Some(4000.0),
    };
    assert_eq!(all.cpu, expected);
    assert_eq!(all.cuda, DeviceScaling { wanted_workers: 1, ..DeviceScaling::default() }, "its speed is unknown");
    // By default the backlog should be finished in ten minutes; there are never more workers than tiles.
    let default = scaling(&farm, "").await;
    assert_eq!((default.target_seconds, default.cpu.wanted_workers), (600, 7.min(all.tiles)));
    assert_eq!(scaling(&farm, "?target_seconds=1").await.cpu.wanted_workers, all.tiles);
    farm.stop().await;
}

#[tokio::test]
async fn autoscalers_read_plain_numbers_at_fixed_places() {
    let farm = Farm::start().await;
    let view: Value = read(farm.get("/v1/scaling").await, StatusCode::OK).await;
    for place in ["/cpu/wanted_workers", "/cuda/wanted_workers"] {
        assert_eq!(view.pointer(place), Some(&Value::from(0)), "{place}");
    }
    farm.stop().await;
}

#[tokio::test]
async fn ready_gpus_leave_cpus_what_they_cannot_finish() {
    let farm = Farm::start().await;
    farm.submit(&job(4000, 4000, 1)).await;
    let mut cpu = farm.worker("cpu").await;
    cpu.rays_per_second = Some(1000.0);
    cpu.sync(Said::default()).await;
    let mut gpu = farm.gpu_worker("gpu", 1000).await;
    gpu.rays_per_second = Some(30_000.0);
    gpu.sync(Said::default()).await;
    // Of 16 million rays the GPU renders 12 million in 400 s, a CPU 400,000.
    let view = scaling(&farm, "?target_seconds=400").await;
    assert_eq!((view.cuda.wanted_workers, view.cuda.ready_workers), (2, 1));
    assert_eq!((view.cpu.wanted_workers, view.cpu.work_seconds), (10, Some(4000.0)));
    assert!(view.tiles > 10, "{view:?}");
    farm.stop().await;
}

#[tokio::test]
async fn speeds_measured_in_a_job_count_in_it() {
    let farm = Farm::start().await;
    let posted = farm.submit(&job(1920, 1080, 4)).await;
    let mut worker = farm.worker("cpu").await;
    // So slow by its own report that it gets one tile; in this job it is far faster.
    worker.rays_per_second = Some(1.0);
    let batch = worker.next().await;
    farm.hand.advance(Duration::from_secs(2));
    worker.report(worker.results(&batch).await).await;
    assert_state(&farm, posted.id, JobState::Running).await;
    let view = scaling(&farm, "?target_seconds=1").await;
    let rendered = 1920.0 * 1080.0 * 4.0 - view.rays as f64;
    let expected = view.rays as f64 * 2.05 / rendered;
    let seconds = view.cpu.work_seconds.expect("known");
    assert!(rendered > 0.0 && (seconds - expected).abs() < 0.001, "{view:?} instead of {expected} s");
    assert_eq!(view.cpu.rays_per_second, Some(1.0));
    assert_eq!(view.cpu.wanted_workers, (expected.ceil() as u64).min(view.tiles));
    farm.stop().await;
}

#[tokio::test]
async fn after_all_workers_are_gone_their_speed_is_remembered() {
    let farm = Farm::start().await;
    let mut cpu = farm.worker("cpu").await;
    cpu.rays_per_second = Some(1000.0);
    cpu.sync(Said::default()).await;
    farm.hand.advance(10 * LEASE);
    in_time(async {
        while !read::<WorkerList>(farm.get("/v1/workers").await, StatusCode::OK).await.workers.is_empty() {
            tokio::task::yield_now().await;
        }
    })
    .await;
    farm.submit(&job(1000, 1000, 4)).await;
    let view = scaling(&farm, "?target_seconds=1000").await;
    assert_eq!((view.cpu.wanted_workers, view.cpu.ready_workers), (4, 0));
    farm.stop().await;
}

#[tokio::test]
async fn a_scene_too_large_for_any_gpu_wants_none() {
    let farm = Farm::start().await;
    let mut large = small_job(1);
    let ball = json!({ "sphere": { "radius": 1 } });
    large["scene"]["objects"][0]["shape"] = json!({ "intersection": { "of": vec![ball; 500] } });
    farm.submit(&large).await;
    let view = scaling(&farm, "").await;
    assert_eq!((view.cpu.wanted_workers, view.cuda.wanted_workers), (1, 0));
    farm.stop().await;
}

#[tokio::test]
async fn paused_work_wants_no_workers() {
    let farm = Farm::start().await;
    let paused = farm.submit(&small_job(1)).await;
    assert_eq!(farm.post(&format!("/v1/jobs/{}/pause", paused.id), "").await.status(), StatusCode::OK);
    assert_eq!(scaling(&farm, "").await.jobs, 0);
    farm.stop().await;
    let farm = Farm::start().await;
    farm.submit(&small_job(1)).await;
    assert_eq!(farm.post("/v1/farm/pause", "").await.status(), StatusCode::OK);
    let view = scaling(&farm, "").await;
    assert_eq!((view.jobs, view.cpu.wanted_workers, view.cuda.wanted_workers), (0, 0, 0));
    farm.stop().await;
}

#[tokio::test]
async fn invalid_targets_are_rejected() {
    let farm = Farm::start().await;
    for query in ["target_seconds=0", "target_seconds=86401", "target_seconds=-1", "target=5"] {
        let answer = in_time(farm.client.get(farm.url(&format!("/v1/scaling?{query}"))).send()).await;
        refused(answer.expect("a response"), 422, "wrong_query").await;
    }
    farm.stop().await;
}
