//! Distributes events to subscribers: one task reads new events once for all of them.
//!
//! A subscriber stores only the number of the last event it received. It reads newer events from its job's
//! list of recent events or, if it has fallen behind that list, from the database, a page at a time.

mod subscriber;
#[cfg(test)]
mod tests;

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex, Weak};
use std::time::Duration;

use bytes::Bytes;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use crate::clock::monotonic_now;
use crate::db::DatabaseError;
use crate::queue::{Event, Queue};

pub(crate) use subscriber::{EventSubscriber, SubscribeOutcome};

/// Recent events cached for a job with subscribers: about 64 KiB.
const MAX_RECENT: usize = 256;
/// Size above which events are sent in several pieces, so that a subscriber that does not read keeps few in memory.
const MAX_PIECE_BYTES: usize = 16 << 10;
/// Number of events read at a time.
const EVENTS_PER_PAGE: u32 = 512;
/// Minimum interval between two reads of new events; events in between are sent together.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Event as sent to the client.
#[derive(Clone, Debug)]
struct EncodedEvent {
    number: i64,
    is_final: bool,
    text: Bytes,
}

impl EncodedEvent {
    fn new(event: &Event) -> Self {
        let text = encode_event(event.number, &event.kind, &event.body);
        Self { number: event.number, is_final: event.is_final(), text }
    }
}

/// An event in the form of the HTML standard's event streams.
fn encode_event(number: i64, kind: &str, body: &str) -> Bytes {
    format!("id: {number}\nevent: {kind}\ndata: {body}\n\n").into()
}

/// Job with subscribers.
#[derive(Debug)]
pub(crate) struct Topic {
    job: i64,
    recent: Mutex<Recent>,
    changes: watch::Sender<()>,
}

#[derive(Debug)]
struct Recent {
    /// Number after which the list has all of the job's events that were read.
    from: i64,
    list: VecDeque<EncodedEvent>,
}

impl Topic {
    /// Signal sent when the job may have new events.
    pub(crate) fn changes(&self) -> watch::Receiver<()> {
        self.changes.subscribe()
    }

    fn push(&self, event: &Event) {
        let mut recent = self.recent.lock().expect("no holder panics");
        let last = recent.list.back().map_or(recent.from, |event| event.number);
        if event.number <= last {
            return;
        }
        recent.list.push_back(EncodedEvent::new(event));
        if recent.list.len() > MAX_RECENT
            && let Some(oldest) = recent.list.pop_front()
        {
            recent.from = oldest.number;
        }
    }

    /// The events after this number if the list reaches back to it; otherwise the number at which the list
    /// starts.
    fn after(&self, number: i64) -> Result<Vec<EncodedEvent>, i64> {
        let recent = self.recent.lock().expect("no holder panics");
        if number < recent.from {
            return Err(recent.from);
        }
        let known = recent.list.partition_point(|event| event.number <= number);
        Ok(recent.list.range(known..).cloned().collect())
    }
}

/// Jobs with subscribers, and the number of the last event read for them.
#[derive(Debug, Default)]
struct Subscriptions {
    position: i64,
    topics: HashMap<i64, Weak<Topic>>,
}

/// Distributes events to subscribers.
#[derive(Debug)]
pub(crate) struct EventHub {
    queue: Queue,
    followed: Mutex<Subscriptions>,
    topic_added: watch::Sender<()>,
}

impl EventHub {
    /// Distributes the events of this queue's jobs.
    pub(crate) fn new(queue: Queue) -> Self {
        Self { queue, followed: Mutex::default(), topic_added: watch::Sender::new(()) }
    }

    /// The topic of a job: the existing one, or a new one that receives every event from now on.
    pub(crate) async fn topic(&self, job: i64) -> Result<Arc<Topic>, DatabaseError> {
        if let Some(topic) = self.followed.lock().expect("no holder panics").topics.get(&job).and_then(Weak::upgrade) {
            return Ok(topic);
        }
        let newest = self.queue.newest_event().await?;
        let mut followed = self.followed.lock().expect("no holder panics");
        if let Some(topic) = followed.topics.get(&job).and_then(Weak::upgrade) {
            return Ok(topic);
        }
        followed.topics.retain(|_, topic| topic.strong_count() > 0);
        if followed.topics.is_empty() {
            followed.position = followed.position.max(newest);
        }
        let recent = Recent { from: followed.position, list: VecDeque::new() };
        let topic = Arc::new(Topic { job, recent: Mutex::new(recent), changes: watch::Sender::new(()) });
        followed.topics.insert(job, Arc::downgrade(&topic));
        drop(followed);
        // Commits since `newest` was read have already sent their signal.
        self.topic_added.send_replace(());
        Ok(topic)
    }

    /// Reads and distributes events until the farm shuts down.
    pub(crate) async fn run(&self, end: CancellationToken) {
        let mut commits = self.queue.commits();
        let mut wanted = self.topic_added.subscribe();
        loop {
            tokio::select! {
                () = end.cancelled() => return,
                changed = commits.changed() => if changed.is_err() { return },
                changed = wanted.changed() => if changed.is_err() { return },
            }
            let started = monotonic_now();
            if let Err(error) = self.publish().await {
                tracing::error!(%error, "could not read events");
            }
            tokio::time::sleep_until(started + POLL_INTERVAL).await;
        }
    }

    /// Distributes all new events.
    async fn publish(&self) -> Result<(), DatabaseError> {
        loop {
            let position = {
                let mut followed = self.followed.lock().expect("no holder panics");
                followed.topics.retain(|_, topic| topic.strong_count() > 0);
                if followed.topics.is_empty() {
                    return Ok(());
                }
                followed.position
            };
            let events = self.queue.events_after(position, EVENTS_PER_PAGE).await?;
            let Some(last) = events.last() else { return Ok(()) };
            let is_last_page = events.len() < EVENTS_PER_PAGE as usize;
            let mut changed_topics: HashMap<i64, Arc<Topic>> = HashMap::new();
            {
                let mut followed = self.followed.lock().expect("no holder panics");
                for event in &events {
                    if let Some(topic) = followed.topics.get(&event.job).and_then(Weak::upgrade) {
                        topic.push(event);
                        changed_topics.insert(event.job, topic);
                    }
                }
                followed.position = followed.position.max(last.number);
            }
            for topic in changed_topics.values() {
                topic.changes.send_replace(());
            }
            if is_last_page {
                return Ok(());
            }
        }
    }
}
