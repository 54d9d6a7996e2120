//! Connection limit: counts connections, tracks the idle ones, and evicts some when there are too many.
//!
//! A connection is busy from a request's head until its response has been written to the socket. Only idle
//! connections are evicted, the longest idle first, so health routes respond however many connections are idle;
//! `admission/shares.rs` bounds the busy ones. One address may have a part of all connections, so that the connections of
//! others are not evicted for it; loopback is exempt, because a proxy on this machine connects for many clients.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll};

use axum::body::Body;
use bytes::Bytes;
use hyper::body::{Body as HttpBody, Frame, SizeHint};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_util::sync::CancellationToken;

use crate::admission::{ResponseShares, address_name};
use crate::budget::{Budget, Share};

/// One slot of this many is kept free while there are idle connections to evict.
const SPARE_FRACTION: usize = 64;

/// Open connections of a listener.
#[derive(Debug)]
pub(crate) struct ConnectionLimit {
    slots: Arc<Semaphore>,
    spare_slots: usize,
    waiting: AtomicUsize,
    idle: Mutex<Idle>,
    by_address: Arc<Budget>,
}

/// Idle connections, ordered by the time since when they are idle.
#[derive(Debug, Default)]
struct Idle {
    idle_sequence: u64,
    since: BTreeMap<u64, CancellationToken>,
}

/// Slot of one connection.
#[derive(Debug)]
pub(super) struct ConnectionSlot(Arc<SlotState>);

#[derive(Debug)]
struct SlotState {
    limit: Arc<ConnectionLimit>,
    evicted: CancellationToken,
    requests: AtomicUsize,
    idle_since: Mutex<Option<u64>>,
    _permit: OwnedSemaphorePermit,
    _of_address: Option<Share>,
}

/// Request in progress.
#[derive(Debug)]
pub(super) struct ActiveRequest(Arc<SlotState>);

impl ConnectionLimit {
    /// Slots for this many connections; one address may have `of_address` of them.
    pub(crate) fn new(connections: usize, of_address: usize) -> Arc<Self> {
        let places = connections.clamp(1, Semaphore::MAX_PERMITS);
        Arc::new(Self {
            slots: Arc::new(Semaphore::new(places)),
            spare_slots: places / SPARE_FRACTION,
            waiting: AtomicUsize::new(0),
            idle: Mutex::default(),
            by_address: Budget::new(usize::MAX, of_address),
        })
    }

    /// Takes a slot; if none is free, evicts the connection that has been idle longest. `None` if the address
    /// has its part.
    pub(super) async fn acquire(self: &Arc<Self>, address: IpAddr) -> Option<ConnectionSlot> {
        let of_address =
            if address.is_loopback() { None } else { Some(self.by_address.take(&address_name(address), 1).ok()?) };
        let permit = if let Ok(permit) = Arc::clone(&self.slots).try_acquire_owned() {
            permit
        } else {
            let _waiting = WaiterGuard::new(self);
            self.evict_idle();
            let permit = Arc::clone(&self.slots).acquire_owned().await;
            permit.expect("the semaphore is never closed")
        };
        // Closing takes a moment; with slots to spare, the next connections need not wait for it.
        if self.slots.available_permits() < self.spare_slots {
            self.evict_idle();
        }
        let place = ConnectionSlot(Arc::new(SlotState {
            limit: Arc::clone(self),
            evicted: CancellationToken::new(),
            requests: AtomicUsize::new(0),
            idle_since: Mutex::new(None),
            _permit: permit,
            _of_address: of_address,
        }));
        place.0.mark_idle();
        Some(place)
    }

    /// Evicts the connection that has been idle longest, if any is idle.
    pub(super) fn evict_idle(&self) {
        let oldest = self.idle.lock().expect("no holder panics").since.pop_first();
        if let Some((_, oldest)) = oldest {
            oldest.cancel();
        }
    }
}

/// Counts a waiter until it is dropped.
struct WaiterGuard<'a>(&'a ConnectionLimit);

impl<'a> WaiterGuard<'a> {
    fn new(limit: &'a ConnectionLimit) -> Self {
        limit.waiting.fetch_add(1, Ordering::SeqCst);
        Self(limit)
    }
}

impl Drop for WaiterGuard<'_> {
    fn drop(&mut self) {
        self.0.waiting.fetch_sub(1, Ordering::SeqCst);
    }
}

impl ConnectionSlot {
    /// Starts a request; it ends when the returned guard is dropped.
    pub(super) fn begin_request(&self) -> ActiveRequest {
        if self.0.requests.fetch_add(1, Ordering::SeqCst) == 0 {
            self.0.mark_busy();
        }
        ActiveRequest(Arc::clone(&self.0))
    }

    /// Whether a request is in progress.
    pub(super) fn is_busy(&self) -> bool {
        self.0.requests.load(Ordering::SeqCst) > 0
    }

    /// Returns when the connection is evicted.
    pub(super) async fn evicted(&self) {
        self.0.evicted.cancelled().await;
    }
}

impl SlotState {
    /// Marks the connection idle; it is evicted if another one waits for a slot.
    fn mark_idle(&self) {
        {
            let mut idle = self.limit.idle.lock().expect("no holder panics");
            idle.idle_sequence += 1;
            let turn = idle.idle_sequence;
            idle.since.insert(turn, self.evicted.clone());
            *self.idle_since.lock().expect("no holder panics") = Some(turn);
        }
        if self.limit.waiting.load(Ordering::SeqCst) > 0 {
            self.limit.evict_idle();
        }
    }

    /// Marks the connection busy.
    fn mark_busy(&self) {
        if let Some(turn) = self.idle_since.lock().expect("no holder panics").take() {
            self.limit.idle.lock().expect("no holder panics").since.remove(&turn);
        }
    }
}

impl Drop for SlotState {
    fn drop(&mut self) {
        self.mark_busy();
    }
}

impl Drop for ActiveRequest {
    fn drop(&mut self) {
        if self.0.requests.fetch_sub(1, Ordering::SeqCst) == 1 {
            self.0.mark_idle();
        }
    }
}

/// Responses of a connection whose bytes may not be in the socket yet, with what they keep until then.
#[derive(Clone, Debug, Default)]
pub(super) struct Unsent(Arc<Mutex<Vec<ResponseGuard>>>);

/// State that a response keeps until it is written to the socket.
type ResponseGuard = (ActiveRequest, Option<ResponseShares>);

impl Unsent {
    /// Call when everything is written to the socket.
    pub(super) fn clear(&self) {
        let sent = std::mem::take(&mut *self.0.lock().expect("no holder panics"));
        drop(sent);
    }
}

/// Body of a response; the connection is busy until it is written to the socket.
#[derive(Debug)]
pub(super) struct TrackedBody {
    body: Body,
    guard: Option<ResponseGuard>,
    unsent: Unsent,
}

impl TrackedBody {
    /// Body of a response.
    pub(super) fn new(body: Body, busy: ActiveRequest, shares: Option<ResponseShares>, unsent: Unsent) -> Self {
        Self { body, guard: Some((busy, shares)), unsent }
    }
}

impl Drop for TrackedBody {
    /// The body was read to its end, but its last bytes may wait in the connection's buffer.
    fn drop(&mut self) {
        self.unsent.0.lock().expect("no holder panics").extend(self.guard.take());
    }
}

impl HttpBody for TrackedBody {
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
    use std::net::Ipv4Addr;

    use super::*;

    async fn acquire(limit: &Arc<ConnectionLimit>) -> ConnectionSlot {
        limit.acquire(Ipv4Addr::LOCALHOST.into()).await.expect("loopback has no limit")
    }

    #[tokio::test]
    async fn slots_are_freed_before_they_are_needed() {
        let limit = ConnectionLimit::new(2 * SPARE_FRACTION, 1);
        let mut open = Vec::new();
        for _ in 0..2 * SPARE_FRACTION - 2 {
            open.push(acquire(&limit).await);
        }
        assert!(open.iter().all(|slot| !slot.0.evicted.is_cancelled()), "two slots are free");
        open.push(acquire(&limit).await);
        assert!(open[0].0.evicted.is_cancelled() && !open[1].0.evicted.is_cancelled());
    }

    #[tokio::test]
    async fn one_address_has_a_part_of_the_connections() {
        let limit = ConnectionLimit::new(9, 2);
        let [one, other] = [[10, 0, 0, 1], [10, 0, 0, 2]].map(IpAddr::from);
        let two = [limit.acquire(one).await, limit.acquire(one).await];
        assert!(two.iter().all(Option::is_some) && limit.acquire(one).await.is_none());
        assert!(limit.acquire(other).await.is_some());
        drop(two);
        assert!(limit.acquire(one).await.is_some());
    }

    #[tokio::test]
    async fn the_longest_idle_connection_is_evicted_and_busy_ones_stay() {
        let limit = ConnectionLimit::new(3, 3);
        let (one, two, three) = (acquire(&limit).await, acquire(&limit).await, acquire(&limit).await);
        let busy = one.begin_request();
        let next = tokio::spawn({
            let limit = Arc::clone(&limit);
            async move { acquire(&limit).await }
        });
        two.evicted().await;
        assert!(!three.0.evicted.is_cancelled() && !one.0.evicted.is_cancelled());
        drop(two);
        drop(next.await.expect("a place"));
        drop(busy);
        assert!(!one.is_busy());
    }

    #[tokio::test]
    async fn a_connection_that_becomes_idle_while_others_wait_is_evicted() {
        let limit = ConnectionLimit::new(1, 1);
        let only = acquire(&limit).await;
        let busy = only.begin_request();
        let waiting = tokio::spawn({
            let limit = Arc::clone(&limit);
            async move { acquire(&limit).await }
        });
        while limit.waiting.load(Ordering::SeqCst) == 0 {
            tokio::task::yield_now().await;
        }
        assert!(!only.0.evicted.is_cancelled());
        drop(busy);
        only.evicted().await;
        drop(only);
        drop(waiting.await.expect("a place"));
    }

    #[tokio::test]
    async fn idle_time_starts_after_the_last_response() {
        let limit = ConnectionLimit::new(3, 3);
        let (one, two, three) = (acquire(&limit).await, acquire(&limit).await, acquire(&limit).await);
        let (first, second) = (one.begin_request(), one.begin_request());
        drop(first);
        assert!(one.is_busy(), "another request is in progress");
        assert_eq!(limit.idle.lock().expect("no holder panics").since.len(), 2);
        drop(second);
        assert_eq!(limit.idle.lock().expect("no holder panics").since.len(), 3);
        limit.evict_idle();
        assert!(two.0.evicted.is_cancelled() && !one.0.evicted.is_cancelled());
        drop(three);
        limit.evict_idle();
        assert!(one.0.evicted.is_cancelled(), "a closed connection takes no slot");
        assert!(limit.idle.lock().expect("no holder panics").since.is_empty());
        limit.evict_idle();
    }

    #[tokio::test]
    async fn a_response_keeps_its_connection_busy_and_its_length() {
        let limit = ConnectionLimit::new(0, 0);
        let only = acquire(&limit).await;
        let unsent = Unsent::default();
        let body = TrackedBody::new(Body::from("12345"), only.begin_request(), None, unsent.clone());
        assert_eq!((body.size_hint().exact(), body.is_end_stream()), (Some(5), false));
        assert!(only.is_busy());
        let sent = axum::body::to_bytes(Body::new(body), 100).await.expect("a body");
        assert_eq!(&sent[..], b"12345");
        assert!(only.is_busy(), "it is not written to the socket yet");
        unsent.clear();
        assert!(!only.is_busy());
        assert!(TrackedBody::new(Body::empty(), only.begin_request(), None, unsent).is_end_stream());
    }
}
