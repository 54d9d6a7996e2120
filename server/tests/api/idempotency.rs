//! Idempotent submissions, and responses that wait for the end of the job.

use futures_util::future::join_all;
use proto::api_key::{ApiKeyList, Scope};
use proto::job::{JobPage, JobState, JobView};
use reqwest::{Method, Response, StatusCode};
use serde_json::Value;

use super::harness::{Farm, in_time, read, refused, small_job};
use super::keys::{locked_farm, make, new_key, send};

async fn hand_in(farm: &Farm, path: &str, job: &Value, header: (&str, &str)) -> Response {
    let request = farm.client.post(farm.url(path)).header(header.0, header.1).body(job.to_string());
    in_time(request.send()).await.expect("a response")
}

async fn jobs(farm: &Farm) -> usize {
    let page: JobPage = read(farm.get("/v1/jobs").await, StatusCode::OK).await;
    page.jobs.len()
}

#[tokio::test]
async fn idempotency_survives_a_restart() {
    let farm = Farm::start().await;
    let key = ("Idempotency-Key", "a request");
    let first: JobView = read(hand_in(&farm, "/v1/jobs", &small_job(1), key).await, StatusCode::CREATED).await;
    let response = hand_in(&farm, "/v1/jobs", &small_job(1), key).await;
    assert_eq!(response.headers()["location"], format!("/v1/jobs/{}", first.id));
    let again: JobView = read(response, StatusCode::OK).await;
    assert_eq!(again.id, first.id);
    refused(hand_in(&farm, "/v1/jobs", &small_job(2), key).await, 422, "key_reused").await;
    let webhook = "/v1/jobs?webhook=https://farm.example/";
    refused(hand_in(&farm, webhook, &small_job(1), key).await, 422, "key_reused").await;
    let farm = Farm::start_in(farm.stop().await, |_| {}).await;
    let again: JobView = read(hand_in(&farm, "/v1/jobs", &small_job(1), key).await, StatusCode::OK).await;
    assert_eq!(again.id, first.id);
    let other = ("Idempotency-Key", "another request");
    let other: JobView = read(hand_in(&farm, "/v1/jobs", &small_job(1), other).await, StatusCode::CREATED).await;
    assert_ne!(other.id, first.id);
    assert_eq!(jobs(&farm).await, 2);
    farm.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn concurrent_submits_with_one_key_create_one_job() {
    let farm = Farm::start().await;
    let (options, key) = (small_job(1), ("Idempotency-Key", "all at once"));
    let answers = join_all((0..50).map(|_| hand_in(&farm, "/v1/jobs", &options, key))).await;
    let made = answers.iter().filter(|answer| answer.status() == StatusCode::CREATED).count();
    assert_eq!((made, jobs(&farm).await), (1, 1));
    assert!(answers.iter().all(|answer| answer.status().is_success()));
    farm.stop().await;
}

#[tokio::test]
async fn invalid_idempotency_keys_are_rejected() {
    let farm = Farm::start().await;
    let long = "x".repeat(256);
    for key in ["", "  ", "ä", long.as_str()] {
        let answer = hand_in(&farm, "/v1/jobs", &small_job(1), ("Idempotency-Key", key)).await;
        refused(answer, 400, "wrong_header").await;
    }
    let twice = farm.client.post(farm.url("/v1/jobs")).header("Idempotency-Key", "a").header("Idempotency-Key", "b");
    let answer = in_time(twice.body(small_job(1).to_string()).send()).await.expect("a response");
    refused(answer, 400, "wrong_header").await;
    assert_eq!(jobs(&farm).await, 0);
    farm.stop().await;
}

#[tokio::test]
async fn a_response_waits_until_the_job_finished_or_timeout() {
    let farm = Farm::start().await;
    let at_once = hand_in(&farm, "/v1/jobs", &small_job(1), ("Prefer", "wait=0")).await;
    assert_eq!(at_once.headers()["preference-applied"], "wait=0");
    let posted: JobView = read(at_once, StatusCode::CREATED).await;
    assert_eq!(posted.state, JobState::Queued);
    let path = format!("/v1/jobs/{}", posted.id);
    let looking = async {
        let request = farm.client.get(farm.url(&path)).header("Prefer", "respond-async, wait=50");
        in_time(request.send()).await.expect("a response")
    };
    let working = async {
        let worker = farm.worker("one").await;
        let run = worker.claim().await.expect("work");
        worker.report(worker.results(&run).await).await;
    };
    let (seen, ()) = tokio::join!(looking, working);
    assert_eq!(seen.headers()["preference-applied"], "wait=50");
    let seen: JobView = read(seen, StatusCode::OK).await;
    assert_eq!(seen.state, JobState::Succeeded);
    let stored = hand_in(&farm, "/v1/jobs", &small_job(1), ("Prefer", "wait=50")).await;
    let stored: JobView = read(stored, StatusCode::CREATED).await;
    assert_eq!(stored.state, JobState::Succeeded, "its picture was stored");
    let plain = farm.get(&path).await;
    assert!(!plain.headers().contains_key("preference-applied"));
    farm.stop().await;
}

#[tokio::test]
async fn a_server_shutdown_ends_waiting_requests() {
    let (farm, admin) = locked_farm().await;
    let reader = make(&farm, &admin, &new_key("reader", &[Scope::Read])).await;
    let posted = send(&farm, &admin, Method::POST, "/v1/jobs", small_job(1).to_string()).await;
    let posted: JobView = read(posted, StatusCode::CREATED).await;
    let request = farm.client.get(farm.url(&format!("/v1/jobs/{}", posted.id))).header("Prefer", "wait=55");
    let waiting = tokio::spawn(request.bearer_auth(&reader.secret).send());
    // The server has received the request once the idempotency key is used.
    in_time(async {
        loop {
            let keys: ApiKeyList = read(send(&farm, &admin, Method::GET, "/v1/keys", "").await, StatusCode::OK).await;
            if keys.keys.iter().any(|key| key.id == reader.key.id && key.last_used_at.is_some()) {
                break;
            }
        }
    })
    .await;
    assert!(!waiting.is_finished(), "the job has not finished");
    farm.stop().await;
    let seen = in_time(waiting).await.expect("no panic").expect("a response");
    assert_eq!(seen.status(), StatusCode::OK);
    let seen: JobView = read(seen, StatusCode::OK).await;
    assert_eq!(seen.state, JobState::Queued);
}
