//! Queue for a few places, in which holders wait by turns: however much one of them wants, it delays another by
//! one piece of work.

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex};

use tokio::sync::oneshot;

/// Places, and the holders that wait for one.
#[derive(Debug)]
pub(crate) struct FairQueue {
    limits: WaitingLimits,
    state: Mutex<State>,
}

/// Maximum numbers of waiters.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WaitingLimits {
    /// Of one holder.
    pub(crate) of_one: usize,
    /// Of all holders together.
    pub(crate) of_all: usize,
}

#[derive(Debug)]
struct State {
    free: usize,
    /// Holders with at least one waiter, by the time of their last turn.
    waiting: VecDeque<Waiting>,
    /// Places that each holder has.
    busy: HashMap<String, usize>,
}

#[derive(Debug)]
struct Waiting {
    holder: String,
    waiters: VecDeque<oneshot::Sender<QueueTurn>>,
}

/// Place of a holder; it is passed on when this is dropped.
#[derive(Debug)]
pub(crate) struct QueueTurn(Option<(Arc<FairQueue>, String)>);

/// Error returned when this many wait already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TooManyWaiting(pub(crate) usize);

impl WaitingLimits {
    /// Limits of each holder alone.
    pub(crate) fn of_one(of_one: usize) -> Self {
        Self { of_one, of_all: usize::MAX }
    }
}

impl FairQueue {
    /// Queue for this many places.
    pub(crate) fn new(places: usize, limits: WaitingLimits) -> Arc<Self> {
        let state = State { free: places.max(1), waiting: VecDeque::new(), busy: HashMap::new() };
        Arc::new(Self { limits, state: Mutex::new(state) })
    }

    /// Waits for a place.
    pub(crate) async fn enter(self: &Arc<Self>, holder: &str) -> Result<QueueTurn, TooManyWaiting> {
        let receiver = {
            let mut state = self.state.lock().expect("no holder panics");
            if state.free > 0 {
                state.free -= 1;
                return Ok(self.place(&mut state, holder.to_owned()));
            }
            state.wait(holder, self.limits)?
        };
        // The queue outlives this call, and passes every place on.
        receiver.await.map_err(|_| TooManyWaiting(0))
    }

    fn place(self: &Arc<Self>, state: &mut State, holder: String) -> QueueTurn {
        *state.busy.entry(holder.clone()).or_default() += 1;
        QueueTurn(Some((Arc::clone(self), holder)))
    }

    /// Passes a place on to the waiting holder that has the fewest, or the longest wait among those.
    fn pass_on(self: &Arc<Self>, holder: &str) {
        self.state.lock().expect("no holder panics").leave(holder);
        loop {
            let (waiter, place) = {
                let mut state = self.state.lock().expect("no holder panics");
                let Some((next, waiter)) = state.next() else {
                    state.free += 1;
                    return;
                };
                let place = self.place(&mut state, next);
                (waiter, place)
            };
            match waiter.send(place) {
                Ok(()) => return,
                // It waits no longer: the place goes to the next one, without a recursive drop.
                Err(mut place) => {
                    if let Some((_, holder)) = place.0.take() {
                        self.state.lock().expect("no holder panics").leave(&holder);
                    }
                }
            }
        }
    }
}

impl State {
    fn wait(&mut self, holder: &str, limits: WaitingLimits) -> Result<oneshot::Receiver<QueueTurn>, TooManyWaiting> {
        if self.exceeded(holder, limits).is_some() {
            // Those whose client has gone do not count.
            for waiting in &mut self.waiting {
                waiting.waiters.retain(|waiter| !waiter.is_closed());
            }
            self.waiting.retain(|waiting| !waiting.waiters.is_empty());
        }
        if let Some(limit) = self.exceeded(holder, limits) {
            return Err(TooManyWaiting(limit));
        }
        let (sender, receiver) = oneshot::channel();
        match self.waiting.iter_mut().find(|waiting| waiting.holder == holder) {
            Some(waiting) => waiting.waiters.push_back(sender),
            None => self.waiting.push_back(Waiting { holder: holder.to_owned(), waiters: [sender].into() }),
        }
        Ok(receiver)
    }

    /// The limit that another waiter of this holder would exceed.
    fn exceeded(&self, holder: &str, limits: WaitingLimits) -> Option<usize> {
        let of = |counted: &dyn Fn(&Waiting) -> bool| {
            self.waiting.iter().filter(|waiting| counted(waiting)).map(|waiting| waiting.waiters.len()).sum::<usize>()
        };
        if of(&|waiting| waiting.holder == holder) >= limits.of_one {
            return Some(limits.of_one);
        }
        (of(&|_| true) >= limits.of_all).then_some(limits.of_all)
    }

    fn leave(&mut self, holder: &str) {
        if let Some(busy) = self.busy.get_mut(holder) {
            *busy -= 1;
            if *busy == 0 {
                self.busy.remove(holder);
            }
        }
    }

    /// The next holder and its first waiter; the holder's next turn comes after all others'.
    fn next(&mut self) -> Option<(String, oneshot::Sender<QueueTurn>)> {
        loop {
            let busy = |waiting: &Waiting| self.busy.get(&waiting.holder).copied().unwrap_or(0);
            let (turn, _) = self.waiting.iter().enumerate().min_by_key(|(_, waiting)| busy(waiting))?;
            let mut waiting = self.waiting.remove(turn)?;
            let waiter = waiting.waiters.pop_front();
            let holder = waiting.holder.clone();
            if !waiting.waiters.is_empty() {
                self.waiting.push_back(waiting);
            }
            if let Some(waiter) = waiter {
                return Some((holder, waiter));
            }
        }
    }
}

impl Drop for QueueTurn {
    fn drop(&mut self) {
        if let Some((queue, holder)) = self.0.take() {
            queue.pass_on(&holder);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Names of the holders in the order in which they get the only place.
    async fn order(wanted: &[&'static str], max_waiting: usize) -> Vec<&'static str> {
        let queue = FairQueue::new(1, WaitingLimits::of_one(max_waiting));
        let first = queue.enter("first").await.expect("a free place");
        let (sender, mut receiver) = tokio::sync::mpsc::unbounded_channel();
        for (number, &holder) in wanted.iter().enumerate() {
            let (queue, sender) = (Arc::clone(&queue), sender.clone());
            let waiting = Arc::clone(&queue);
            tokio::spawn(async move {
                if let Ok(place) = queue.enter(holder).await {
                    sender.send(holder).expect("the test reads");
                    drop(place);
                }
            });
            let count = || -> usize {
                waiting.state.lock().expect("no holder panics").waiting.iter().map(|holder| holder.waiters.len()).sum()
            };
            for _ in 0..1000 {
                if count() > number {
                    break;
                }
                tokio::task::yield_now().await;
            }
        }
        drop((first, sender));
        let mut order = Vec::new();
        while let Some(holder) = receiver.recv().await {
            order.push(holder);
        }
        let state = queue.state.lock().expect("no holder panics");
        assert!(state.free == 1 && state.waiting.is_empty() && state.busy.is_empty(), "{state:?}");
        order
    }

    #[tokio::test]
    async fn holders_take_turns() {
        assert_eq!(order(&["a", "a", "a", "a", "b", "c", "b"], 9).await, ["a", "b", "c", "a", "b", "a", "a"]);
    }

    #[tokio::test]
    async fn a_holder_waits_a_limited_number_of_times() {
        assert_eq!(order(&["a", "a", "a", "a", "b"], 2).await, ["a", "b", "a"]);
    }

    #[tokio::test]
    async fn a_place_goes_first_to_a_holder_that_has_none() {
        let queue = FairQueue::new(2, WaitingLimits::of_one(9));
        let [one, _two] = [queue.enter("a").await.expect("free"), queue.enter("a").await.expect("free")];
        let more = tokio::spawn({
            let queue = Arc::clone(&queue);
            async move { queue.enter("a").await }
        });
        let other = tokio::spawn({
            let queue = Arc::clone(&queue);
            async move { queue.enter("b").await }
        });
        while queue.state.lock().expect("no holder panics").waiting.len() < 2 {
            tokio::task::yield_now().await;
        }
        // It waits longer, but its holder has a place.
        assert_eq!(queue.state.lock().expect("no holder panics").waiting[0].holder, "a");
        drop(one);
        let _b = other.await.expect("no panic").expect("its place");
        assert!(!more.is_finished());
        more.abort();
    }

    #[tokio::test]
    async fn waiters_are_bounded_by_holder_and_together() {
        let queue = FairQueue::new(1, WaitingLimits { of_one: 16, of_all: 64 });
        let held = queue.enter("anna").await.expect("free");
        let (mut waiting, mut refused) = (Vec::new(), Vec::new());
        for number in 0..100 {
            let (queue, name) = (Arc::clone(&queue), format!("user {}", number / 20));
            let mut wait = Box::pin(async move { queue.enter(&name).await });
            match futures_util::poll!(&mut wait) {
                std::task::Poll::Ready(Err(TooManyWaiting(limit))) => refused.push(limit),
                std::task::Poll::Ready(Ok(_)) => panic!("there is no free place"),
                std::task::Poll::Pending => waiting.push(wait),
            }
        }
        assert_eq!(waiting.len(), 64, "four users with 16 each");
        assert_eq!(refused, [[16; 16].as_slice(), &[64; 20]].concat());
        waiting.clear();
        let mut next = Box::pin(queue.enter("user 4"));
        assert!(futures_util::poll!(&mut next).is_pending(), "those that are gone leave room");
        drop(held);
        drop(next.await.expect("those that are gone take no places"));
    }

    #[tokio::test]
    async fn a_waiter_that_is_gone_is_passed_over() {
        let queue = FairQueue::new(1, WaitingLimits::of_one(1));
        let first = queue.enter("a").await.expect("free");
        for _ in 0..3 {
            let mut gone = Box::pin(queue.enter("a"));
            assert!(futures_util::poll!(&mut gone).is_pending(), "those before it do not count");
        }
        let mut waiting = Box::pin(queue.enter("b"));
        assert!(futures_util::poll!(&mut waiting).is_pending());
        drop(first);
        drop(waiting.await.expect("a place"));
        assert_eq!(queue.state.lock().expect("no holder panics").free, 1);
    }
}
