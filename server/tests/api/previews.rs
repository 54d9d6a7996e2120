//! Previews without a working helper program: they are rejected, and nothing else is affected.

use reqwest::StatusCode;

use super::harness::{Farm, read, refused, small_job};

#[tokio::test]
async fn previews_of_missing_jobs_and_frames_are_rejected() {
    let farm = Farm::start().await;
    let job = farm.submit(&small_job(1)).await.id;
    for what in ["preview", "thumbnail"] {
        refused(farm.get(&format!("/v1/jobs/{job}/frames/1/{what}")).await, 404, "unknown_frame").await;
        refused(farm.get(&format!("/v1/jobs/{job}/frames/x/{what}")).await, 404, "unknown_frame").await;
        refused(farm.get(&format!("/v1/jobs/nobody/frames/0/{what}")).await, 404, "unknown_job").await;
        for width in ["0", "2049", "-1", "wide"] {
            let answer = farm.get(&format!("/v1/jobs/{job}/frames/0/{what}?width={width}")).await;
            refused(answer, 422, "wrong_query").await;
        }
    }
    refused(farm.get(&format!("/v1/jobs/{job}/frames/0/thumbnail")).await, 404, "picture_not_stored").await;
    farm.stop().await;
}

#[tokio::test]
async fn a_failing_helper_affects_only_the_preview() {
    for program in ["/nonexistent/sdfarm", "/bin/false", "/bin/cat"] {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let farm = Farm::start_in(folder, |config| config.worker_program = program.into()).await;
        let job = farm.submit(&small_job(1)).await.id;
        let answer = farm.get(&format!("/v1/jobs/{job}/frames/0/preview")).await;
        assert_eq!(answer.headers()["retry-after"], "5");
        let detail = refused(answer, 503, "no_preview").await.detail;
        assert!(!detail.contains("os error") && !detail.contains("exit status"), "the server's own errors: {detail}");
        let dry = farm.post("/v1/jobs?dry_run=true", small_job(1).to_string()).await;
        let dry: proto::job::DryRun = read(dry, StatusCode::OK).await;
        assert!(dry.estimate.is_none(), "{dry:?}");
        farm.worker("one").await.work_off().await;
        assert_eq!(farm.get(&format!("/v1/jobs/{job}/image")).await.status(), StatusCode::OK);
        farm.stop().await;
    }
}
