//! How long this server has reached its database without a pause. After a pause it judges no one: workers and other
//! servers could not renew what they hold either.

use std::sync::Mutex;
use std::time::Duration;

use tokio::time::Instant;

use crate::clock::monotonic_now;
use crate::queue::servers::SERVER_GONE_MS;

/// Renewals that are further apart had a pause in between.
const MAX_GAP: Duration = Duration::from_secs(3);
/// After a pause, others have this time to renew what they hold.
const GRACE: Duration = Duration::from_millis(SERVER_GONE_MS.unsigned_abs() + 2_000);

/// Contact with a database that can be away; with a file it is always steady.
#[derive(Debug, Default)]
pub(in crate::queue) struct Contact(Mutex<Option<Times>>);

#[derive(Clone, Copy, Debug)]
struct Times {
    /// End of the last pause.
    since: Instant,
    /// Last renewal.
    renewed: Instant,
}

impl Contact {
    /// Records that the database was reached.
    pub(in crate::queue) fn renew(&self) {
        self.renew_at(monotonic_now());
    }

    fn renew_at(&self, now: Instant) {
        let mut times = self.0.lock().expect("no holder panics");
        let since = times.filter(|times| now - times.renewed <= MAX_GAP).map_or(now, |times| times.since);
        *times = Some(Times { since, renewed: now });
    }

    /// Whether the database was reached without a pause for as long as others need to renew what they hold.
    pub(in crate::queue) fn is_steady(&self) -> bool {
        self.is_steady_at(monotonic_now())
    }

    fn is_steady_at(&self, now: Instant) -> bool {
        let times = *self.0.lock().expect("no holder panics");
        times.is_none_or(|times| now - times.renewed <= MAX_GAP && times.renewed - times.since >= GRACE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contact_is_steady_some_time_after_a_pause() {
        let (contact, start) = (Contact::default(), monotonic_now());
        let at = |seconds: u64| start + Duration::from_secs(seconds);
        assert!(contact.is_steady_at(start), "a file needs no renewal");
        for seconds in 0..=8 {
            contact.renew_at(at(seconds));
            assert_eq!(contact.is_steady_at(at(seconds)), seconds == 8);
        }
        assert!(contact.is_steady_at(at(11)) && !contact.is_steady_at(at(12)));
        for seconds in 20..=28 {
            contact.renew_at(at(seconds));
            assert_eq!(contact.is_steady_at(at(seconds)), seconds == 28);
        }
    }
}
