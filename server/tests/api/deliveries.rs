//! Results are checked before they count: a worker that delivers something else gets no more work, and nothing of it
//! is kept.

use proto::frame::{ForgottenPicture, FramePage};
use proto::job::{JobState, JobView};
use proto::pool::{WorkerList, WorkerState};
use proto::worker_protocol::{LeaseOutcome, LeaseReport};
use reqwest::StatusCode;
use reqwest::header::CACHE_CONTROL;

use super::fake_pictures::{self, text_of};
use super::harness::{Farm, Said, assert_state, in_time, job, leases, read, refused, small_job};

fn reported(lease: proto::LeaseId, outcome: LeaseOutcome) -> LeaseReport {
    LeaseReport { lease, outcome }
}

async fn metric(farm: &Farm, name: &str) -> String {
    let metrics = in_time(farm.get("/metrics").await.text()).await.expect("text");
    let line = metrics.lines().find(|line| line.starts_with(&format!("{name} "))).expect("the metric");
    line.rsplit_once(' ').expect("a value").1.to_owned()
}

async fn state_of(farm: &Farm, worker: proto::WorkerId) -> WorkerState {
    let list: WorkerList = read(farm.get("/v1/workers").await, StatusCode::OK).await;
    list.workers.iter().find(|view| view.id == worker).expect("listed").state
}

#[tokio::test]
async fn a_picture_that_is_something_else_is_rejected() {
    let farm = Farm::start().await;
    let scene = scene::parse(small_job(1).to_string().as_bytes()).expect("a valid job");
    let other = scene::parse(small_job(2).to_string().as_bytes()).expect("a valid job");
    let small = scene::parse(job(32, 64, 1).to_string().as_bytes()).expect("a valid job");
    let right = fake_pictures::picture(&scene, 0, b"right");
    for wrong in [
        b"<html>".to_vec(),
        Vec::new(),
        right[..right.len() - 5].to_vec(),
        fake_pictures::picture(&scene, 1, b"another frame"),
        fake_pictures::picture(&other, 0, b"another seed"),
        fake_pictures::picture(&small, 0, b"another size"),
        fake_pictures::picture(&scene, 0, &vec![b'x'; 200_000]),
    ] {
        let posted = farm.submit(&small_job(1)).await;
        let worker = farm.worker("liar").await;
        let run = worker.claim().await.expect("work");
        let reply = worker.report(worker.raw_picture(&leases(&run), &wrong).await).await;
        assert_eq!(reply.revoked_leases, [], "the report was received");
        assert_state(&farm, posted.id, JobState::Running).await;
        refused(farm.get(&format!("/v1/jobs/{}/image", posted.id)).await, 404, "picture_not_stored").await;
        let honest = farm.worker("honest").await;
        assert_eq!(honest.work_off().await, 1, "another worker renders it");
        let image = in_time(farm.get(&format!("/v1/jobs/{}/image", posted.id)).await.bytes()).await.expect("bytes");
        assert_eq!(text_of(&image), format!("picture of frame 0 of {}", posted.id));
        let deleted = farm.client.delete(farm.url(&format!("/v1/jobs/{}", posted.id))).send();
        assert_eq!(in_time(deleted).await.expect("a response").status(), StatusCode::NO_CONTENT);
    }
    assert_eq!(metric(&farm, "sdfarm_results_rejected_total").await, "7");
    farm.stop().await;
}

#[tokio::test]
async fn a_stored_blob_reported_as_a_picture_is_rejected() {
    let farm = Farm::start().await;
    let posted = farm.submit(&job(1920, 1080, 4)).await;
    let mut worker = farm.worker("liar").await;
    worker.rays_per_second = Some(1e9);
    let held = leases(&worker.claim().await.expect("work"));
    let blob = worker.blob(held[0], b"a blob").await;
    let LeaseOutcome::Blob { hash, size_bytes } = blob.outcome.clone() else { panic!("{blob:?}") };
    // The same hash in one call, first as what it is, then as pictures of any size.
    let mut results = vec![blob];
    results.extend(held.iter().map(|&lease| reported(lease, LeaseOutcome::Picture { hash: hash.clone(), size_bytes })));
    worker.report(results).await;
    refused(farm.get(&format!("/v1/jobs/{}/image", posted.id)).await, 404, "picture_not_stored").await;
    assert_ne!(farm.job(posted.id).await.state, JobState::Succeeded);
    farm.stop().await;
}

#[tokio::test]
async fn a_size_out_of_range_is_refused_at_the_door() {
    let farm = Farm::start().await;
    farm.submit(&small_job(1)).await;
    let worker = farm.worker("liar").await;
    let held = leases(&worker.claim().await.expect("work"));
    for size_bytes in [(1 << 53) + 1, u64::MAX] {
        let outcome = LeaseOutcome::Picture { hash: "0".repeat(64), size_bytes };
        let said = Said { results: vec![reported(held[0], outcome)], ..Said::default() };
        refused(worker.try_sync(said).await, 422, "wrong_body").await;
    }
    farm.stop().await;
}

#[tokio::test]
async fn a_blob_of_another_tile_is_rejected() {
    let farm = Farm::start().await;
    let posted = farm.submit(&job(1920, 1080, 4)).await;
    let worker = farm.worker("liar").await;
    let scene = scene::parse(job(1920, 1080, 4).to_string().as_bytes()).expect("a valid job");
    let lease = leases(&worker.claim().await.expect("work"))[0];
    let elsewhere = proto::Rect { x: 1888, y: 1048, width: 32, height: 32 };
    let wrong = worker.raw_blob(lease, &fake_pictures::blob(&scene, elsewhere, b"elsewhere")).await;
    worker.report(vec![wrong]).await;
    assert_eq!(farm.job(posted.id).await.tiles.done, 0);
    assert!(worker.claim().await.is_some(), "a single worker goes on");
    farm.stop().await;
}

#[tokio::test]
async fn three_wrong_results_quarantine_a_worker_and_kill_no_job() {
    let farm = Farm::start().await;
    let worker = farm.worker("liar").await;
    let mut jobs = Vec::new();
    for seed in 0..3 {
        jobs.push(farm.submit(&small_job(seed)).await.id);
    }
    let single = farm.submit(&job(1920, 1080, 4)).await.id;
    for _ in 0..3 {
        assert_eq!(state_of(&farm, worker.id).await, WorkerState::Ready);
        let run = worker.claim().await.expect("work");
        worker.report(worker.raw_picture(&leases(&run), b"<html>").await).await;
    }
    assert_eq!(state_of(&farm, worker.id).await, WorkerState::Quarantined, "also the last ready worker");
    assert!(worker.claim().await.is_none());
    let honest = farm.worker("honest").await;
    honest.work_off().await;
    for id in jobs.into_iter().chain([single]) {
        assert_state(&farm, id, JobState::Succeeded).await;
    }
    farm.stop().await;
}

#[tokio::test]
async fn quarantine_ends_the_leases_that_the_worker_holds() {
    let farm = Farm::start().await;
    let worker = farm.worker("liar").await;
    farm.submit(&job(1920, 1080, 4)).await;
    let good = worker.claim().await.expect("work");
    let good_results = worker.results(&good).await;
    for seed in 0..3 {
        let mut urgent = small_job(seed);
        urgent["priority"] = 1.into();
        farm.submit(&urgent).await;
        let said = Said { wants_work: true, holding: leases(&good), ..Said::default() };
        let run = worker.sync(said).await.batch.expect("work");
        let results = worker.raw_picture(&leases(&run), b"<html>").await;
        worker.sync(Said { results, holding: leases(&good), ..Said::default() }).await;
    }
    assert_eq!(worker.report(good_results).await.revoked_leases, leases(&good));
    farm.stop().await;
}

#[tokio::test]
async fn a_picture_rendered_without_the_cache_replaces_the_cached_one() {
    let farm = Farm::start().await;
    let first = farm.submit(&small_job(1)).await;
    let worker = farm.worker("one").await;
    let run = worker.claim().await.expect("work");
    worker.report(worker.picture(&leases(&run), b"poisoned").await).await;
    let request = farm.client.post(farm.url("/v1/jobs")).header(CACHE_CONTROL, "no-cache");
    let fresh = in_time(request.body(small_job(1).to_string()).send()).await.expect("a response");
    let fresh: JobView = read(fresh, StatusCode::CREATED).await;
    let run = worker.claim().await.expect("work");
    worker.report(worker.picture(&leases(&run), b"right").await).await;
    let later = farm.submit(&small_job(1)).await;
    for (id, text) in [(first.id, "poisoned"), (fresh.id, "right"), (later.id, "right")] {
        let image = in_time(farm.get(&format!("/v1/jobs/{id}/image")).await.bytes()).await.expect("bytes");
        assert_eq!(text_of(&image), text);
    }
    farm.stop().await;
}

async fn picture_of(farm: &Farm, id: proto::JobId) -> String {
    let page: FramePage = read(farm.get(&format!("/v1/jobs/{id}/frames")).await, StatusCode::OK).await;
    page.frames[0].picture.clone().expect("stored")
}

async fn forget(farm: &Farm, hash: &str) -> reqwest::Response {
    in_time(farm.client.delete(farm.url(&format!("/v1/pictures/{hash}"))).send()).await.expect("a response")
}

#[tokio::test]
async fn a_forgotten_picture_is_gone_everywhere_and_rendered_again() {
    let farm = Farm::start().await;
    let worker = farm.worker("one").await;
    let mut kept = Vec::new();
    for _ in 0..2 {
        kept.push(farm.submit(&small_job(1)).await.id);
    }
    let run = worker.claim().await.expect("work");
    worker.report(worker.picture(&leases(&run), b"poisoned").await).await;
    worker.work_off().await;
    let other = farm.submit(&small_job(2)).await.id;
    worker.work_off().await;
    let hash = picture_of(&farm, kept[0]).await;
    assert_eq!(picture_of(&farm, kept[1]).await, hash, "the second job shows the cached picture");
    let forgotten: ForgottenPicture = read(forget(&farm, &hash).await, StatusCode::OK).await;
    assert_eq!((forgotten.frames_rendered_again, forgotten.frames_without_picture), (2, 0));
    assert!(!farm.folder.path().join("pictures").join(&hash).exists());
    for id in &kept {
        refused(farm.get(&format!("/v1/jobs/{id}/image")).await, 404, "picture_not_stored").await;
        assert_state(&farm, *id, JobState::Running).await;
    }
    assert_state(&farm, other, JobState::Succeeded).await;
    refused(forget(&farm, &hash).await, 404, "unknown_picture").await;
    refused(forget(&farm, "latest").await, 422, "wrong_hash").await;
    assert_eq!(worker.work_off().await, 2);
    for id in &kept {
        assert_state(&farm, *id, JobState::Succeeded).await;
        assert_ne!(picture_of(&farm, *id).await, hash);
    }
    let folder = farm.stop().await;
    let report = server::check_integrity(folder.path()).await.expect("checked");
    assert!(report.violations.is_empty(), "{:?}", report.violations);
}

#[tokio::test]
async fn a_forgotten_picture_of_a_cancelled_job_is_not_rendered_again() {
    let farm = Farm::start().await;
    let worker = farm.worker("one").await;
    let mut animation = small_job(1);
    animation["frames"] = serde_json::json!({ "count": 2, "fps": 24 });
    let id = farm.submit(&animation).await.id;
    worker.work_once().await;
    assert_eq!(farm.post(&format!("/v1/jobs/{id}/cancel"), "").await.status(), StatusCode::OK);
    let hash = picture_of(&farm, id).await;
    let forgotten: ForgottenPicture = read(forget(&farm, &hash).await, StatusCode::OK).await;
    assert_eq!((forgotten.frames_rendered_again, forgotten.frames_without_picture), (0, 1));
    refused(farm.get(&format!("/v1/jobs/{id}/image")).await, 404, "picture_not_stored").await;
    assert!(worker.claim().await.is_none());
    farm.stop().await;
}

#[tokio::test]
async fn a_missing_result_is_no_strike_but_another_worker_renders_it() {
    let farm = Farm::start().await;
    let id = farm.submit(&small_job(1)).await.id;
    let (forgetful, other) = (farm.worker("forgetful").await, farm.worker("other").await);
    let held = leases(&forgetful.claim().await.expect("work"));
    let missing = LeaseOutcome::Picture { hash: "0".repeat(64), size_bytes: 9 };
    forgetful.report(vec![reported(held[0], missing)]).await;
    assert!(forgetful.claim().await.is_none());
    assert_eq!(other.work_off().await, 1);
    assert_state(&farm, id, JobState::Succeeded).await;
    assert_eq!(state_of(&farm, forgetful.id).await, WorkerState::Ready);
    farm.stop().await;
}
