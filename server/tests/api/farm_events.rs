//! Events of the whole farm: every change of a job that a caller may see, and nothing of others.

use std::collections::HashMap;
use std::time::Instant;

use proto::JobId;
use proto::api_key::Scope;
use proto::event::{FarmEvent, SseParser};
use proto::farm::FarmView;
use proto::job::{JobState, JobView};
use reqwest::{Method, Response, StatusCode};

use super::harness::{Farm, in_time, job, read, refused, small_job};
use super::keys::{locked_farm_with, make, new_key, send};

/// A stream of events that is being read.
struct Follower {
    response: Response,
    parser: SseParser,
    waiting: Vec<FarmEvent>,
}

impl Follower {
    /// Reads a stream, which begins with the greeting.
    async fn of(response: Response) -> Self {
        assert_eq!(response.status(), StatusCode::OK);
        assert_eq!(response.headers()["content-type"], "text/event-stream");
        let mut follower = Self { response, parser: SseParser::default(), waiting: Vec::new() };
        let hello = follower.next().await.expect("a greeting");
        assert!(matches!(&hello, FarmEvent::Hello(hello) if hello.server_time.ends_with('Z')), "{hello:?}");
        follower
    }

    async fn start(farm: &Farm) -> Self {
        Self::of(farm.get("/v1/events").await).await
    }

    async fn with_key(farm: &Farm, key: &str) -> Self {
        Self::of(send(farm, key, Method::GET, "/v1/events", "").await).await
    }

    /// The next event; `None` at the end of the stream.
    async fn next(&mut self) -> Option<FarmEvent> {
        while self.waiting.is_empty() {
            let chunk = in_time(self.response.chunk()).await.expect("the stream is whole")?;
            let messages = self.parser.push(&chunk);
            self.waiting = messages
                .iter()
                .map(|message| {
                    assert_eq!(message.id, None);
                    FarmEvent::parse(&message.event, &message.data).expect("a known event")
                })
                .collect();
        }
        Some(self.waiting.remove(0))
    }

    /// Reads until a job is as wanted.
    async fn job(&mut self, id: JobId, is_wanted: impl Fn(&JobView) -> bool) -> JobView {
        loop {
            match self.next().await.expect("the stream goes on") {
                FarmEvent::Job(job) if job.id == id && is_wanted(&job) => return *job,
                FarmEvent::Deleted(event) => assert_ne!(event.id, id.to_string()),
                _ => {}
            }
        }
    }

    /// Reads until a job was deleted.
    async fn deletion(&mut self, id: JobId) {
        loop {
            if let FarmEvent::Deleted(event) = self.next().await.expect("the stream goes on")
                && event.id == id.to_string()
            {
                return;
            }
        }
    }
}

#[tokio::test]
async fn every_change_of_a_job_is_told() {
    let farm = Farm::start().await;
    let mut follower = Follower::start(&farm).await;
    let posted = farm.submit(&job(1920, 1080, 1)).await;
    let (id, path) = (posted.id, format!("/v1/jobs/{}", posted.id));
    let received = follower.job(id, |_| true).await;
    assert_eq!(
        (received.state, received.priority, received.paused, &received.name),
        (JobState::Queued, 0, false, &posted.name)
    );
    let patch = farm.client.patch(farm.url(&path)).json(&serde_json::json!({ "priority": 5 }));
    assert_eq!(in_time(patch.send()).await.expect("a response").status(), StatusCode::OK);
    follower.job(id, |job| job.priority == 5).await;
    for (verb, paused) in [("pause", true), ("resume", false)] {
        let _: JobView = read(farm.post(&format!("{path}/{verb}"), "").await, StatusCode::OK).await;
        follower.job(id, |job| job.paused == paused).await;
    }
    let mut worker = farm.worker("slow").await;
    worker.rays_per_second = Some(1.0);
    worker.work_once().await;
    let received = follower.job(id, |job| job.tiles.done > 0).await;
    assert_eq!(received.state, JobState::Running);
    assert!(received.progress > 0.0 && received.progress < 1.0, "{received:?}");
    worker.work_off().await;
    let received = follower.job(id, |job| job.state == JobState::Succeeded).await;
    assert_eq!(serde_json::to_value(&received).expect("JSON"), serde_json::to_value(farm.job(id).await).expect("JSON"));
    let delete = farm.client.delete(farm.url(&path)).send();
    assert_eq!(in_time(delete).await.expect("a response").status(), StatusCode::NO_CONTENT);
    follower.deletion(id).await;
    refused(farm.get(&path).await, 404, "unknown_job").await;
    farm.stop().await;
    while follower.next().await.is_some() {}
}

#[tokio::test]
async fn the_farms_numbers_are_told_and_a_pause_has_lists_read_again() {
    let farm = Farm::start().await;
    let mut follower = Follower::start(&farm).await;
    let Some(FarmEvent::Farm(first)) = follower.next().await else { panic!("numbers follow the greeting") };
    assert_eq!((first.paused, first.queued, first.workers_ready), (false, 0, 0));
    farm.submit(&small_job(1)).await;
    let _worker = farm.worker("one").await;
    let _: FarmView = read(farm.post("/v1/farm/pause", "").await, StatusCode::OK).await;
    let (mut counts, mut is_resynced) = (first, false);
    while !(counts.paused && counts.queued == 1 && counts.workers_ready == 1 && is_resynced) {
        match follower.next().await.expect("the stream goes on") {
            FarmEvent::Farm(now) => {
                assert_ne!(now, counts, "only changes are told");
                counts = now;
            }
            FarmEvent::Resync => is_resynced = counts.paused,
            _ => {}
        }
    }
    farm.stop().await;
}

#[tokio::test]
#[expect(clippy::disallowed_methods, reason = "events are timed by the machine's clock")]
async fn a_busy_job_is_told_at_most_four_times_a_second() {
    let farm = Farm::start().await;
    let posted = farm.submit(&job(4096, 4096, 1)).await;
    let mut follower = Follower::start(&farm).await;
    let begun = Instant::now();
    let mut worker = farm.worker("slow").await;
    worker.rays_per_second = Some(1.0);
    let work = worker.work_off();
    let read = async {
        let mut views = 0;
        loop {
            if let Some(FarmEvent::Job(job)) = follower.next().await
                && job.id == posted.id
            {
                views += 1;
                if job.state == JobState::Succeeded {
                    return views;
                }
            }
        }
    };
    let (batches, views) = tokio::join!(work, read);
    let most = begun.elapsed().as_millis() / 250 + 2;
    assert!(views <= most, "{views} views of {batches} batches in {:?}", begun.elapsed());
    // A slow machine has no more batches than that.
    assert!(batches as u128 > views || batches as u128 <= most, "{batches} batches, {views} views");
    farm.stop().await;
}

#[tokio::test]
async fn a_key_that_only_submits_sees_its_own_jobs() {
    let (farm, admin) = locked_farm_with(|_| {}).await;
    let mut keys = HashMap::new();
    for (name, scope) in [("anna", Scope::Submit), ("bert", Scope::Submit), ("eye", Scope::Read)] {
        keys.insert(name, make(&farm, &admin, &new_key(name, &[scope])).await.secret);
    }
    let (mut anna, mut eye) =
        (Follower::with_key(&farm, &keys["anna"]).await, Follower::with_key(&farm, &keys["eye"]).await);
    let mut ids = Vec::new();
    for (name, seed) in [("bert", 1), ("anna", 2)] {
        let answer = send(&farm, &keys[name], Method::POST, "/v1/jobs", small_job(seed).to_string()).await;
        ids.push(read::<JobView>(answer, StatusCode::CREATED).await.id);
    }
    for (id, name) in ids.iter().zip(["bert", "anna"]) {
        assert_eq!(eye.job(*id, |_| true).await.submitter, name);
    }
    for (name, id) in [("bert", ids[0]), ("anna", ids[1])] {
        let path = format!("/v1/jobs/{id}");
        assert_eq!(send(&farm, &keys[name], Method::DELETE, &path, "").await.status(), StatusCode::NO_CONTENT);
    }
    let mut seen = Vec::new();
    while seen.len() < 2 {
        match anna.next().await.expect("the stream goes on") {
            FarmEvent::Job(job) => seen.push(job.id.to_string()),
            FarmEvent::Deleted(event) => seen.push(event.id),
            other => panic!("anna may not see {other:?}"),
        }
    }
    assert!(seen.iter().all(|id| *id == ids[1].to_string()), "{seen:?}");
    eye.deletion(ids[1]).await;
    assert_eq!(send(&farm, &admin, Method::DELETE, "/v1/keys/eye", "").await.status(), StatusCode::OK);
    while eye.next().await.is_some() {}
    farm.stop().await;
}

#[tokio::test]
async fn a_client_that_comes_back_is_told_of_later_changes_only() {
    let farm = Farm::start().await;
    let first = farm.submit(&small_job(1)).await;
    let mut follower = Follower::start(&farm).await;
    let second = farm.submit(&small_job(2)).await;
    follower.job(second.id, |_| true).await;
    drop(follower);
    let farm = Farm::start_in(farm.stop().await, |_| {}).await;
    let mut follower = Follower::start(&farm).await;
    let third = farm.submit(&small_job(3)).await;
    loop {
        if let FarmEvent::Job(job) = follower.next().await.expect("the stream goes on") {
            assert_eq!(job.id, third.id, "not {} or {}", first.id, second.id);
            break;
        }
    }
    farm.stop().await;
}

#[tokio::test]
async fn a_caller_may_have_a_number_of_streams() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let farm = Farm::start_in(folder, |config| config.max_requests_per_caller = 2).await;
    let (first, _second) = (Follower::start(&farm).await, Follower::start(&farm).await);
    let third = farm.get("/v1/events").await;
    assert_eq!(third.status(), StatusCode::TOO_MANY_REQUESTS);
    drop(first);
    // A stream that is closed frees its place.
    in_time(async {
        while farm.get("/v1/events").await.status() != StatusCode::OK {
            tokio::task::yield_now().await;
        }
    })
    .await;
    farm.stop().await;
}
