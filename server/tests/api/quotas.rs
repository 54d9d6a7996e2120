//! Quotas of a name: its part of the queue, its paused jobs, and the highest priority of its keys.

use proto::api_key::{NewApiKey, Scope};
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};
use server::OfflineApiKeys;

use super::harness::{Farm, read, refused, small_job};
use super::keys::{make, new_key, send};

#[tokio::test]
async fn a_submitter_leaves_room_and_asks_for_no_priority_above_its_own() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut keys = OfflineApiKeys::open_or_create(folder.path(), super::harness::config(folder.path()).database)
        .await
        .expect("a folder of keys");
    let admin = keys.create(new_key("root", &[Scope::Admin])).await.expect("a key").secret;
    keys.close().await.expect("closes");
    let farm = Farm::start_in(folder, |config| (config.max_queued_jobs, config.max_paused_per_name) = (4, 1)).await;
    let anna = make(&farm, &admin, &new_key("anna", &[Scope::Submit])).await.secret;
    let key = NewApiKey { max_priority: Some(10), max_jobs: Some(2), ..new_key("bert", &[Scope::Submit]) };
    let bert = make(&farm, &admin, &key).await.secret;
    let submit = async |key: &str, job: Value| send(&farm, key, Method::POST, "/v1/jobs", job.to_string()).await;
    let with_priority = |seed: u32, priority: i32| {
        let mut job = small_job(seed);
        job["priority"] = json!(priority);
        job
    };

    let high = refused(submit(&anna, with_priority(1, 1)).await, 403, "priority_too_high").await;
    assert!(high.detail.contains("--max-priority 1"), "{high:?}");
    let dry = send(&farm, &anna, Method::POST, "/v1/jobs?dry_run=true", with_priority(1, 1).to_string()).await;
    refused(dry, 403, "priority_too_high").await;
    let mut paths = Vec::new();
    for seed in 1..3 {
        let job: Value = read(submit(&anna, with_priority(seed, 0)).await, StatusCode::CREATED).await;
        paths.push(format!("/v1/jobs/{}", job["id"].as_str().expect("an id")));
    }
    let half = refused(submit(&anna, small_job(3)).await, 429, "quota").await;
    assert!(half.detail.contains("at most 2 unfinished jobs"), "{half:?}");
    let raise = async |key: &str, priority: i32| {
        let body = json!({ "priority": priority }).to_string();
        send(&farm, key, Method::PATCH, &paths[0], body).await
    };
    refused(raise(&anna, 1).await, 403, "priority_too_high").await;
    for (key, priority) in [(&anna, -5), (&admin, 100)] {
        assert_eq!(raise(key, priority).await.status(), StatusCode::OK, "{priority}");
    }

    // Paused jobs are bounded; an administrator may pause any number.
    let pause = async |key: &str, path: &str| send(&farm, key, Method::POST, &format!("{path}/pause"), "").await;
    for _ in 0..2 {
        assert_eq!(pause(&anna, &paths[0]).await.status(), StatusCode::OK);
    }
    refused(pause(&anna, &paths[1]).await, 429, "quota").await;
    assert_eq!(pause(&admin, &paths[1]).await.status(), StatusCode::OK);

    // A key with a quota of its own may take the rest.
    refused(submit(&bert, with_priority(4, 11)).await, 403, "priority_too_high").await;
    for seed in 4..6 {
        assert_eq!(submit(&bert, with_priority(seed, 10)).await.status(), StatusCode::CREATED);
    }
    refused(submit(&bert, small_job(6)).await, 429, "queue_full").await;
    farm.stop().await;
}
