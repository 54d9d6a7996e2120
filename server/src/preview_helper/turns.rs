//! Turns of helper processes: a few at a time, and those that wait in turn by their submitter, so that many requests
//! of one submitter never delay another's by more than one drawing.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::sync::oneshot;

/// Maximum number of waiting requests of all submitters.
const MAX_WAITING: usize = 64;
/// Maximum number of waiting requests of one submitter.
const MAX_WAITING_OF_ONE: usize = 16;
/// How long a request waits.
const MAX_WAIT: Duration = Duration::from_secs(10);

/// Counts running helpers, and lets requests wait.
#[derive(Clone, Debug)]
pub(super) struct Turns(Arc<Mutex<State>>);

#[derive(Debug)]
struct State {
    free: usize,
    /// Submitters in the order of their next turns; none has an empty queue.
    waiting: VecDeque<(String, VecDeque<oneshot::Sender<Turn>>)>,
}

impl State {
    fn waiting_of(&mut self, submitter: &str) -> Option<&mut VecDeque<oneshot::Sender<Turn>>> {
        self.waiting.iter_mut().find(|(name, _)| name == submitter).map(|(_, queue)| queue)
    }

    /// Takes the next request; its submitter's other requests wait behind those of all others.
    fn next(&mut self) -> Option<oneshot::Sender<Turn>> {
        let (name, mut queue) = self.waiting.pop_front()?;
        let next = queue.pop_front();
        if !queue.is_empty() {
            self.waiting.push_back((name, queue));
        }
        next
    }
}

/// Right to run a helper, until it is dropped.
#[derive(Debug)]
pub(super) struct Turn(Option<Turns>);

impl Drop for Turn {
    fn drop(&mut self) {
        let Some(turns) = self.0.take() else { return };
        loop {
            let mut state = turns.0.lock().expect("no holder panics");
            let Some(next) = state.next() else {
                state.free += 1;
                return;
            };
            drop(state);
            match next.send(Self(Some(turns.clone()))) {
                Ok(()) => return,
                // A request that does not wait any more returns the turn, which the next one gets.
                Err(mut turn) => drop(turn.0.take()),
            }
        }
    }
}

impl Turns {
    /// Turns of this many helpers at a time.
    pub(super) fn new(helpers: usize) -> Self {
        Self(Arc::new(Mutex::new(State { free: helpers, waiting: VecDeque::new() })))
    }

    /// Waits for a turn; `None` if too many requests wait, or for too long.
    pub(super) async fn wait(&self, submitter: &str) -> Option<Turn> {
        let turn = {
            let mut state = self.0.lock().expect("no holder panics");
            if state.free > 0 {
                state.free -= 1;
                return Some(Turn(Some(self.clone())));
            }
            // Requests that were abandoned leave room at once.
            for (_, queue) in &mut state.waiting {
                queue.retain(|sender| !sender.is_closed());
            }
            state.waiting.retain(|(_, queue)| !queue.is_empty());
            if state.waiting.iter().map(|(_, queue)| queue.len()).sum::<usize>() >= MAX_WAITING {
                return None;
            }
            let (sender, turn) = oneshot::channel();
            match state.waiting_of(submitter) {
                Some(queue) if queue.len() >= MAX_WAITING_OF_ONE => return None,
                Some(queue) => queue.push_back(sender),
                None => state.waiting.push_back((submitter.to_owned(), VecDeque::from([sender]))),
            }
            turn
        };
        tokio::time::timeout(MAX_WAIT, turn).await.ok()?.ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn submitters_take_turns() {
        let turns = Turns::new(1);
        let first = turns.wait("anna").await.expect("free");
        let order = Arc::new(Mutex::new(Vec::new()));
        let mut tasks = Vec::new();
        for name in ["anna", "anna", "anna", "berta", "carl"] {
            let (turns, order) = (turns.clone(), Arc::clone(&order));
            tasks.push(tokio::spawn(async move {
                let _turn = turns.wait(name).await.expect("a turn");
                order.lock().expect("no holder panics").push(name);
            }));
            tokio::task::yield_now().await;
        }
        drop(first);
        for task in tasks {
            task.await.expect("no panic");
        }
        assert_eq!(*order.lock().expect("no holder panics"), ["anna", "berta", "carl", "anna", "anna"]);
        drop(turns.wait("anna").await.expect("free again"));
    }

    #[tokio::test]
    async fn waiting_requests_are_bounded_by_submitter_and_together() {
        let turns = Turns::new(1);
        let held = turns.wait("anna").await.expect("free");
        let mut waiting = Vec::new();
        let mut refused = 0;
        for number in 0..100 {
            let (turns, name) = (turns.clone(), format!("user {}", number / 20));
            let mut wait = Box::pin(async move { turns.wait(&name).await });
            match futures_util::poll!(&mut wait) {
                std::task::Poll::Ready(None) => refused += 1,
                std::task::Poll::Ready(Some(_)) => panic!("there is no free turn"),
                std::task::Poll::Pending => waiting.push(wait),
            }
        }
        assert_eq!((waiting.len(), refused), (64, 36), "four users with 16 each");
        waiting.clear();
        drop(held);
        drop(turns.wait("anna").await.expect("abandoned requests take no turns"));
    }
}
