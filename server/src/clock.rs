//! Time: leases and back-off use a monotonic clock that starts at 0 with the server, so that a jump of the
//! wall clock expires nothing; users see the wall clock.
//!
//! Nothing else in this crate reads the system's time of day.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// A source of time.
#[derive(Clone, Debug)]
pub struct Clock(ClockSource);

#[derive(Clone, Debug)]
enum ClockSource {
    System(Instant),
    Manual(ManualClock),
}

impl Clock {
    /// The machine's clocks; its monotonic time starts now.
    pub fn system() -> Self {
        Self(ClockSource::System(monotonic_now().into_std()))
    }

    /// Clock that only the returned handle advances, for tests.
    pub fn manual() -> (Self, ManualClock) {
        let hand = ManualClock::default();
        (Self(ClockSource::Manual(hand.clone())), hand)
    }

    /// Milliseconds since the server started; never falls.
    pub(crate) fn now_ms(&self) -> i64 {
        match &self.0 {
            ClockSource::System(start) => i64::try_from(start.elapsed().as_millis()).unwrap_or(i64::MAX),
            ClockSource::Manual(hand) => hand.now_ms.load(Ordering::SeqCst),
        }
    }

    /// Milliseconds since 1970, by the wall clock; for people only.
    pub(crate) fn wall_ms(&self) -> i64 {
        match &self.0 {
            ClockSource::System(_) => time_of_day_ms(),
            ClockSource::Manual(hand) => {
                hand.now_ms.load(Ordering::SeqCst) + hand.wall_offset_ms.load(Ordering::SeqCst)
            }
        }
    }
}

/// The machine's monotonic time, for waits and for measured durations; no decision depends on it.
#[expect(clippy::disallowed_methods, reason = "this is where the machine is asked")]
pub(crate) fn monotonic_now() -> tokio::time::Instant {
    tokio::time::Instant::now()
}

#[expect(clippy::disallowed_methods, reason = "this is where the machine is asked")]
fn time_of_day_ms() -> i64 {
    let age = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(age.as_millis()).unwrap_or(i64::MAX)
}

/// Advances a clock made by [`Clock::manual`].
#[derive(Clone, Debug, Default)]
pub struct ManualClock {
    now_ms: Arc<AtomicI64>,
    /// Offset of the wall clock from that.
    wall_offset_ms: Arc<AtomicI64>,
}

impl ManualClock {
    /// Lets time pass.
    pub fn advance(&self, time: Duration) {
        self.now_ms.fetch_add(i64::try_from(time.as_millis()).unwrap_or(i64::MAX), Ordering::SeqCst);
    }

    /// Sets the wall clock forward, or back; no time passes.
    pub fn shift_wall_clock(&self, jump_ms: i64) {
        self.wall_offset_ms.fetch_add(jump_ms, Ordering::SeqCst);
    }
}

/// A time of [`Clock::wall_ms`] as RFC 3339 in UTC, always with three decimals, so that columns of times line up.
pub(crate) fn rfc3339(wall_ms: i64) -> String {
    format!("{:.3}", jiff::Timestamp::from_millisecond(wall_ms).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_manual_clock_moves_only_when_set() {
        let (clock, hand) = Clock::manual();
        assert_eq!(clock.now_ms(), 0);
        hand.advance(Duration::from_secs(2));
        assert_eq!(clock.now_ms(), 2000);
    }

    #[test]
    fn times_for_people_are_rfc_3339() {
        assert_eq!(rfc3339(1_767_225_600_000), "2026-01-01T00:00:00.000Z");
        assert_eq!(rfc3339(1_767_225_600_120), "2026-01-01T00:00:00.120Z");
    }
}
