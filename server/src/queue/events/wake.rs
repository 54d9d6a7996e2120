//! Wake signals after commits that others wait for: those on this server at once, and as hints those on others.

use std::sync::atomic::{AtomicU8, Ordering};

use tokio::sync::Notify;

use crate::queue::Queue;

/// Wake signals requested by a transition, sent after its commit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Wake {
    /// There may be work.
    pub(in crate::queue) work: bool,
    /// A lease was ended from outside, or a worker must drain.
    pub(in crate::queue) news: bool,
}

impl Wake {
    pub(in crate::queue) const WORK: Self = Self { work: true, news: false };
    pub(in crate::queue) const UPDATES: Self = Self { work: false, news: true };

    pub(in crate::queue) fn add(&mut self, other: Self) {
        self.work |= other.work;
        self.news |= other.news;
    }
}

/// Wake signals, sent after commits that others wait for.
#[derive(Debug, Default)]
pub(crate) struct WakeSignals {
    /// Wakes waiters for work.
    pub(crate) work: Notify,
    /// Wakes workers whose lease was ended from outside or that must drain.
    pub(crate) updates: Notify,
    /// Wakes the task that makes the pieces of large changes.
    pub(crate) cleanup: Notify,
    /// Hints for other servers that have not been sent.
    hints: AtomicU8,
    hints_added: Notify,
}

/// Wake signals for other servers, as bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Hints(u8);

impl Hints {
    /// There may be work.
    pub(crate) const WORK: Self = Self(1);
    /// All signals.
    pub(crate) const ALL: Self = Self(3);
    const UPDATES: Self = Self(2);

    fn of(wake: Wake) -> Self {
        Self(if wake.work { Self::WORK.0 } else { 0 } | if wake.news { Self::UPDATES.0 } else { 0 })
    }

    /// Reads the number of a message.
    pub(crate) fn from_bits(bits: u8) -> Self {
        Self(bits)
    }

    /// Number for a message.
    pub(crate) fn as_bits(self) -> u8 {
        self.0
    }
}

impl WakeSignals {
    fn notify(&self, hints: Hints) {
        if hints.0 & Hints::WORK.0 != 0 {
            self.work.notify_waiters();
        }
        if hints.0 & Hints::UPDATES.0 != 0 {
            self.updates.notify_waiters();
            // A change that ended leases may have more to void.
            self.cleanup.notify_one();
        }
    }
}

impl Queue {
    /// Sends wake signals, here and as hints to other servers.
    pub(in crate::queue) fn wake(&self, wake: Wake) {
        let hints = Hints::of(wake);
        self.wake_signals.notify(hints);
        if self.wake_signals.hints.fetch_or(hints.0, Ordering::Relaxed) | hints.0 != 0 {
            self.wake_signals.hints_added.notify_one();
        }
    }

    /// Wakes the workers that wait for work.
    pub(crate) fn wake_workers(&self) {
        self.wake(Wake { work: true, news: false });
    }

    /// Sends the wake signals that another server has hinted at.
    pub(crate) fn take_hints(&self, hints: Hints) {
        self.wake_signals.notify(hints);
    }

    /// Waits until there are hints for other servers.
    pub(crate) async fn hints_added(&self) {
        self.wake_signals.hints_added.notified().await;
    }

    /// Hints for other servers since the last call.
    pub(crate) fn drain_hints(&self) -> Hints {
        Hints(self.wake_signals.hints.swap(0, Ordering::Relaxed))
    }

    /// Wake signals sent after a commit that may add work, ends a lease from outside, or drains a worker.
    pub(crate) fn wake_signals(&self) -> &WakeSignals {
        &self.wake_signals
    }
}
