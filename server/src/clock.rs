//! Time: leases and back-off use a monotonic clock that starts at 0 with the server, so that a jump of the
//! wall clock expires nothing; users see the wall clock.
//!
//! Nothing else in this crate reads the system's time of day.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// A source of time.
#[derive(Clone, Debug)]
pub struct Clock(Source);

#[derive(Clone, Debug)]
enum Source {
    System(Instant),
    Hand(Hand),
}

impl Clock {
    /// The machine's clocks; its monotonic time starts now.
    pub fn system() -> Self {
        Self(Source::System(instant().into_std()))
    }

    /// Clock that only the returned handle advances, for tests.
    pub fn by_hand() -> (Self, Hand) {
        let hand = Hand::default();
        (Self(Source::Hand(hand.clone())), hand)
    }

    /// Milliseconds since the server started; never falls.
    pub(crate) fn now_ms(&self) -> i64 {
        match &self.0 {
            Source::System(start) => i64::try_from(start.elapsed().as_millis()).unwrap_or(i64::MAX),
            Source::Hand(hand) => hand.now_ms.load(Ordering::SeqCst),
        }
    }

    /// Milliseconds since 1970, by the wall clock; for people only.
    pub(crate) fn wall_ms(&self) -> i64 {
        match &self.0 {
            Source::System(_) => time_of_day_ms(),
            Source::Hand(hand) => hand.now_ms.load(Ordering::SeqCst) + hand.jumped_ms.load(Ordering::SeqCst),
        }
    }
}

/// The machine's monotonic time, for waits and for measured durations; no decision depends on it.
#[expect(clippy::disallowed_methods, reason = "this is where the machine is asked")]
pub(crate) fn instant() -> tokio::time::Instant {
    tokio::time::Instant::now()
}

#[expect(clippy::disallowed_methods, reason = "this is where the machine is asked")]
fn time_of_day_ms() -> i64 {
    let age = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(age.as_millis()).unwrap_or(i64::MAX)
}

/// Advances a clock made by [`Clock::by_hand`].
#[derive(Clone, Debug, Default)]
pub struct Hand {
    now_ms: Arc<AtomicI64>,
    /// Offset of the wall clock from that.
    jumped_ms: Arc<AtomicI64>,
}

impl Hand {
    /// Lets time pass.
    pub fn advance(&self, time: Duration) {
        self.now_ms.fetch_add(i64::try_from(time.as_millis()).unwrap_or(i64::MAX), Ordering::SeqCst);
    }

    /// Sets the wall clock forward, or back; no time passes.
    pub fn set_wall_clock_by(&self, jump_ms: i64) {
        self.jumped_ms.fetch_add(jump_ms, Ordering::SeqCst);
    }
}

/// A time of [`Clock::wall_ms`] as RFC 3339 in UTC.
pub(crate) fn rfc3339(wall_ms: i64) -> String {
    jiff::Timestamp::from_millisecond(wall_ms).unwrap_or_default().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_by_hand_moves_only_when_told() {
        let (clock, hand) = Clock::by_hand();
        assert_eq!(clock.now_ms(), 0);
        hand.advance(Duration::from_secs(2));
        assert_eq!(clock.now_ms(), 2000);
    }

    #[test]
    fn times_for_people_are_rfc_3339() {
        assert_eq!(rfc3339(1_767_225_600_000), "2026-01-01T00:00:00Z");
    }
}
