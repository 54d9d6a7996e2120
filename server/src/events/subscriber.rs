//! Subscriber to one job: missed events first, then new ones, then the end.

use std::sync::Arc;
use std::time::Duration;

use bytes::{Bytes, BytesMut};
use proto::JobId;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use super::{EncodedEvent, EventHub, MAX_PIECE_BYTES, Topic, encode_event};
use crate::db::DatabaseError;
use crate::queue::Queue;

/// Number of events read from the database at a time.
const EVENTS_PER_PAGE: u32 = 64;
/// After this time without events a comment is sent, so that proxies do not close the connection.
const KEEP_ALIVE_INTERVAL: Duration = Duration::from_secs(15);
/// The comment.
const KEEP_ALIVE_COMMENT: &[u8] = b":\n\n";

/// Result of subscribing.
#[derive(Debug)]
pub(crate) enum SubscribeOutcome {
    /// There are events, now or later.
    Subscribed(Box<EventSubscriber>),
    /// The job has finished, and the client has received all its events.
    Ended,
    /// The job does not exist.
    UnknownJob,
}

/// Subscriber to one job.
#[derive(Debug)]
pub(crate) struct EventSubscriber {
    queue: Queue,
    topic: Arc<Topic>,
    changes: watch::Receiver<()>,
    ending: CancellationToken,
    /// Number of the last event sent.
    last: i64,
    first: Option<Bytes>,
    /// Whether the last event sent is the job's final one.
    ended: bool,
}

impl EventSubscriber {
    /// Subscribes to a job from its first event, or after the given one.
    pub(crate) async fn start(
        events: &EventHub,
        job: JobId,
        after: Option<i64>,
        ending: CancellationToken,
    ) -> Result<SubscribeOutcome, DatabaseError> {
        let queue = events.queue.clone();
        let mut last = after.unwrap_or(0);
        let Some(found) = queue.event_position(job, last).await? else { return Ok(SubscribeOutcome::UnknownJob) };
        let topic = events.topic(found.job).await?;
        let changes = topic.changes();
        let mut first = Bytes::from_static(KEEP_ALIVE_COMMENT);
        let mut ended = false;
        // A number that was not assigned yet is from another farm, or from before a restore.
        if last < found.pruned || last > found.newest || found.is_in_gap {
            let Some((newest, snapshot)) = queue.snapshot(found.job).await? else {
                return Ok(SubscribeOutcome::UnknownJob);
            };
            ended = snapshot.state.is_final();
            let body = serde_json::to_string(&snapshot).expect("a snapshot is plain numbers and text");
            first = encode_event(newest, "snapshot", &body);
            last = newest;
        } else if found.ended && queue.job_events_after(found.job, last, 1).await?.is_empty() {
            return Ok(SubscribeOutcome::Ended);
        }
        Ok(SubscribeOutcome::Subscribed(Box::new(Self {
            queue,
            topic,
            changes,
            ending,
            last,
            first: Some(first),
            ended,
        })))
    }

    /// The next bytes to send; `None` at the end.
    pub(crate) async fn next(&mut self) -> Result<Option<Bytes>, DatabaseError> {
        if let Some(first) = self.first.take() {
            return Ok(Some(first));
        }
        loop {
            self.changes.borrow_and_update();
            let news = self.next_events().await?;
            let piece = &news[..piece_length(&news)];
            if let Some(last) = piece.last() {
                (self.last, self.ended) = (last.number, last.is_final);
                return Ok(Some(joined(piece)));
            }
            if self.ended {
                return Ok(None);
            }
            let changed = tokio::select! {
                () = self.ending.cancelled() => return Ok(None),
                changed = tokio::time::timeout(KEEP_ALIVE_INTERVAL, self.changes.changed()) => changed,
            };
            if changed.is_err() {
                // A deleted job has no further events.
                let there = self.queue.has_ended(self.topic.job).await?.is_some();
                return Ok(there.then(|| Bytes::from_static(KEEP_ALIVE_COMMENT)));
            }
        }
    }

    /// New events: from the list of recent events, or a page from the database.
    async fn next_events(&mut self) -> Result<Vec<EncodedEvent>, DatabaseError> {
        loop {
            let reaches_back_to = match self.topic.after(self.last) {
                Ok(recent) => return Ok(recent),
                Err(from) => from,
            };
            let page = self.queue.job_events_after(self.topic.job, self.last, EVENTS_PER_PAGE).await?;
            if !page.is_empty() {
                return Ok(page.iter().map(EncodedEvent::new).collect());
            }
            self.last = reaches_back_to;
        }
    }
}

/// Number of events that are sent together: as many as fit, but at least one.
fn piece_length(news: &[EncodedEvent]) -> usize {
    let sizes = news.iter().scan(0, |size_bytes, event| {
        *size_bytes += event.text.len();
        Some(*size_bytes)
    });
    sizes.take_while(|size_bytes| *size_bytes <= MAX_PIECE_BYTES).count().max(1).min(news.len())
}

fn joined(news: &[EncodedEvent]) -> Bytes {
    if let [event] = news {
        return event.text.clone();
    }
    let mut bytes = BytesMut::with_capacity(news.iter().map(|event| event.text.len()).sum());
    for event in news {
        bytes.extend_from_slice(&event.text);
    }
    bytes.freeze()
}
