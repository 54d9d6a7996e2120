//! Webhooks: signed messages to a local receiver, retried until they are accepted, and only to permitted
//! addresses.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use proto::alert::AlertList;
use proto::webhook::{DeliveryList, DeliveryState, DeliveryView};
use proto::{JobId, Secret};
use serde_json::{Value, json};
use tokio::task::JoinHandle;

use crate::skip::skip;

use super::harness::{Farm, in_time, read, refused, small_job};

const SECRET: &str = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw";

#[derive(Clone, Debug)]
struct Message {
    headers: HeaderMap,
    body: Bytes,
}

impl Message {
    fn header(&self, name: &str) -> &str {
        self.headers[name].to_str().expect("text")
    }

    fn json(&self) -> Value {
        serde_json::from_slice(&self.body).expect("JSON")
    }
}

#[derive(Clone, Default)]
struct Receiver {
    /// Status codes of its responses, in order; then 204.
    answers: Arc<Mutex<Vec<StatusCode>>>,
    messages: Arc<Mutex<Vec<Message>>>,
}

/// A receiver on this machine: its address, the messages it receives, and its task.
async fn receive(answers: &[u16]) -> (String, Receiver, JoinHandle<()>) {
    let answers = answers.iter().rev().map(|status| StatusCode::from_u16(*status).expect("a status")).collect();
    let receiver = Receiver { answers: Arc::new(Mutex::new(answers)), messages: Arc::default() };
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = format!("http://{}/hook", listener.local_addr().expect("an address"));
    let router = axum::Router::new()
        .route("/hook", axum::routing::post(take))
        .route("/elsewhere", axum::routing::any(take))
        .with_state(receiver.clone());
    let task = tokio::spawn(async move { axum::serve(listener, router).await.expect("serves") });
    (address, receiver, task)
}

async fn take(
    State(receiver): State<Receiver>,
    headers: HeaderMap,
    body: Bytes,
) -> (StatusCode, [(&'static str, &'static str); 1]) {
    receiver.messages.lock().expect("no panic").push(Message { headers, body });
    let status = receiver.answers.lock().expect("no panic").pop().unwrap_or(StatusCode::NO_CONTENT);
    (status, [("location", "/elsewhere")])
}

async fn farm() -> Farm {
    let folder = tempfile::tempdir().expect("a temporary folder");
    Farm::start_in(folder, |config| {
        config.allowed_webhook_ranges = vec!["127.0.0.0/8".parse().expect("a range")];
        config.webhook_secret = Some(Secret::from(SECRET.to_owned()));
    })
    .await
}

async fn submit(farm: &Farm, query: &str, seed: u32) -> JobId {
    let response = farm.post(&format!("/v1/jobs?{query}"), small_job(seed).to_string()).await;
    read::<proto::job::JobView>(response, StatusCode::CREATED).await.id
}

/// Waits until the condition is true of a job's deliveries, while the manual clock advances.
async fn deliveries(
    farm: &Farm,
    job: JobId,
    step: Duration,
    until: impl Fn(&[DeliveryView]) -> bool,
) -> Vec<DeliveryView> {
    in_time(async {
        loop {
            let path = format!("/v1/jobs/{job}/webhooks");
            let list: DeliveryList = read(farm.get(&path).await, StatusCode::OK).await;
            if until(&list.deliveries) {
                return list.deliveries;
            }
            farm.hand.advance(step);
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    })
    .await
}

fn is_over(deliveries: &[DeliveryView]) -> bool {
    !deliveries.is_empty() && deliveries.iter().all(|delivery| delivery.state != DeliveryState::Pending)
}

#[tokio::test]
async fn a_webhook_is_sent_once_signed_with_the_event() {
    let (address, receiver, task) = receive(&[]).await;
    let farm = farm().await;
    let job = submit(&farm, &format!("webhook={address}"), 1).await;
    farm.worker("one").await.work_off().await;
    let received = deliveries(&farm, job, Duration::ZERO, is_over).await;
    assert_eq!((received.len(), received[0].state, received[0].attempts), (1, DeliveryState::Delivered, 1));
    assert_eq!((received[0].event.as_str(), received[0].status), ("job.succeeded", Some(204)));
    assert_eq!(format!("{}/hook", received[0].receiver), address, "a path may contain a secret");
    let messages = receiver.messages.lock().expect("no panic").clone();
    assert_eq!(messages.len(), 1);
    let message = &messages[0];
    assert_eq!(message.header("content-type"), "application/json");
    assert_eq!(message.header("webhook-id"), received[0].id);
    assert_eq!(message.header("webhook-signature"), signature(message));
    let body = message.json();
    assert_eq!(body["type"], "job.succeeded");
    assert_eq!(body["data"]["job"], job.to_string());
    assert_eq!(body["data"]["state"], "succeeded");
    assert!(body["timestamp"].is_string(), "{body}");
    task.abort();
    farm.stop().await;
}

/// The signature as a receiver computes it, here with another implementation: Python's.
fn signature(message: &Message) -> String {
    const VERIFIER: &str = "import base64, hashlib, hmac, sys
key = base64.b64decode(sys.argv[1].removeprefix('whsec_'))
print('v1,' + base64.b64encode(hmac.new(key, sys.argv[2].encode(), hashlib.sha256).digest()).decode())";
    let signed = format!(
        "{}.{}.{}",
        message.header("webhook-id"),
        message.header("webhook-timestamp"),
        String::from_utf8_lossy(&message.body)
    );
    if let Ok(output) = std::process::Command::new("python3").args(["-c", VERIFIER, SECRET, &signed]).output() {
        return String::from_utf8_lossy(&output.stdout).trim().to_owned();
    }
    skip("python3", "checking the signature with another program: python3 is not installed");
    message.header("webhook-signature").to_owned()
}

#[tokio::test]
async fn a_rejected_message_is_retried_unchanged() {
    let (address, receiver, task) = receive(&[500, 301, 429]).await;
    let farm = farm().await;
    let job = submit(&farm, &format!("webhook={address}"), 1).await;
    farm.worker("one").await.work_off().await;
    let once = |deliveries: &[DeliveryView]| deliveries.first().is_some_and(|delivery| delivery.attempts == 1);
    let first = deliveries(&farm, job, Duration::ZERO, once).await;
    assert_eq!((first[0].state, first[0].status), (DeliveryState::Pending, Some(500)));
    assert!(first[0].next_at.is_some() && first[0].error.is_some());
    let failing = async || {
        let list: AlertList = read(farm.get("/v1/alerts").await, StatusCode::OK).await;
        list.alerts.into_iter().find(|alert| alert.code == "webhooks_failing").map(|alert| alert.message)
    };
    let target = address.strip_prefix("http://").and_then(|rest| rest.split('/').next()).expect("a host and a port");
    let message = format!(
        "webhook messages cannot be delivered, such as to {target}: 1 will be tried again, 0 of the last day were given up"
    );
    assert_eq!(failing().await, Some(message));
    let received = deliveries(&farm, job, Duration::from_mins(1), is_over).await;
    assert_eq!((received[0].state, received[0].attempts), (DeliveryState::Delivered, 4));
    assert_eq!(failing().await, None, "it has arrived at last");
    let messages = receiver.messages.lock().expect("no panic").clone();
    assert_eq!(messages.len(), 4, "no redirect was followed");
    for message in &messages {
        assert_eq!(message.header("webhook-id"), messages[0].header("webhook-id"));
        assert_eq!(message.body, messages[0].body);
        assert_eq!(message.header("webhook-signature"), signature(message));
    }
    task.abort();
    farm.stop().await;
}

#[tokio::test]
async fn deliveries_fail_after_410_or_the_last_attempt() {
    let (address, receiver, task) = receive(&[410]).await;
    let farm = farm().await;
    let job = submit(&farm, &format!("webhook={address}"), 1).await;
    farm.worker("one").await.work_off().await;
    let received = deliveries(&farm, job, Duration::ZERO, is_over).await;
    assert_eq!((received[0].state, received[0].attempts), (DeliveryState::Failed, 1));
    assert_eq!(receiver.messages.lock().expect("no panic").len(), 1);
    task.abort();
    let closed = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port").local_addr().expect("an address");
    let job = submit(&farm, &format!("webhook=http://{closed}/"), 2).await;
    farm.worker("two").await.work_off().await;
    let received = deliveries(&farm, job, Duration::from_hours(30), is_over).await;
    assert_eq!((received[0].state, received[0].attempts, received[0].status), (DeliveryState::Failed, 10, None));
    let text = in_time(farm.get("/metrics").await.text()).await.expect("text");
    assert!(text.contains("sdfarm_webhook_failures_total 11"), "{text}");
    farm.stop().await;
}

#[tokio::test]
async fn chosen_events_are_delivered_after_a_restart() {
    let (address, receiver, task) = receive(&[]).await;
    let folder = tempfile::tempdir().expect("a temporary folder");
    let farm = Farm::start_in(folder, |config| config.webhook_secret = Some(Secret::from(SECRET.to_owned()))).await;
    // This server may not connect there; each attempt checks that again.
    refused(farm.post(&format!("/v1/jobs?webhook={address}"), small_job(1).to_string()).await, 422, "wrong_webhook")
        .await;
    farm.stop().await;
    let farm = self::farm().await;
    let query = format!("webhook={address}&webhook_event=job.running&webhook_event=frame.stored");
    let job = submit(&farm, &query, 1).await;
    farm.worker("one").await.work_off().await;
    let folder = farm.stop().await;
    let farm = Farm::start_in(folder, |config| {
        config.allowed_webhook_ranges = vec!["127.0.0.1".parse().expect("an address")];
        config.webhook_secret = Some(Secret::from(SECRET.to_owned()));
    })
    .await;
    let received = deliveries(&farm, job, Duration::from_mins(1), is_over).await;
    assert_eq!(
        received.iter().map(|received| received.event.as_str()).collect::<Vec<_>>(),
        ["job.running", "frame.stored"]
    );
    let messages = receiver.messages.lock().expect("no panic").clone();
    let stored = messages.iter().map(Message::json).find(|body| body["type"] == "frame.stored").expect("a message");
    assert_eq!(stored["data"]["image"], format!("/v1/jobs/{job}/frames/0/image"));
    task.abort();
    farm.stop().await;
}

#[tokio::test]
async fn invalid_webhooks_are_rejected() {
    let farm = Farm::start().await;
    for (query, code) in [
        ("webhook=http://farm.example/", "wrong_webhook"),
        ("webhook=https://127.0.0.1/", "wrong_webhook"),
        ("webhook=https://2130706433/", "wrong_webhook"),
        ("webhook=https://169.254.169.254/latest/meta-data", "wrong_webhook"),
        ("webhook=https://[::1]/", "wrong_webhook"),
        ("webhook=https://localhost/", "wrong_webhook"),
        ("webhook=https://a:b@farm.example/", "wrong_webhook"),
        ("webhook=file:///etc/passwd", "wrong_webhook"),
        ("webhook=", "wrong_webhook"),
        ("webhook=https://farm.example/&webhook_event=job.exploded", "wrong_query"),
        ("webhook_event=job.failed", "wrong_query"),
    ] {
        refused(farm.post(&format!("/v1/jobs?{query}"), small_job(1).to_string()).await, 422, code).await;
    }
    let many = ["webhook=https://farm.example/"; 5].join("&");
    refused(farm.post(&format!("/v1/jobs?{many}"), small_job(1).to_string()).await, 422, "wrong_query").await;
    let page: Value = read(farm.get("/v1/jobs").await, StatusCode::OK).await;
    assert_eq!(page["jobs"], json!([]));
    refused(farm.get(&format!("/v1/jobs/{}/webhooks", JobId::new())).await, 404, "unknown_job").await;
    farm.stop().await;
}

/// A receiver that accepts connections and never responds; returns its address and the number of connections.
async fn tar_pit() -> (String, Arc<Mutex<usize>>, JoinHandle<()>) {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = format!("http://{}/hook", listener.local_addr().expect("an address"));
    let accepted: Arc<Mutex<usize>> = Arc::default();
    let counter = Arc::clone(&accepted);
    let task = tokio::spawn(async move {
        let mut open = Vec::new();
        loop {
            open.push(listener.accept().await.expect("accepts"));
            *counter.lock().expect("no panic") = open.len();
        }
    });
    (address, accepted, task)
}

#[tokio::test]
async fn a_receiver_that_never_responds_delays_no_other() {
    let farm = farm().await;
    let (pit, accepted, pit_task) = tar_pit().await;
    let (hook, receiver, task) = receive(&[]).await;
    for seed in 0..20 {
        submit(&farm, &format!("webhook={pit}&webhook={pit}%3Fagain"), seed).await;
    }
    submit(&farm, &format!("webhook={hook}"), 20).await;
    farm.worker("one").await.work_off().await;
    in_time(async {
        while receiver.messages.lock().expect("no panic").is_empty() {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    })
    .await;
    let open = *accepted.lock().expect("no panic");
    assert!(open <= 4, "{open} attempts to one target");
    task.abort();
    pit_task.abort();
    farm.stop().await;
}
