//! Previews without a working helper program: they are rejected, and nothing else is affected.

use reqwest::StatusCode;

use super::harness::{Farm, in_time, read, refused, small_job};

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
async fn verifications_and_searches_by_picture_are_checked() {
    let farm = Farm::start().await;
    let job = farm.submit(&small_job(1)).await.id;
    let verify = async |path: &str| farm.post(&format!("/v1/jobs/{path}"), String::new()).await;
    refused(verify(&format!("{job}/frames/1/verify")).await, 404, "unknown_frame").await;
    refused(verify("nobody/frames/0/verify").await, 404, "unknown_job").await;
    refused(verify(&format!("{job}/frames/0/verify")).await, 404, "picture_not_stored").await;
    for query in ["tiles=65", "tiles=-1", "tile=1"] {
        refused(verify(&format!("{job}/frames/0/verify?{query}")).await, 422, "wrong_query").await;
    }
    farm.worker("one").await.work_off().await;
    let answer: proto::verify::Verification =
        read(verify(&format!("{job}/frames/0/verify?tiles=0")).await, StatusCode::OK).await;
    assert!(answer.same && answer.tiles_checked == 0 && answer.tiles_total > 0, "{answer:?}");
    let makers = answer.made_by.expect("its leases are kept");
    assert_eq!((makers.len(), makers[0].worker.as_str()), (1, "one"));
    let scene = answer.scene.expect("recorded");
    let frames: proto::frame::FramePage = read(farm.get(&format!("/v1/jobs/{job}/frames")).await, StatusCode::OK).await;
    let picture = frames.frames[0].picture.clone().expect("stored");
    for (query, count) in [
        (format!("scene={scene}"), 1),
        (format!("picture={picture}&limit=5"), 1),
        (format!("scene={picture}"), 0),
        (format!("picture={scene}"), 0),
    ] {
        let page: proto::job::JobPage = read(farm.get(&format!("/v1/jobs?{query}")).await, StatusCode::OK).await;
        assert_eq!(page.jobs.len(), count, "{query}");
    }
    for query in [format!("scene={scene}&picture={picture}"), format!("scene={scene}&state=queued")] {
        refused(farm.get(&format!("/v1/jobs?{query}")).await, 422, "wrong_query").await;
    }
    refused(farm.get("/v1/jobs?scene=x").await, 422, "wrong_hash").await;
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

#[tokio::test]
async fn previews_that_wait_are_bounded() {
    use std::os::unix::fs::PermissionsExt;
    // A helper that never responds.
    let folder = tempfile::tempdir().expect("a temporary folder");
    let program = folder.path().join("helper");
    std::fs::write(&program, "#!/bin/sh\nexec cat > /dev/null\n").expect("written");
    std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).expect("executable");
    let farm = Farm::start_in(folder, |config| config.worker_program = program).await;
    let url = farm.url(&format!("/v1/jobs/{}/frames/0/preview", farm.submit(&small_job(1)).await.id));
    let (sender, mut refusals) = tokio::sync::mpsc::unbounded_channel();
    let mut asking = tokio::task::JoinSet::new();
    for _ in 0..40 {
        let (request, sender) = (farm.client.get(&url), sender.clone());
        asking.spawn(async move { drop(sender.send(request.send().await.expect("a response"))) });
    }
    // Two are drawn, and sixteen of one submitter wait.
    for _ in 0..22 {
        let refusal = in_time(refusals.recv()).await.expect("a response");
        assert_eq!(refusal.headers()["retry-after"], "5");
        refused(refusal, 429, "too_many_previews").await;
    }
    assert!(refusals.try_recv().is_err(), "the others wait");
    asking.shutdown().await;
    farm.stop().await;
}
