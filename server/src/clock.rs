//! Clocks: leases and back-off use a monotonic clock that starts at 0 with the server, so that a jump of the
//! wall clock expires no lease; users see the wall clock. Servers that share a database share its time ([`FarmTime`]).
//!
//! Nothing else in this crate reads the system's time of day.

mod farm_time;

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

pub(crate) use farm_time::{FarmTime, TimeReading};

/// Source of time.
#[derive(Clone, Debug)]
pub struct Clock(ClockSource);

#[derive(Clone, Debug)]
enum ClockSource {
    System(Instant),
    Farm(Arc<FarmTime>),
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

    /// Like [`Clock::manual`], for several servers.
    #[cfg(test)]
    pub(crate) fn manual_lasting() -> (Self, ManualClock) {
        let hand = ManualClock { is_lasting: true, ..ManualClock::default() };
        (Self(ClockSource::Manual(hand.clone())), hand)
    }

    /// The same clock, or the time that the servers of a database share, unless a test sets the time.
    pub(crate) fn or_shared(self, shared: Option<Arc<FarmTime>>) -> Self {
        match (&self.0, shared) {
            (ClockSource::System(_), Some(time)) => Self(ClockSource::Farm(time)),
            (_, _) => self,
        }
    }

    /// Whether it goes on while the server does not run, so that its times hold after a restart.
    pub(crate) fn is_lasting(&self) -> bool {
        match &self.0 {
            ClockSource::System(_) => false,
            ClockSource::Farm(_) => true,
            ClockSource::Manual(hand) => hand.is_lasting,
        }
    }

    /// Milliseconds since the server, or the farm, started; never decreases.
    pub(crate) fn now_ms(&self) -> i64 {
        match &self.0 {
            ClockSource::System(start) => i64::try_from(start.elapsed().as_millis()).unwrap_or(i64::MAX),
            ClockSource::Farm(time) => time.now_ms(),
            ClockSource::Manual(hand) => hand.now_ms.load(Ordering::SeqCst),
        }
    }

    /// Milliseconds since 1970, by the wall clock; for display only.
    pub(crate) fn wall_ms(&self) -> i64 {
        match &self.0 {
            ClockSource::System(_) => time_of_day_ms(),
            ClockSource::Farm(time) => time.wall_ms(),
            ClockSource::Manual(hand) => {
                hand.now_ms.load(Ordering::SeqCst) + hand.wall_offset_ms.load(Ordering::SeqCst)
            }
        }
    }
}

/// Monotonic time of the machine, for waits and measured durations; no decision depends on it.
#[expect(clippy::disallowed_methods, reason = "this module is the only reader of the machine's clocks")]
pub(crate) fn monotonic_now() -> tokio::time::Instant {
    tokio::time::Instant::now()
}

#[expect(clippy::disallowed_methods, reason = "this module is the only reader of the machine's clocks")]
fn time_of_day_ms() -> i64 {
    let age = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(age.as_millis()).unwrap_or(i64::MAX)
}

/// Advances a clock made by [`Clock::manual`].
#[derive(Clone, Debug, Default)]
pub struct ManualClock {
    now_ms: Arc<AtomicI64>,
    /// Offset of the wall clock from the monotonic clock.
    wall_offset_ms: Arc<AtomicI64>,
    is_lasting: bool,
}

impl ManualClock {
    /// Advances the monotonic clock.
    pub fn advance(&self, time: Duration) {
        self.now_ms.fetch_add(i64::try_from(time.as_millis()).unwrap_or(i64::MAX), Ordering::SeqCst);
    }

    /// Moves the wall clock forward or back; the monotonic clock does not change.
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
    fn a_manual_clock_changes_only_when_set() {
        let (clock, hand) = Clock::manual();
        assert_eq!(clock.now_ms(), 0);
        hand.advance(Duration::from_secs(2));
        assert_eq!(clock.now_ms(), 2000);
    }

    #[test]
    fn displayed_times_are_rfc_3339() {
        assert_eq!(rfc3339(1_767_225_600_000), "2026-01-01T00:00:00.000Z");
        assert_eq!(rfc3339(1_767_225_600_120), "2026-01-01T00:00:00.120Z");
    }
}
