//! Admission: API keys, request rates, the audit log.
//!
//! It knows nothing of routes and responses; the HTTP layer calls it.

use std::net::IpAddr;
use std::num::NonZeroU32;
use std::sync::Arc;
use std::time::Duration;

use axum::http::{HeaderName, HeaderValue};
use governor::clock::{Clock as _, DefaultClock};
use governor::middleware::StateInformationMiddleware;
use governor::state::keyed::DefaultKeyedStateStore;
use governor::{Quota, RateLimiter};
use tokio_util::sync::CancellationToken;

use crate::api_keys::{Key, Keys};
use crate::audit_log::Audit;
use crate::clock::Clock;
use crate::database::{Store, StoreError};

/// Requests per second of one address on a farm without keys.
const ADDRESS_PER_SECOND: NonZeroU32 = NonZeroU32::new(1000).expect("it is not 0");
/// Rejections per second of one address whose reason is sent.
const REFUSALS_PER_SECOND: NonZeroU32 = NonZeroU32::new(20).expect("it is not 0");
/// Addresses that are remembered before those that are quiet are forgotten.
const ADDRESSES: usize = 10_000;
/// Interval at which idle addresses are removed from the limiters.
const FORGET: Duration = Duration::from_secs(10);

/// Rate limiter with one cell for each address.
type Limiter = RateLimiter<IpAddr, DefaultKeyedStateStore<IpAddr>, DefaultClock, StateInformationMiddleware>;

/// Too many requests.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Refusal {
    /// Permitted requests per second.
    pub(crate) per_second: u32,
    /// Seconds until the next attempt can succeed.
    pub(crate) retry_seconds: u64,
}

/// Remaining rate of a caller.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pace {
    per_second: u32,
    remaining: u32,
}

impl Pace {
    /// The `RateLimit` headers of a response.
    pub(crate) fn headers(self) -> impl Iterator<Item = (HeaderName, HeaderValue)> {
        let policy = format!("\"requests\";q={};w=1", self.per_second);
        let left = format!("\"requests\";r={};t=1", self.remaining);
        [("ratelimit-policy", policy), ("ratelimit", left)]
            .into_iter()
            .filter_map(|(name, value)| Some((HeaderName::from_static(name), HeaderValue::from_str(&value).ok()?)))
    }
}

/// Keys, rates, the audit log.
#[derive(Debug)]
pub(crate) struct Doors {
    /// API keys.
    pub(crate) keys: Keys,
    /// Audit log.
    pub(crate) audit: Audit,
    addresses: Limiter,
    refusals: Limiter,
}

impl Doors {
    /// Opens the keys and the audit log of a farm.
    pub(crate) async fn open(store: Arc<Store>, clock: Clock) -> Result<Self, StoreError> {
        Ok(Self {
            keys: Keys::open(Arc::clone(&store), clock.clone()).await?,
            audit: Audit::new(store, clock),
            addresses: RateLimiter::keyed(Quota::per_second(ADDRESS_PER_SECOND)).with_middleware(),
            refusals: RateLimiter::keyed(Quota::per_second(REFUSALS_PER_SECOND)).with_middleware(),
        })
    }

    /// Counts a request of a key, or of an address on a farm without keys; requests from this machine are
    /// not counted.
    pub(crate) fn admit(
        &self,
        key: Option<&Key>,
        peer: Option<IpAddr>,
        is_local: bool,
    ) -> Result<Option<Pace>, Refusal> {
        let state = match (key, peer) {
            (Some(key), _) => key.limiter().check(),
            (None, Some(peer)) if is_local && !peer.is_loopback() => self.addresses.check_key(&peer),
            (None, _) => return Ok(None),
        };
        match state {
            Ok(state) => Ok(Some(Pace {
                per_second: state.quota().burst_size().get(),
                remaining: state.remaining_burst_capacity(),
            })),
            Err(until) => Err(Refusal {
                per_second: until.quota().burst_size().get(),
                retry_seconds: whole_seconds(until.wait_time_from(DefaultClock::default().now())),
            }),
        }
    }

    /// Counts a rejection; beyond the limit of an address, rejections are sent without their reason.
    pub(crate) fn count_refusal(&self, peer: Option<IpAddr>) -> Result<(), Refusal> {
        let Some(peer) = peer else { return Ok(()) };
        match self.refusals.check_key(&peer) {
            Ok(_) => Ok(()),
            Err(until) => Err(Refusal {
                per_second: REFUSALS_PER_SECOND.get(),
                retry_seconds: whole_seconds(until.wait_time_from(DefaultClock::default().now())),
            }),
        }
    }

    /// Reloads keys, writes the audit log and removes idle addresses until shutdown.
    pub(crate) async fn run(&self, end: CancellationToken) {
        tokio::join!(self.keys.run(end.clone()), self.audit.run(end.clone()), self.forget(end));
    }

    async fn forget(&self, end: CancellationToken) {
        loop {
            tokio::select! {
                () = end.cancelled() => return,
                () = tokio::time::sleep(FORGET) => {}
            }
            for limiter in [&self.addresses, &self.refusals] {
                if limiter.len() > ADDRESSES {
                    limiter.retain_recent();
                    limiter.shrink_to_fit();
                }
            }
        }
    }
}

/// A time to wait, as whole seconds, at least one.
fn whole_seconds(wait: Duration) -> u64 {
    wait.as_secs() + u64::from(wait.subsec_nanos() > 0).max(u64::from(wait.is_zero()))
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;

    use super::*;

    const ELSEWHERE: IpAddr = IpAddr::V4(Ipv4Addr::new(10, 1, 2, 3));
    const HERE: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
    /// More than any of the limits, however slowly they are counted.
    const MANY: u32 = 1_000_000;

    async fn doors() -> (Doors, tempfile::TempDir) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let store = Arc::new(Store::open(folder.path()).await.expect("opens"));
        (Doors::open(store, Clock::by_hand().0).await.expect("opens"), folder)
    }

    #[tokio::test]
    async fn an_address_without_a_key_has_a_rate_and_this_machine_has_none() {
        let (doors, _folder) = doors().await;
        let pace = doors.admit(None, Some(ELSEWHERE), true).expect("the first").expect("it is counted");
        assert_eq!((pace.per_second, pace.remaining), (1000, 999));
        let headers: Vec<_> = pace.headers().map(|(name, value)| (name.to_string(), value)).collect();
        let wanted = [("ratelimit-policy", "\"requests\";q=1000;w=1"), ("ratelimit", "\"requests\";r=999;t=1")];
        assert_eq!(headers, wanted.map(|(name, value)| (name.to_owned(), HeaderValue::from_static(value))));
        let admitted =
            (1..MANY).find_map(|count| doors.admit(None, Some(ELSEWHERE), true).err().map(|refusal| (count, refusal)));
        let (admitted, refusal) = admitted.expect("there is a limit");
        assert!(admitted >= 1000, "{admitted} were admitted");
        assert_eq!((refusal.per_second, refusal.retry_seconds), (1000, 1));
        for (peer, is_local) in [(Some(HERE), true), (Some(ELSEWHERE), false), (None, true)] {
            assert!((0..3000).all(|_| matches!(doors.admit(None, peer, is_local), Ok(None))), "{peer:?} {is_local}");
        }
    }

    #[tokio::test]
    async fn refusals_of_an_address_are_counted_and_others_are_not_held_for_them() {
        let (doors, _folder) = doors().await;
        let told = (0..MANY).find_map(|count| doors.count_refusal(Some(HERE)).err().map(|refusal| (count, refusal)));
        let (told, refusal) = told.expect("there is a limit");
        assert!(told >= 20, "{told} were told why");
        assert_eq!((refusal.per_second, refusal.retry_seconds), (20, 1));
        assert!(doors.count_refusal(Some(ELSEWHERE)).is_ok());
        assert!((0..100).all(|_| doors.count_refusal(None).is_ok()));
    }

    #[test]
    fn a_wait_is_told_in_whole_seconds_that_are_enough() {
        for (millis, seconds) in [(0, 1), (1, 1), (999, 1), (1000, 1), (1001, 2), (2500, 3), (4000, 4)] {
            assert_eq!(whole_seconds(Duration::from_millis(millis)), seconds, "{millis} ms");
        }
    }
}
