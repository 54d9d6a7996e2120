//! Events of a job: each one is received once and in order, even if the client reconnects.

use std::time::Duration;

use futures_util::future::join_all;
use proto::event::{JobEvent, Snapshot, SseMessage, SseParser};
use proto::job::{JobState, JobView};
use proto::worker_protocol::BatchWork;
use proto::{Client, JobId};
use reqwest::StatusCode;
use serde_json::json;

use super::harness::{Farm, in_time, job, leases, read, refused, small_job};

/// All events of a job until the server ends the stream.
async fn story(farm: &Farm, id: JobId, after: Option<&str>) -> Vec<SseMessage> {
    let mut request = farm.client.get(farm.url(&format!("/v1/jobs/{id}/events")));
    if let Some(after) = after {
        request = request.header("Last-Event-ID", after);
    }
    let response = in_time(request.send()).await.expect("a response");
    if response.status() == StatusCode::NO_CONTENT {
        return Vec::new();
    }
    assert_eq!(response.status(), StatusCode::OK);
    assert_eq!(response.headers()["content-type"], "text/event-stream");
    SseParser::default().push(&in_time(response.bytes()).await.expect("the stream ends"))
}

fn numbers(story: &[SseMessage]) -> Vec<i64> {
    story.iter().map(|message| message.id.as_ref().expect("an id").parse().expect("a number")).collect()
}

fn events(story: &[SseMessage]) -> Vec<JobEvent> {
    story.iter().map(|message| JobEvent::parse(&message.event, &message.data).expect("a known event")).collect()
}

/// A job of two frames with several tiles each.
fn animation() -> serde_json::Value {
    let mut animation = job(1920, 1080, 1);
    animation["frames"] = json!({ "count": 2, "fps": 24 });
    animation
}

/// Renders all ready work, a few tiles at a time.
async fn work_slowly(farm: &Farm) {
    let mut worker = farm.worker("slow").await;
    worker.rays_per_second = Some(1.0);
    assert!(worker.work_off().await > 2);
}

fn check_story(farm_story: &[SseMessage], posted: &JobView) {
    let numbers = numbers(farm_story);
    assert!(numbers.is_sorted_by(|left, right| left < right), "{numbers:?}");
    let (mut tiles, mut frames, mut progress, mut states) = (0, Vec::new(), 0.0, Vec::new());
    for event in events(farm_story) {
        match event {
            JobEvent::Tile(tile) => {
                assert!(tile.done && tile.width > 0 && tile.x + tile.width <= 1920, "{tile:?}");
                tiles += 1;
            }
            JobEvent::Frame(frame) => {
                assert_eq!(frame.image, format!("/v1/jobs/{}/frames/{}/image", posted.id, frame.frame));
                frames.push(frame.frame);
            }
            JobEvent::Progress(now) => {
                assert!(now.progress > progress);
                progress = now.progress;
            }
            JobEvent::State(now) => states.push(now.state),
            JobEvent::Snapshot(snapshot) => panic!("unexpected snapshot: {snapshot:?}"),
        }
    }
    assert_eq!((tiles, frames, progress), (posted.tiles.total, vec![0, 1], 1.0));
    assert_eq!(states, [JobState::Queued, JobState::Running, JobState::Succeeded]);
}

#[tokio::test]
async fn a_subscriber_receives_each_event_once_and_in_order() {
    let farm = Farm::start().await;
    let posted = farm.submit(&animation()).await;
    let (live, ()) = tokio::join!(story(&farm, posted.id, None), work_slowly(&farm));
    check_story(&live, &posted);
    assert_eq!(story(&farm, posted.id, None).await, live, "a later subscription receives the same events");
    farm.stop().await;
}

#[tokio::test]
async fn a_reconnecting_client_receives_missed_events_after_a_restart() {
    let farm = Farm::start().await;
    let posted = farm.submit(&animation()).await;
    work_slowly(&farm).await;
    let whole = story(&farm, posted.id, None).await;
    let farm = Farm::start_in(farm.stop().await, |_| {}).await;
    for (index, message) in whole.iter().enumerate() {
        assert_eq!(story(&farm, posted.id, message.id.as_deref()).await, whole[index + 1..]);
    }
    let last = whole.last().and_then(|message| message.id.clone()).expect("an id");
    let path = format!("/v1/jobs/{}/events?last_event_id={last}", posted.id);
    assert_eq!(farm.get(&path).await.status(), StatusCode::NO_CONTENT, "a browser stops reconnecting");
    farm.stop().await;
}

#[tokio::test]
async fn a_client_resumes_its_stream_after_a_server_restart() {
    let farm = Farm::start().await;
    let posted = farm.submit(&small_job(1)).await;
    let client = Client::new(&farm.url("")).expect("an address");
    let mut events = in_time(client.events(posted.id, None)).await.expect("a response").expect("a stream");
    let first = in_time(events.next()).await.expect("an event");
    assert!(matches!(first, Some(JobEvent::State(event)) if event.state == JobState::Queued));
    let farm = Farm::start_in(farm.stop().await, |_| {}).await;
    assert!(!matches!(in_time(events.next()).await, Ok(Some(_))), "the first server has exited");
    let client = Client::new(&farm.url("")).expect("an address");
    let again = client.events(posted.id, events.last_id());
    let mut events = in_time(again).await.expect("a response").expect("a stream");
    farm.worker("one").await.work_off().await;
    let mut received = Vec::new();
    while let Some(event) = in_time(events.next()).await.expect("an event") {
        received.push(event);
    }
    assert!(matches!(&received[0], JobEvent::State(event) if event.state == JobState::Running), "{received:?}");
    assert!(matches!(received.last(), Some(JobEvent::State(event)) if event.state == JobState::Succeeded));
    farm.stop().await;
}

#[tokio::test]
async fn an_unknown_event_id_gets_a_snapshot() {
    let farm = Farm::start().await;
    let posted = farm.submit(&animation()).await;
    let mut worker = farm.worker("slow").await;
    worker.rays_per_second = Some(1.0);
    worker.work_once().await;
    let path = format!("/v1/jobs/{}/events?last_event_id=1000000", posted.id);
    let mut response = farm.get(&path).await;
    let bytes = in_time(response.chunk()).await.expect("bytes").expect("something");
    let first = SseParser::default().push(&bytes).remove(0);
    assert_eq!(first.event, "snapshot");
    let snapshot: Snapshot = serde_json::from_str(&first.data).expect("a snapshot");
    assert_eq!(snapshot.state, JobState::Running);
    assert_eq!(snapshot.rectangles.len() as u64, snapshot.tiles.done);
    assert!(snapshot.tiles.done > 0 && snapshot.stored.is_empty());
    work_slowly(&farm).await;
    let rest = SseParser::default().push(&in_time(response.bytes()).await.expect("the stream ends"));
    let tiles = events(&rest).iter().filter(|event| matches!(event, JobEvent::Tile(_))).count() as u64;
    assert_eq!(snapshot.tiles.done + tiles, posted.tiles.total, "no event is repeated or missing");
    farm.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_thousand_clients_follow_one_job() {
    let farm = Farm::start().await;
    let posted = farm.submit(&animation()).await;
    let stories = join_all((0..1000).map(|_| story(&farm, posted.id, None)));
    let (stories, ()) = tokio::join!(stories, work_slowly(&farm));
    check_story(&stories[0], &posted);
    assert!(stories.iter().all(|story| *story == stories[0]));
    farm.stop().await;
}

#[tokio::test]
async fn invalid_event_ids_and_unknown_jobs_are_rejected() {
    let farm = Farm::start().await;
    let posted = farm.submit(&small_job(1)).await;
    for wrong in ["x", "-1", "1.5", "99999999999999999999"] {
        let path = format!("/v1/jobs/{}/events?last_event_id={wrong}", posted.id);
        refused(farm.get(&path).await, 422, "wrong_query").await;
    }
    refused(farm.get(&format!("/v1/jobs/{}/events", JobId::new())).await, 404, "unknown_job").await;
    farm.stop().await;
}

#[tokio::test]
async fn a_subscriber_receives_a_retry_and_its_end() {
    let farm = Farm::start().await;
    let posted = farm.submit(&small_job(1)).await;
    fail(&farm).await;
    let failed = story(&farm, posted.id, None).await;
    assert!(matches!(events(&failed).last(), Some(JobEvent::State(event))
        if event.state == JobState::Failed && event.errors[0].contains("the renderer failed")));
    let _: JobView = read(farm.post(&format!("/v1/jobs/{}/retry", posted.id), "").await, StatusCode::OK).await;
    farm.worker("good").await.work_off().await;
    let whole = story(&farm, posted.id, None).await;
    assert_eq!(whole[..failed.len()], failed);
    assert!(matches!(events(&whole).last(), Some(JobEvent::State(event)) if event.state == JobState::Succeeded));
    farm.stop().await;
}

/// Fails a job's tile until it is dead.
async fn fail(farm: &Farm) {
    for name in ["one", "two", "three"] {
        let worker = farm.worker(name).await;
        let Some(run) = worker.claim().await else { continue };
        let results = leases(&run).into_iter().map(|lease| proto::worker_protocol::LeaseReport {
            lease,
            outcome: proto::worker_protocol::LeaseOutcome::Failed { message: "the renderer failed".to_owned() },
        });
        worker.report(results.collect()).await;
        farm.hand.advance(Duration::from_secs(10));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn concurrent_retries_do_not_overfill_the_queue() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let farm = Farm::start_in(folder, |config| config.max_queued_jobs = 1).await;
    let mut retries = Vec::new();
    for seed in 0..8 {
        let posted = farm.submit(&small_job(seed)).await;
        while farm.job(posted.id).await.state != JobState::Failed {
            fail(&farm).await;
        }
        retries.push(format!("/v1/jobs/{}/retry", posted.id));
    }
    let responses = join_all(retries.iter().map(|retry| farm.post(retry, ""))).await;
    assert_eq!(responses.iter().filter(|response| response.status() == StatusCode::OK).count(), 1);
    for response in responses.into_iter().filter(|response| response.status() != StatusCode::OK) {
        refused(response, 429, "queue_full").await;
    }
    farm.stop().await;
}

#[tokio::test]
async fn retrying_a_failed_job_keeps_its_finished_tiles() {
    let farm = Farm::start().await;
    let posted = farm.submit(&job(1920, 1080, 4)).await;
    let retry = format!("/v1/jobs/{}/retry", posted.id);
    refused(farm.post(&retry, "").await, 409, "nothing_dead").await;
    let mut worker = farm.worker("slow").await;
    worker.rays_per_second = Some(1.0);
    worker.work_once().await;
    let before = farm.job(posted.id).await.tiles.done;
    fail(&farm).await;
    while farm.job(posted.id).await.state == JobState::Running {
        fail(&farm).await;
    }
    let failed = farm.job(posted.id).await;
    assert_eq!((failed.state, failed.tiles.done), (JobState::Failed, before));
    let again: JobView = read(farm.post(&retry, "").await, StatusCode::OK).await;
    assert_eq!((again.state, again.tiles.done), (JobState::Running, before));
    assert!(again.errors.is_empty() && again.finished_at.is_none());
    refused(farm.post(&retry, "").await, 409, "nothing_dead").await;
    let worker = farm.worker("good").await;
    let mut rendered = 0;
    while let Some(run) = worker.claim().await {
        if let BatchWork::Render { tiles, .. } = &run.work {
            rendered += tiles.len() as u64;
        }
        worker.report(worker.results(&run).await).await;
    }
    assert_eq!(farm.job(posted.id).await.state, JobState::Succeeded);
    assert_eq!(rendered + before, posted.tiles.total, "finished tiles are not rendered again");
    refused(farm.post(&retry, "").await, 409, "nothing_dead").await;
    farm.stop().await;
}
