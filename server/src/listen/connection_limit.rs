//! Connection limit: counts connections, knows the idle ones, and evicts when there are too many.
//!
//! A connection is busy from a request's head until its response has been sent. Only idle connections are
//! evicted, the longest idle first, so health routes respond however many connections are idle.

use std::collections::BTreeMap;
use std::pin::Pin;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll};

use axum::body::Body;
use bytes::Bytes;
use hyper::body::{Body as HttpBody, Frame, SizeHint};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_util::sync::CancellationToken;

/// The connections of a listener.
#[derive(Debug)]
pub(crate) struct Crowd {
    places: Arc<Semaphore>,
    waiting: AtomicUsize,
    idle: Mutex<Idle>,
}

/// Idle connections, by since when.
#[derive(Debug, Default)]
struct Idle {
    turns: u64,
    since: BTreeMap<u64, CancellationToken>,
}

/// One connection's place.
#[derive(Debug)]
pub(super) struct Place(Arc<State>);

#[derive(Debug)]
struct State {
    crowd: Arc<Crowd>,
    sent_away: CancellationToken,
    requests: AtomicUsize,
    idle_since: Mutex<Option<u64>>,
    _permit: OwnedSemaphorePermit,
}

/// A request that is being answered.
#[derive(Debug)]
pub(super) struct Busy(Arc<State>);

impl Crowd {
    /// Slots for this many connections.
    pub(crate) fn new(connections: usize) -> Arc<Self> {
        let places = connections.clamp(1, Semaphore::MAX_PERMITS);
        Arc::new(Self {
            places: Arc::new(Semaphore::new(places)),
            waiting: AtomicUsize::new(0),
            idle: Mutex::default(),
        })
    }

    /// Takes a slot; if none is free, evicts the connection that has been idle longest.
    pub(super) async fn enter(self: &Arc<Self>) -> Place {
        let permit = if let Ok(permit) = Arc::clone(&self.places).try_acquire_owned() {
            permit
        } else {
            let _waiting = Waiting::new(self);
            self.send_away_oldest();
            let permit = Arc::clone(&self.places).acquire_owned().await;
            permit.expect("the places are never closed")
        };
        let place = Place(Arc::new(State {
            crowd: Arc::clone(self),
            sent_away: CancellationToken::new(),
            requests: AtomicUsize::new(0),
            idle_since: Mutex::new(None),
            _permit: permit,
        }));
        place.0.rest();
        place
    }

    /// Evicts the connection that has been idle longest, if any is idle.
    pub(super) fn send_away_oldest(&self) {
        let oldest = self.idle.lock().expect("no holder panics").since.pop_first();
        if let Some((_, oldest)) = oldest {
            oldest.cancel();
        }
    }
}

/// Counts a waiter until it is dropped.
struct Waiting<'a>(&'a Crowd);

impl<'a> Waiting<'a> {
    fn new(crowd: &'a Crowd) -> Self {
        crowd.waiting.fetch_add(1, Ordering::SeqCst);
        Self(crowd)
    }
}

impl Drop for Waiting<'_> {
    fn drop(&mut self) {
        self.0.waiting.fetch_sub(1, Ordering::SeqCst);
    }
}

impl Place {
    /// Starts a request; it ends when the returned guard is dropped.
    pub(super) fn work(&self) -> Busy {
        if self.0.requests.fetch_add(1, Ordering::SeqCst) == 0 {
            self.0.rise();
        }
        Busy(Arc::clone(&self.0))
    }

    /// Whether a request is being answered.
    pub(super) fn is_busy(&self) -> bool {
        self.0.requests.load(Ordering::SeqCst) > 0
    }

    /// Returns when the connection is evicted.
    pub(super) async fn sent_away(&self) {
        self.0.sent_away.cancelled().await;
    }
}

impl State {
    /// Marks the connection idle; it is evicted if another one waits for a slot.
    fn rest(&self) {
        {
            let mut idle = self.crowd.idle.lock().expect("no holder panics");
            idle.turns += 1;
            let turn = idle.turns;
            idle.since.insert(turn, self.sent_away.clone());
            *self.idle_since.lock().expect("no holder panics") = Some(turn);
        }
        if self.crowd.waiting.load(Ordering::SeqCst) > 0 {
            self.crowd.send_away_oldest();
        }
    }

    /// Marks the connection busy.
    fn rise(&self) {
        if let Some(turn) = self.idle_since.lock().expect("no holder panics").take() {
            self.crowd.idle.lock().expect("no holder panics").since.remove(&turn);
        }
    }
}

impl Drop for State {
    fn drop(&mut self) {
        self.rise();
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        if self.0.requests.fetch_sub(1, Ordering::SeqCst) == 1 {
            self.0.rest();
        }
    }
}

/// An answer's body, during which its connection is busy.
#[derive(Debug)]
pub(super) struct Attended {
    body: Body,
    _busy: Busy,
}

impl Attended {
    /// The body of an answer.
    pub(super) fn new(body: Body, busy: Busy) -> Self {
        Self { body, _busy: busy }
    }
}

impl HttpBody for Attended {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(cx)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn who_has_been_idle_longest_goes_first_and_the_busy_stay() {
        let crowd = Crowd::new(3);
        let (one, two, three) = (crowd.enter().await, crowd.enter().await, crowd.enter().await);
        let busy = one.work();
        let next = tokio::spawn({
            let crowd = Arc::clone(&crowd);
            async move { crowd.enter().await }
        });
        two.sent_away().await;
        assert!(!three.0.sent_away.is_cancelled() && !one.0.sent_away.is_cancelled());
        drop(two);
        drop(next.await.expect("a place"));
        drop(busy);
        assert!(!one.is_busy());
    }

    #[tokio::test]
    async fn who_becomes_idle_while_others_wait_goes() {
        let crowd = Crowd::new(1);
        let only = crowd.enter().await;
        let busy = only.work();
        let waiting = tokio::spawn({
            let crowd = Arc::clone(&crowd);
            async move { crowd.enter().await }
        });
        while crowd.waiting.load(Ordering::SeqCst) == 0 {
            tokio::task::yield_now().await;
        }
        assert!(!only.0.sent_away.is_cancelled());
        drop(busy);
        only.sent_away().await;
        drop(only);
        drop(waiting.await.expect("a place"));
    }

    #[tokio::test]
    async fn who_worked_since_is_idle_for_a_shorter_time_than_who_came_later() {
        let crowd = Crowd::new(3);
        let (one, two, three) = (crowd.enter().await, crowd.enter().await, crowd.enter().await);
        let (first, second) = (one.work(), one.work());
        drop(first);
        assert!(one.is_busy(), "another request is being answered");
        assert_eq!(crowd.idle.lock().expect("no holder panics").since.len(), 2);
        drop(second);
        assert_eq!(crowd.idle.lock().expect("no holder panics").since.len(), 3);
        crowd.send_away_oldest();
        assert!(two.0.sent_away.is_cancelled() && !one.0.sent_away.is_cancelled());
        drop(three);
        crowd.send_away_oldest();
        assert!(one.0.sent_away.is_cancelled(), "who has left is in nobody's way");
        assert!(crowd.idle.lock().expect("no holder panics").since.is_empty());
        crowd.send_away_oldest();
    }

    #[tokio::test]
    async fn answer_keeps_its_connection_busy_and_its_length() {
        let crowd = Crowd::new(0);
        let only = crowd.enter().await;
        let body = Attended::new(Body::from("12345"), only.work());
        assert_eq!((body.size_hint().exact(), body.is_end_stream()), (Some(5), false));
        assert!(only.is_busy());
        let sent = axum::body::to_bytes(Body::new(body), 100).await.expect("a body");
        assert_eq!(&sent[..], b"12345");
        assert!(!only.is_busy());
        assert!(Attended::new(Body::empty(), only.work()).is_end_stream());
    }
}
