//! Changes of an existing job: its priority, and deletion.

use proto::job::DeleteDryRun;
use proto::job::JobView;
use reqwest::{Response, StatusCode};
use serde_json::{Value, json};

use super::harness::{Farm, in_time, job, read, refused, small_job};

async fn patch(farm: &Farm, path: &str, body: &Value) -> Response {
    in_time(farm.client.patch(farm.url(path)).body(body.to_string()).send()).await.expect("a response")
}

async fn delete(farm: &Farm, path: &str) -> Response {
    in_time(farm.client.delete(farm.url(path)).send()).await.expect("a response")
}

#[tokio::test]
async fn the_priority_of_an_unfinished_job_can_change() {
    let farm = Farm::start().await;
    let first = farm.submit(&small_job(1)).await.id;
    let second = farm.submit(&small_job(2)).await.id;
    let path = format!("/v1/jobs/{second}");
    let _: JobView = read(patch(&farm, &path, &json!({ "priority": 5 })).await, StatusCode::OK).await;
    let _: JobView = read(patch(&farm, &path, &json!({})).await, StatusCode::OK).await;
    let worker = farm.worker("one").await;
    let run = worker.claim().await.expect("work");
    assert_eq!(run.job, second);
    worker.report(worker.results(&run).await).await;
    refused(patch(&farm, &path, &json!({ "priority": 6 })).await, 409, "job_finished").await;
    assert_eq!(worker.claim().await.expect("work").job, first);
    farm.stop().await;
}

#[tokio::test]
async fn an_invalid_change_is_rejected_with_a_json_pointer() {
    let farm = Farm::start().await;
    let path = format!("/v1/jobs/{}", farm.submit(&small_job(1)).await.id);
    for (body, pointer) in [
        (json!({ "priority": 101 }), "/priority"),
        (json!({ "priority": "high" }), "/priority"),
        (json!({ "priority": 1.5 }), "/priority"),
        (json!({ "state": "succeeded" }), "/state"),
        (json!([]), ""),
    ] {
        let problem = refused(patch(&farm, &path, &body).await, 422, "wrong_body").await;
        assert_eq!(problem.errors[0].pointer, pointer, "{body}: {problem:?}");
    }
    let none = format!("/v1/jobs/{}", proto::JobId::new());
    refused(patch(&farm, &none, &json!({})).await, 404, "unknown_job").await;
    farm.stop().await;
}

#[tokio::test]
async fn a_dry_run_of_deletion_reports_and_deletes_nothing() {
    let farm = Farm::start().await;
    let kept = farm.submit(&small_job(1)).await.id;
    let twin = farm.submit(&small_job(1)).await.id;
    let path = format!("/v1/jobs/{kept}");
    let dry = format!("{path}?dry_run=true");
    farm.worker("one").await.work_off().await;
    let preview: DeleteDryRun = read(delete(&farm, &dry).await, StatusCode::OK).await;
    assert_eq!((preview.pictures, preview.size_bytes), (0, 0), "an equal job uses the picture too");
    assert!(preview.rows >= 4, "{preview:?}");
    assert_eq!(delete(&farm, &format!("/v1/jobs/{twin}")).await.status(), StatusCode::NO_CONTENT);
    let preview: DeleteDryRun = read(delete(&farm, &dry).await, StatusCode::OK).await;
    assert_eq!(preview.pictures, 1);
    let image = in_time(farm.get(&format!("{path}/image")).await.bytes()).await.expect("bytes");
    assert_eq!(preview.size_bytes, image.len() as u64);
    assert_eq!(delete(&farm, &path).await.status(), StatusCode::NO_CONTENT);
    refused(delete(&farm, &dry).await, 404, "unknown_job").await;
    farm.stop().await;
}

#[tokio::test]
async fn a_dry_run_of_deletion_counts_blobs_of_unfinished_frames() {
    let farm = Farm::start().await;
    let posted = farm.submit(&job(1920, 1080, 4)).await;
    let mut worker = farm.worker("slow").await;
    worker.rays_per_second = Some(1.0);
    worker.work_once().await;
    let dry = format!("/v1/jobs/{}?dry_run=true", posted.id);
    refused(delete(&farm, &dry).await, 409, "job_running").await;
    farm.post(&format!("/v1/jobs/{}/cancel", posted.id), "").await;
    let preview: DeleteDryRun = read(delete(&farm, &dry).await, StatusCode::OK).await;
    assert_eq!((preview.pictures, preview.blobs), (0, 1));
    assert!(preview.size_bytes > 0 && preview.rows > posted.tiles.total);
    farm.stop().await;
}
