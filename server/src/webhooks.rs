//! Delivers webhooks: sends due deliveries, signed, and records the outcome of each attempt.
//!
//! A delivery is sent at least once, under an id that stays the same, until the receiver accepts it or its
//! attempts are used up. No redirect is followed, no proxy is used, and a response's body is not read.

mod guard;
mod sign;

use std::collections::{HashMap, HashSet};
use std::sync::Arc;
use std::time::Duration;

use reqwest::header::CONTENT_TYPE;
use reqwest::redirect::Policy;
use reqwest::{Client, Url};
use serde_json::{Value, json};
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use crate::counters::ServerCounters;
use crate::db::DatabaseError;
use crate::queue::{Attempt, BusyReceivers, Delivery, Queue, jitter};

pub(crate) use guard::AddressPolicy;
pub use guard::AddressRange;
pub(crate) use sign::Signer;
pub use sign::{SecretError, webhook_secret};

/// Event types of webhooks.
pub(crate) const EVENTS: [&str; 5] = ["job.running", "job.succeeded", "job.failed", "job.cancelled", "frame.stored"];
/// Default event types of a webhook.
pub(crate) const FINAL_EVENTS: [&str; 3] = ["job.succeeded", "job.failed", "job.cancelled"];

/// Maximum number of concurrent attempts.
const MAX_CONCURRENT: usize = 128;
/// Maximum number of concurrent attempts of a submitter, so that a few of them cannot delay the others' messages.
const MAX_CONCURRENT_OF_SUBMITTER: usize = 16;
/// Maximum number of concurrent attempts to one host and port, which may be slow on purpose.
const MAX_CONCURRENT_TO_TARGET: usize = 4;
/// Time limit for connecting.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// Time limit for a response.
const TIMEOUT: Duration = Duration::from_secs(15);
/// Interval between checks for due deliveries, in addition to those after commits.
const POLL_INTERVAL: Duration = Duration::from_secs(1);
/// Minimum interval between two checks.
const MIN_POLL_INTERVAL: Duration = Duration::from_millis(100);
/// Delays after failed attempts, before jitter, in seconds; after the last one the delivery has failed.
const RETRY_DELAYS_SECONDS: [u64; 9] = [5, 30, 120, 600, 1_800, 7_200, 21_600, 43_200, 86_400];
/// Maximum length of a recorded error, in characters.
const ERROR_CHARACTERS: usize = 300;

/// Sender of webhooks.
#[derive(Debug)]
pub(crate) struct Webhooks {
    queue: Queue,
    guard: Arc<AddressPolicy>,
    signer: Signer,
    counters: Arc<ServerCounters>,
}

impl Webhooks {
    /// Creates a sender that signs messages and connects only to addresses that the guard permits.
    pub(crate) fn new(queue: Queue, guard: Arc<AddressPolicy>, signer: Signer, counters: Arc<ServerCounters>) -> Self {
        Self { queue, guard, signer, counters }
    }

    /// Sends due deliveries until the farm is closed.
    pub(crate) async fn run(self: Arc<Self>, end: CancellationToken) {
        let mut commits = self.queue.commits();
        let mut clients = ClientPair::default();
        let mut under_way = UnderWay::default();
        let mut attempts: JoinSet<(i64, Result<(), DatabaseError>)> = JoinSet::new();
        loop {
            tokio::select! {
                () = end.cancelled() => return,
                Some(done) = attempts.join_next(), if !attempts.is_empty() => match done {
                    Ok((number, written)) => {
                        under_way.end(number);
                        if let Err(error) = written {
                            tracing::error!(%error, "could not record a webhook attempt; the message will be sent again");
                        }
                    }
                    Err(error) => tracing::error!(%error, "a webhook attempt panicked"),
                },
                changed = tokio::time::timeout(POLL_INTERVAL, commits.changed()) => if matches!(changed, Ok(Err(_))) { return },
            }
            for delivery in self.start_due(&mut under_way).await {
                let is_http = delivery.url.starts_with("http:");
                let client = clients.get(&self, is_http);
                let webhooks = Arc::clone(&self);
                attempts.spawn(async move {
                    let attempt = webhooks.attempt(client, &delivery).await;
                    (delivery.number, webhooks.queue.record_attempt(delivery.number, attempt).await)
                });
            }
            tokio::time::sleep(MIN_POLL_INTERVAL).await;
        }
    }

    /// Due deliveries whose attempts may start now; marks them as under way.
    async fn start_due(&self, under_way: &mut UnderWay) -> Vec<Delivery> {
        let mut starting = Vec::new();
        loop {
            let due = match self.queue.due_deliveries(&under_way.busy(), under_way.free()).await {
                Ok(due) => due,
                Err(error) => {
                    tracing::error!(%error, "could not read due deliveries");
                    return starting;
                }
            };
            let free: Vec<Delivery> = due.into_iter().filter(|delivery| under_way.start(delivery)).collect();
            if free.is_empty() {
                return starting;
            }
            let claimed = match self.queue.claim_deliveries(free.iter().map(|delivery| delivery.number)).await {
                Ok(claimed) => claimed,
                Err(error) => {
                    tracing::error!(%error, "could not claim due deliveries");
                    HashSet::new()
                }
            };
            let (claimed, others): (Vec<_>, Vec<_>) =
                free.into_iter().partition(|delivery| claimed.contains(&delivery.number));
            for delivery in &others {
                under_way.end(delivery.number);
            }
            let is_over = claimed.is_empty() || under_way.free() == 0;
            starting.extend(claimed);
            // Those that were read and may not start hide others, until they are known to be busy.
            if is_over {
                return starting;
            }
        }
    }

    async fn attempt(&self, client: Result<Client, String>, delivery: &Delivery) -> Attempt {
        let sent = match client {
            Ok(client) => self.send(&client, delivery).await,
            Err(error) => Err(error),
        };
        let (status, error) = match sent {
            Ok(status) if (200..300).contains(&status) => return Attempt::Delivered { status },
            Ok(status) => (Some(status), format!("the response was {status}")),
            Err(error) => (None, error.chars().take(ERROR_CHARACTERS).collect()),
        };
        // 410 Gone means that the receiver wants no further attempts.
        let again_in = if status == Some(410) { None } else { wait(delivery.attempts, jitter()) };
        self.counters.webhook_failures.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        tracing::warn!(
            message = %delivery.id, job = %delivery.job, attempts = delivery.attempts + 1, %error,
            gives_up = again_in.is_none(), "webhook not delivered"
        );
        Attempt::Failed { status, error, retry_in: again_in }
    }

    /// Sends a delivery, and returns the status of the response.
    async fn send(&self, client: &Client, delivery: &Delivery) -> Result<u16, String> {
        // An address that was permitted at submission may not be permitted any more.
        let url: Url = self.guard.check(&delivery.url).map_err(|error| error.to_string())?;
        let body = message(delivery);
        let timestamp_seconds = self.queue.wall_seconds();
        let signature = self.signer.signature(&delivery.id, timestamp_seconds, &body);
        let response = client
            .post(url)
            .header(CONTENT_TYPE, "application/json")
            .header("webhook-id", &delivery.id)
            .header("webhook-timestamp", timestamp_seconds.to_string())
            .header("webhook-signature", signature)
            .body(body)
            .send()
            .await
            .map_err(|error| chain(&error.without_url()))?;
        Ok(response.status().as_u16())
    }

    fn client(&self, is_http: bool) -> reqwest::Result<Client> {
        proto::client_auth::client_builder()
            .connect_timeout(CONNECT_TIMEOUT)
            .timeout(TIMEOUT)
            .redirect(Policy::none())
            .no_proxy()
            .referer(false)
            .pool_max_idle_per_host(1)
            .user_agent(concat!("sdfarm/", env!("CARGO_PKG_VERSION")))
            .dns_resolver(self.guard.resolver(is_http))
            .build()
    }
}

/// HTTP clients for TLS and for plain HTTP; each is created at its first use.
#[derive(Debug, Default)]
struct ClientPair {
    https: Option<Client>,
    http: Option<Client>,
}

impl ClientPair {
    fn get(&mut self, webhooks: &Webhooks, is_http: bool) -> Result<Client, String> {
        let client = if is_http { &mut self.http } else { &mut self.https };
        if let Some(client) = client {
            return Ok(client.clone());
        }
        let made = webhooks.client(is_http).map_err(|error| chain(&error))?;
        Ok(client.insert(made).clone())
    }
}

/// Attempts under way.
#[derive(Debug, Default)]
struct UnderWay(HashMap<i64, Origin>);

/// Submitter and receiver of an attempt.
#[derive(Debug)]
struct Origin {
    submitter: String,
    target: String,
}

impl UnderWay {
    /// Number of attempts that may start.
    fn free(&self) -> u32 {
        MAX_CONCURRENT.saturating_sub(self.0.len()) as u32
    }

    fn of_submitter(&self, submitter: &str) -> usize {
        self.0.values().filter(|origin| origin.submitter == submitter).count()
    }

    fn to_target(&self, target: &str) -> usize {
        self.0.values().filter(|origin| origin.target == target).count()
    }

    /// Deliveries that may not start.
    fn busy(&self) -> BusyReceivers {
        let submitters: HashSet<_> = self.0.values().map(|origin| &origin.submitter).collect();
        let targets: HashSet<_> = self.0.values().map(|origin| &origin.target).collect();
        let full_submitters =
            submitters.into_iter().filter(|name| self.of_submitter(name) >= MAX_CONCURRENT_OF_SUBMITTER);
        let full_targets = targets.into_iter().filter(|name| self.to_target(name) >= MAX_CONCURRENT_TO_TARGET);
        BusyReceivers {
            deliveries: self.0.keys().copied().collect(),
            submitters: full_submitters.cloned().collect(),
            targets: full_targets.cloned().collect(),
        }
    }

    /// Marks a delivery as under way, unless too many others are.
    fn start(&mut self, delivery: &Delivery) -> bool {
        let Delivery { number, submitter, target, .. } = delivery;
        let may_start = self.free() > 0
            && !self.0.contains_key(number)
            && self.of_submitter(submitter) < MAX_CONCURRENT_OF_SUBMITTER
            && self.to_target(target) < MAX_CONCURRENT_TO_TARGET;
        if may_start {
            self.0.insert(*number, Origin { submitter: submitter.clone(), target: target.clone() });
        }
        may_start
    }

    /// Forgets a delivery whose attempt has ended.
    fn end(&mut self, number: i64) {
        self.0.remove(&number);
    }
}

/// Body of the message: the same bytes in every attempt.
fn message(delivery: &Delivery) -> String {
    let mut data = serde_json::from_str(&delivery.body).unwrap_or(Value::Null);
    let timestamp = data.as_object_mut().and_then(|data| data.remove("at"));
    if let Some(data) = data.as_object_mut() {
        data.insert("job".to_owned(), json!(delivery.job));
        data.insert("name".to_owned(), json!(delivery.name));
    }
    let mut message = json!({ "type": delivery.event, "data": data });
    if let Some(timestamp) = timestamp {
        message["timestamp"] = timestamp;
    }
    message.to_string()
}

/// Delay before the next attempt; `jitter` is from 0 to 1.
fn wait(attempts: u32, jitter: f64) -> Option<Duration> {
    let seconds = *RETRY_DELAYS_SECONDS.get(attempts as usize)?;
    Some(Duration::from_secs(seconds).mul_f64(0.8 + 0.4 * jitter))
}

/// Joins an error and its causes in one line.
fn chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn retry_delays_grow_to_a_day_and_end() {
        assert_eq!(wait(0, 0.5), Some(Duration::from_secs(5)));
        assert_eq!(wait(0, 0.0), Some(Duration::from_secs(4)));
        assert_eq!(wait(8, 1.0), Some(Duration::from_mins(24 * 60 * 6 / 5)));
        assert_eq!(wait(9, 0.5), None);
    }

    #[test]
    fn attempts_are_bounded_by_target_and_by_submitter() {
        let mut under_way = UnderWay::default();
        let mut started = |submitter: &str, target: &str, number: i64| {
            let (submitter, target) = (submitter.to_owned(), target.to_owned());
            let text = String::new;
            under_way.start(&Delivery {
                number,
                id: text(),
                event: text(),
                url: text(),
                target,
                submitter,
                job: text(),
                name: text(),
                body: text(),
                attempts: 0,
            })
        };
        let to_one_target = (0..240).filter(|number| started("anna", "tar-pit:80", *number)).count();
        assert_eq!(to_one_target, MAX_CONCURRENT_TO_TARGET);
        let of_one_submitter =
            (240..500).filter(|number| started("anna", &format!("{number}.example:80"), *number)).count();
        assert_eq!(of_one_submitter, MAX_CONCURRENT_OF_SUBMITTER - MAX_CONCURRENT_TO_TARGET);
        assert!(started("bert", "hooks.example:443", 500) && !started("bert", "tar-pit:80", 501));
        let busy = under_way.busy();
        assert_eq!((busy.submitters, busy.targets), (vec!["anna".to_owned()], vec!["tar-pit:80".to_owned()]));
        assert_eq!(busy.deliveries.len(), MAX_CONCURRENT_OF_SUBMITTER + 1);
        under_way.end(0);
        assert_eq!(under_way.busy().targets, Vec::<String>::new());
    }

    #[test]
    fn a_message_has_the_same_bytes_in_every_attempt() {
        let mut delivery = Delivery {
            number: 1,
            id: "msg_1".to_owned(),
            event: "job.failed".to_owned(),
            url: "https://farm.example/".to_owned(),
            target: "farm.example:443".to_owned(),
            submitter: "local".to_owned(),
            job: "j".to_owned(),
            name: "csg".to_owned(),
            body: r#"{"state":"failed","errors":["no"],"at":"2026-01-01T00:00:00.000Z"}"#.to_owned(),
            attempts: 0,
        };
        let first = message(&delivery);
        delivery.attempts = 3;
        assert_eq!(message(&delivery), first);
        let wanted = json!({
            "type": "job.failed", "timestamp": "2026-01-01T00:00:00.000Z",
            "data": { "job": "j", "name": "csg", "state": "failed", "errors": ["no"] }
        });
        assert_eq!(serde_json::from_str::<Value>(&first).expect("JSON"), wanted);
    }
}
