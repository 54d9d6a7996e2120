//! The time that the servers of one database share: that of the database's clock, read at the beginning of each
//! transaction that writes, and continued by the machine's clock until the next one.
//!
//! A jump of the database's clock (a step of its wall clock, another machine after a failover) would expire all leases, or
//! none for long. The server that notices one first adds the opposite to an offset in the database, which all servers add.

use std::sync::Mutex;

use rustix::time::{ClockId, clock_gettime};

/// Difference between the database's clock and this machine's, since the last reading, that counts as a jump.
const JUMP_MS: i64 = 5_000;

/// Reading of a transaction at its beginning, while it holds the farm's lock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TimeReading {
    /// Milliseconds since 1970 by the database's clock.
    pub(crate) clock_ms: i64,
    /// Offset of the farm's time from it.
    pub(crate) offset_ms: i64,
}

/// The farm's time.
#[derive(Debug)]
pub(crate) struct FarmTime(Mutex<Last>);

/// The last reading.
#[derive(Clone, Copy, Debug)]
struct Last {
    reading: TimeReading,
    /// The farm's time at the reading.
    farm_ms: i64,
    /// This machine's time at the reading.
    machine_ms: i64,
    /// The latest time that was returned.
    returned_ms: i64,
}

impl FarmTime {
    /// Time that begins with a reading.
    pub(crate) fn new(reading: TimeReading) -> Self {
        Self::at(reading, machine_ms())
    }

    fn at(reading: TimeReading, machine_ms: i64) -> Self {
        let farm_ms = reading.clock_ms + reading.offset_ms;
        Self(Mutex::new(Last { reading, farm_ms, machine_ms, returned_ms: farm_ms }))
    }

    /// Takes a reading. Returns the offset that the transaction must store, if the database's clock has jumped.
    pub(crate) fn take(&self, reading: TimeReading) -> Option<i64> {
        self.take_at(reading, machine_ms())
    }

    fn take_at(&self, reading: TimeReading, machine_ms: i64) -> Option<i64> {
        let mut last = self.0.lock().expect("no holder panics");
        let expected_ms = last.farm_ms + (machine_ms - last.machine_ms);
        let mut farm_ms = reading.clock_ms + reading.offset_ms;
        let jump_ms = farm_ms - expected_ms;
        // With another offset, another server has noticed it.
        let offset_ms = (reading.offset_ms == last.reading.offset_ms && jump_ms.abs() > JUMP_MS).then(|| {
            farm_ms = expected_ms;
            reading.offset_ms - jump_ms
        });
        *last = Last { reading, farm_ms, machine_ms, returned_ms: last.returned_ms };
        if offset_ms.is_some() {
            tracing::warn!(
                jump_seconds = jump_ms / 1000,
                "the clock of the database's server has jumped; leases do not notice it: keep it in step by NTP"
            );
        }
        offset_ms
    }

    /// Milliseconds since 1970 by the farm's time; never decreases, unless a jump of the clock was noticed elsewhere.
    pub(crate) fn now_ms(&self) -> i64 {
        self.now_at(machine_ms())
    }

    fn now_at(&self, machine_ms: i64) -> i64 {
        let mut last = self.0.lock().expect("no holder panics");
        let now_ms = last.farm_ms + (machine_ms - last.machine_ms);
        // Readings differ by rounding.
        last.returned_ms = if now_ms < last.returned_ms - JUMP_MS { now_ms } else { last.returned_ms.max(now_ms) };
        last.returned_ms
    }

    /// Milliseconds since 1970 by the database's clock; for display only.
    pub(crate) fn wall_ms(&self) -> i64 {
        let last = *self.0.lock().expect("no holder panics");
        last.reading.clock_ms + (machine_ms() - last.machine_ms)
    }
}

/// Milliseconds by a clock of this machine that is never set, and that goes on while the machine sleeps.
fn machine_ms() -> i64 {
    let time = clock_gettime(ClockId::Boottime);
    time.tv_sec * 1000 + time.tv_nsec / 1_000_000
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reading(clock_ms: i64, offset_ms: i64) -> TimeReading {
        TimeReading { clock_ms, offset_ms }
    }

    #[test]
    fn time_goes_on_between_readings_and_follows_the_database() {
        let time = FarmTime::at(reading(1_000_000, 0), 50);
        assert_eq!(time.now_at(150), 1_000_100);
        assert_eq!(time.take_at(reading(1_000_190, 0), 250), None);
        // The database's clock is ten milliseconds slower than the machine's: time stands until it is reached.
        assert_eq!(time.now_at(250), 1_000_190);
        assert_eq!(time.now_at(260), 1_000_200);
        assert_eq!(time.take_at(reading(1_000_195, 0), 260), None);
        assert_eq!(time.now_at(260), 1_000_200);
        assert_eq!(time.now_at(270), 1_000_205);
    }

    #[test]
    fn a_jump_is_noticed_by_one_server_and_accepted_by_the_others() {
        for jump_ms in [3_600_000, -3_600_000] {
            let (first, second) = (FarmTime::at(reading(1_000_000, 0), 0), FarmTime::at(reading(1_000_000, 0), 777));
            let jumped = 1_000_000 + jump_ms;
            assert_eq!(first.take_at(reading(jumped + 2000, 0), 2000), Some(-jump_ms));
            assert_eq!(first.now_at(2000), 1_002_000);
            // Its transaction was rolled back.
            assert_eq!(first.take_at(reading(jumped + 3000, 0), 3000), Some(-jump_ms));
            assert_eq!(first.take_at(reading(jumped + 4000, -jump_ms), 4000), None);
            assert_eq!(first.now_at(4000), 1_004_000);
            assert_eq!(second.take_at(reading(jumped + 5000, -jump_ms), 5777), None);
            assert_eq!(second.now_at(5777), 1_005_000);
        }
    }

    #[test]
    fn a_long_pause_is_no_jump() {
        let time = FarmTime::at(reading(1_000_000, 7), 0);
        assert_eq!(time.take_at(reading(87_400_000, 7), 86_400_000), None);
        assert_eq!(time.now_at(86_400_000), 87_400_007);
    }
}
