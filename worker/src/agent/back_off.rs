//! Back-off with increasing, jittered delays.

use std::hash::{BuildHasher, RandomState};
use std::time::Duration;

/// Delays that double from the first to the longest, each shortened by a random part.
#[derive(Debug)]
pub(super) struct BackOff {
    first: Duration,
    longest: Duration,
    next: Duration,
}

impl BackOff {
    pub(super) fn new(first: Duration, longest: Duration) -> Self {
        Self { first, longest, next: first }
    }

    /// Resets to the first delay.
    pub(super) fn reset(&mut self) {
        self.next = self.first;
    }

    /// The next delay: between half of the current one and all of it.
    pub(super) fn next(&mut self) -> Duration {
        let pause = self.next;
        self.next = (pause * 2).min(self.longest);
        let random = RandomState::new().hash_one(0) as u32;
        pause / 2 + (pause / 2).mul_f64(f64::from(random) / f64::from(u32::MAX))
    }

    pub(super) async fn pause(&mut self) {
        tokio::time::sleep(self.next()).await;
    }
}
