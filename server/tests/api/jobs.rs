//! Life of a job as its user observes it.

use futures_util::StreamExt;
use futures_util::stream::FuturesUnordered;
use proto::api_key::Scope;
use proto::job::{DryRun, JobPage, JobState, JobView};
use proto::worker_protocol::BatchWork;
use reqwest::header::{CACHE_CONTROL, LOCATION};
use reqwest::{Method, StatusCode};
use serde_json::json;

use super::fake_pictures::text_of;
use super::harness::{Farm, Said, assert_state, in_time, job, leases, read, refused, small_job};
use super::keys::{locked_farm, make, new_key, send};

#[tokio::test]
async fn a_small_job_is_rendered_in_one_batch_and_served() {
    let farm = Farm::start().await;
    let response = farm.post("/v1/jobs", job(640, 360, 1).to_string()).await;
    let location = response.headers()[LOCATION].to_str().expect("text").to_owned();
    let posted: JobView = read(response, StatusCode::CREATED).await;
    assert_eq!(location, format!("/v1/jobs/{}", posted.id));
    assert_eq!(posted.state, JobState::Queued);
    assert_eq!((posted.tiles.done, posted.tiles.total, posted.frames.total), (0, 1, 1));
    refused(farm.get(&format!("{location}/image")).await, 404, "picture_not_stored").await;

    let worker = farm.worker("one").await;
    let run = worker.claim().await.expect("there is work");
    assert!(matches!(&run.work, BatchWork::Render { whole_frame: true, tiles } if tiles.len() == 1), "{run:?}");
    assert_state(&farm, posted.id, JobState::Running).await;
    let results = worker.results(&run).await;
    assert_eq!(worker.report(results).await.revoked_leases, []);

    let done = farm.job(posted.id).await;
    assert_eq!(done.state, JobState::Succeeded);
    assert_eq!(done.progress, 1.0);
    assert_eq!((done.tiles.done, done.frames.done), (1, 1));
    assert!(done.started_at.is_some() && done.finished_at.is_some());
    let image = farm.get(&format!("{location}/image")).await;
    assert_eq!(image.headers()["content-type"], "image/png");
    let bytes = in_time(image.bytes()).await.expect("bytes");
    assert_eq!(text_of(&bytes), format!("picture of frame 0 of {}", posted.id));
    farm.stop().await;
}

#[tokio::test]
async fn a_large_frame_is_stitched_and_its_blobs_deleted() {
    let farm = Farm::start().await;
    let posted = farm.submit(&job(1920, 1080, 4)).await;
    let worker = farm.worker("one").await;
    let mut tiles = 0;
    loop {
        let run = worker.claim().await.expect("there is work");
        let results = worker.results(&run).await;
        match &run.work {
            BatchWork::Render { whole_frame, tiles: some } => {
                assert!(!whole_frame);
                tiles += some.len() as u64;
            }
            BatchWork::Stitch { inputs, .. } => {
                assert_eq!(inputs.len() as u64, posted.tiles.total);
                let blob = farm.get(&proto::worker_protocol::blob_path(&inputs[1].hash)).await;
                assert_eq!(in_time(blob.bytes()).await.expect("bytes").len() as u64, inputs[1].size_bytes);
                assert_eq!(farm.job(posted.id).await.progress, 1.0);
                worker.report(results).await;
                break;
            }
        }
        worker.report(results).await;
        assert_state(&farm, posted.id, JobState::Running).await;
    }
    assert_eq!(tiles, posted.tiles.total);
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    let folder = farm.folder.path().join("tiles");
    in_time(async {
        while std::fs::read_dir(&folder).expect("lists").count() > 0 {
            tokio::task::yield_now().await;
        }
    })
    .await;
    farm.stop().await;
}

#[tokio::test]
async fn a_dry_run_stores_nothing() {
    let farm = Farm::start().await;
    let answer: DryRun =
        read(farm.post("/v1/jobs?dry_run=true", job(1920, 1080, 4).to_string()).await, StatusCode::OK).await;
    assert!(answer.valid);
    assert_eq!((answer.frames, answer.rays), (1, 1920 * 1080 * 4));
    let page: JobPage = read(farm.get("/v1/jobs").await, StatusCode::OK).await;
    assert!(page.jobs.is_empty());
    farm.stop().await;
}

#[tokio::test]
async fn pages_list_every_job_once_while_others_are_submitted() {
    let farm = Farm::start().await;
    let mut posted = Vec::new();
    for seed in 0..7 {
        posted.push(farm.submit(&small_job(seed)).await.id);
    }
    let mut seen = Vec::new();
    let mut cursor = String::new();
    loop {
        let page: JobPage = read(farm.get(&format!("/v1/jobs?limit=3{cursor}")).await, StatusCode::OK).await;
        seen.extend(page.jobs.iter().map(|job| job.id));
        farm.submit(&small_job(100 + seen.len() as u32)).await;
        let Some(next) = page.next_cursor else { break };
        cursor = format!("&cursor={next}");
    }
    posted.reverse();
    assert_eq!(seen, posted);
    let page: JobPage = read(farm.get("/v1/jobs?state=succeeded").await, StatusCode::OK).await;
    assert!(page.jobs.is_empty());
    let page: JobPage = read(farm.get("/v1/jobs?state=queued&limit=1000").await, StatusCode::OK).await;
    assert_eq!(page.jobs.len(), 10);
    farm.stop().await;
}

#[tokio::test]
async fn higher_priority_is_first_then_the_older_job() {
    let farm = Farm::start().await;
    let first = farm.submit(&small_job(1)).await.id;
    let second = farm.submit(&small_job(2)).await.id;
    let mut urgent = small_job(3);
    urgent["priority"] = 5.into();
    let urgent = farm.submit(&urgent).await.id;
    let worker = farm.worker("one").await;
    for expected in [urgent, first, second] {
        let run = worker.claim().await.expect("work");
        assert_eq!(run.job, expected);
        worker.report(worker.results(&run).await).await;
    }
    farm.stop().await;
}

#[tokio::test]
async fn frames_are_opened_in_order() {
    let farm = Farm::start().await;
    let mut animation = small_job(1);
    animation["frames"] = json!({ "count": 3, "fps": 24 });
    let posted = farm.submit(&animation).await;
    assert_eq!((posted.tiles.total, posted.frames.total), (3, 3));
    let worker = farm.worker("one").await;
    for frame in 0..3 {
        let run = worker.claim().await.expect("work");
        assert_eq!(run.frame, frame);
        worker.report(worker.results(&run).await).await;
        assert_eq!(farm.job(posted.id).await.frames.done, u64::from(frame) + 1);
    }
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    let last = farm.get(&format!("/v1/jobs/{}/frames/2/image", posted.id)).await;
    assert_eq!(last.status(), StatusCode::OK);
    refused(farm.get(&format!("/v1/jobs/{}/frames/3/image", posted.id)).await, 404, "unknown_frame").await;
    refused(farm.get(&format!("/v1/jobs/{}/frames/x/image", posted.id)).await, 404, "unknown_frame").await;
    farm.stop().await;
}

#[tokio::test]
async fn a_repeated_picture_is_cached_unless_the_cache_is_bypassed() {
    let farm = Farm::start().await;
    let first = farm.submit(&small_job(1)).await;
    let worker = farm.worker("one").await;
    assert_eq!(worker.work_off().await, 1);

    let mut renamed = small_job(1);
    renamed["name"] = "same scene, another name".into();
    let again = farm.submit(&renamed).await;
    assert_ne!(again.id, first.id);
    assert_eq!(again.state, JobState::Succeeded);
    assert_eq!((again.tiles.done, again.frames.done, again.progress), (1, 1, 1.0));
    assert_eq!(farm.get(&format!("/v1/jobs/{}/image", again.id)).await.status(), StatusCode::OK);
    assert!(worker.claim().await.is_none());

    let request = farm.client.post(farm.url("/v1/jobs")).header(CACHE_CONTROL, "no-cache");
    let fresh = in_time(request.body(small_job(1).to_string()).send()).await.expect("a response");
    let fresh: JobView = read(fresh, StatusCode::CREATED).await;
    assert_eq!(fresh.state, JobState::Queued);
    assert_eq!(worker.claim().await.expect("work").job, fresh.id);
    farm.stop().await;
}

#[tokio::test]
async fn a_frame_is_stored_from_the_cache_when_opened() {
    let farm = Farm::start().await;
    farm.submit(&small_job(1)).await;
    let twin = farm.submit(&small_job(1)).await;
    let worker = farm.worker("one").await;
    assert_eq!(worker.work_off().await, 1, "one of the two is rendered");
    assert_state(&farm, twin.id, JobState::Succeeded).await;
    farm.stop().await;
}

#[tokio::test]
async fn cancelling_revokes_leases_and_notifies_their_worker_at_once() {
    let farm = Farm::start().await;
    let posted = farm.submit(&small_job(1)).await;
    let worker = farm.worker("one").await;
    let held = leases(&worker.claim().await.expect("work"));
    let waiting =
        worker.sync(Said { holding: held.clone(), wait: std::time::Duration::from_secs(9), ..Said::default() });
    let cancel_path = format!("/v1/jobs/{}/cancel", posted.id);
    let cancel = farm.post(&cancel_path, "");
    let (reply, cancelled) = tokio::join!(waiting, cancel);
    assert_eq!(reply.revoked_leases, held);
    let cancelled: JobView = read(cancelled, StatusCode::OK).await;
    assert_eq!(cancelled.state, JobState::Cancelled);
    let late = worker.picture(&held, b"too late").await;
    assert_eq!(worker.report(late).await.revoked_leases, held);
    assert_state(&farm, posted.id, JobState::Cancelled).await;
    assert!(worker.claim().await.is_none());
    refused(farm.post(&format!("/v1/jobs/{}/cancel", posted.id), "").await, 409, "job_finished").await;
    refused(farm.get(&format!("/v1/jobs/{}/image", posted.id)).await, 404, "picture_not_stored").await;
    farm.stop().await;
}

#[tokio::test]
async fn deleting_a_job_deletes_pictures_only_it_used() {
    let farm = Farm::start().await;
    let kept = farm.submit(&small_job(1)).await;
    let twin = farm.submit(&small_job(1)).await;
    let worker = farm.worker("one").await;
    worker.work_off().await;
    let running = farm.submit(&small_job(2)).await;
    let run = worker.claim().await.expect("work");

    let delete =
        async |id| in_time(farm.client.delete(farm.url(&format!("/v1/jobs/{id}"))).send()).await.expect("a response");
    refused(delete(running.id).await, 409, "job_running").await;
    assert_eq!(delete(kept.id).await.status(), StatusCode::NO_CONTENT);
    refused(delete(kept.id).await, 404, "unknown_job").await;
    refused(farm.get(&format!("/v1/jobs/{}", kept.id)).await, 404, "unknown_job").await;
    assert_eq!(farm.get(&format!("/v1/jobs/{}/image", twin.id)).await.status(), StatusCode::OK);
    assert_eq!(delete(twin.id).await.status(), StatusCode::NO_CONTENT);
    let folder = farm.folder.path().join("pictures");
    in_time(async {
        while std::fs::read_dir(&folder).expect("lists").count() > 0 {
            tokio::task::yield_now().await;
        }
    })
    .await;
    worker.report(worker.results(&run).await).await;
    assert_state(&farm, running.id, JobState::Succeeded).await;
    farm.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn large_dry_runs_of_one_submitter_do_not_delay_another() {
    const DRY_RUNS: u32 = 30;
    let (farm, admin) = locked_farm().await;
    let anna = make(&farm, &admin, &new_key("anna", &[Scope::Submit])).await.secret;
    let bert = make(&farm, &admin, &new_key("bert", &[Scope::Submit])).await.secret;
    let mut large = small_job(1);
    large["scene"]["objects"][0]["shape"] =
        json!({ "union": { "of": vec![json!({ "sphere": { "radius": 1 } }); 10_000] } });
    let large = large.to_string();
    let mut dry_runs: FuturesUnordered<_> =
        (0..DRY_RUNS).map(|_| send(&farm, &anna, Method::POST, "/v1/jobs?dry_run=true", large.clone())).collect();
    // One is read, so the others wait for their turns.
    assert_eq!(dry_runs.next().await.expect("a response").status(), StatusCode::OK);
    // A dry run as well, because a busy database may take longer to queue a job than several large dry runs take.
    let mut tiny = Box::pin(send(&farm, &bert, Method::POST, "/v1/jobs?dry_run=true", small_job(2).to_string()));
    let mut before = 1;
    let tiny_response = loop {
        tokio::select! {
            response = &mut tiny => break response,
            Some(dry_run) = dry_runs.next() => {
                assert_eq!(dry_run.status(), StatusCode::OK);
                before += 1;
            }
        }
    };
    assert_eq!(tiny_response.status(), StatusCode::OK);
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    assert!(before <= 2 * cores + 2, "{before} of {DRY_RUNS} large dry runs finished before a tiny one");
    drop((tiny, dry_runs));
    farm.stop().await;
}
