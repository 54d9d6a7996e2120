//! Admission: request rates, and what each caller may have in progress.
//!
//! Depends on no routes or responses; the HTTP layer calls it.

mod shares;

use std::net::IpAddr;
use std::num::NonZeroU32;
use std::time::Duration;

use axum::http::{HeaderName, HeaderValue};
use governor::clock::{Clock as _, DefaultClock};
use governor::middleware::StateInformationMiddleware;
use governor::state::keyed::DefaultKeyedStateStore;
use governor::{Quota, RateLimiter};
use tokio_util::sync::CancellationToken;

use crate::api_keys::ApiKey;

pub(crate) use shares::{CallerClass, Holder, ResponseShares, Shares, UNCOUNTED_BYTES, address_name};

/// Requests per second of one address on a farm without keys.
const REQUESTS_PER_ADDRESS: NonZeroU32 = NonZeroU32::new(1000).expect("it is not 0");
/// Rejections per second of one address whose reason is sent.
const REJECTIONS_PER_ADDRESS: NonZeroU32 = NonZeroU32::new(20).expect("it is not 0");
/// Number of tracked addresses above which idle ones are removed.
const MAX_TRACKED_ADDRESSES: usize = 10_000;
/// Interval at which idle addresses are removed from the limiters.
const PRUNE_INTERVAL: Duration = Duration::from_secs(10);

/// Rate limiter with one cell for each address.
type AddressLimiter = RateLimiter<IpAddr, DefaultKeyedStateStore<IpAddr>, DefaultClock, StateInformationMiddleware>;

/// Error returned when a caller exceeds its rate.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RateLimited {
    /// Permitted requests per second.
    pub(crate) per_second: u32,
    /// Seconds until a request can succeed.
    pub(crate) retry_seconds: u64,
}

/// Remaining requests of a caller.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RateLimitStatus {
    per_second: u32,
    remaining: u32,
}

impl RateLimitStatus {
    /// `RateLimit` headers of a response.
    pub(crate) fn headers(self) -> impl Iterator<Item = (HeaderName, HeaderValue)> {
        let policy = format!("\"requests\";q={};w=1", self.per_second);
        let left = format!("\"requests\";r={};t=1", self.remaining);
        [("ratelimit-policy", policy), ("ratelimit", left)]
            .into_iter()
            .filter_map(|(name, value)| Some((HeaderName::from_static(name), HeaderValue::from_str(&value).ok()?)))
    }
}

/// Request rates of keys and addresses.
#[derive(Debug)]
pub(crate) struct RateLimits {
    address_limiter: AddressLimiter,
    rejection_limiter: AddressLimiter,
}

impl RateLimits {
    /// Limits of a server that starts now.
    pub(crate) fn new() -> Self {
        Self {
            address_limiter: RateLimiter::keyed(Quota::per_second(REQUESTS_PER_ADDRESS)).with_middleware(),
            rejection_limiter: RateLimiter::keyed(Quota::per_second(REJECTIONS_PER_ADDRESS)).with_middleware(),
        }
    }

    /// Counts a request of a key, or of an address on a farm without keys; requests from this machine are
    /// not counted.
    pub(crate) fn admit(
        &self,
        key: Option<&ApiKey>,
        peer: Option<IpAddr>,
        is_local: bool,
    ) -> Result<Option<RateLimitStatus>, RateLimited> {
        let state = match (key, peer) {
            (Some(key), _) => key.limiter().check(),
            (None, Some(peer)) if is_local && !peer.is_loopback() => self.address_limiter.check_key(&peer),
            (None, _) => return Ok(None),
        };
        match state {
            Ok(state) => Ok(Some(RateLimitStatus {
                per_second: state.quota().burst_size().get(),
                remaining: state.remaining_burst_capacity(),
            })),
            Err(until) => Err(RateLimited {
                per_second: until.quota().burst_size().get(),
                retry_seconds: round_up_seconds(until.wait_time_from(DefaultClock::default().now())),
            }),
        }
    }

    /// Counts a rejection; beyond the limit of an address, rejections are sent without their reason.
    pub(crate) fn count_rejection(&self, peer: Option<IpAddr>) -> Result<(), RateLimited> {
        let Some(peer) = peer else { return Ok(()) };
        match self.rejection_limiter.check_key(&peer) {
            Ok(_) => Ok(()),
            Err(until) => Err(RateLimited {
                per_second: REJECTIONS_PER_ADDRESS.get(),
                retry_seconds: round_up_seconds(until.wait_time_from(DefaultClock::default().now())),
            }),
        }
    }

    /// Removes idle addresses until shutdown.
    pub(crate) async fn run(&self, end: CancellationToken) {
        loop {
            tokio::select! {
                () = end.cancelled() => return,
                () = tokio::time::sleep(PRUNE_INTERVAL) => {}
            }
            self.remove_idle_addresses();
        }
    }

    fn remove_idle_addresses(&self) {
        for limiter in [&self.address_limiter, &self.rejection_limiter] {
            if limiter.len() > MAX_TRACKED_ADDRESSES {
                limiter.retain_recent();
                limiter.shrink_to_fit();
            }
        }
    }
}

/// Rounds a wait up to whole seconds, at least one.
fn round_up_seconds(wait: Duration) -> u64 {
    wait.as_secs() + u64::from(wait.subsec_nanos() > 0).max(u64::from(wait.is_zero()))
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;

    use super::*;

    const ELSEWHERE: IpAddr = IpAddr::V4(Ipv4Addr::new(10, 1, 2, 3));
    const HERE: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
    /// Number of requests above every limit, however slowly the test sends them.
    const MANY: u32 = 1_000_000;

    #[test]
    fn requests_are_limited_per_address_but_not_from_this_machine() {
        let limits = RateLimits::new();
        let pace = limits.admit(None, Some(ELSEWHERE), true).expect("the first").expect("it is counted");
        assert_eq!((pace.per_second, pace.remaining), (1000, 999));
        let headers: Vec<_> = pace.headers().map(|(name, value)| (name.to_string(), value)).collect();
        let wanted = [("ratelimit-policy", "\"requests\";q=1000;w=1"), ("ratelimit", "\"requests\";r=999;t=1")];
        assert_eq!(headers, wanted.map(|(name, value)| (name.to_owned(), HeaderValue::from_static(value))));
        let admitted =
            (1..MANY).find_map(|count| limits.admit(None, Some(ELSEWHERE), true).err().map(|refusal| (count, refusal)));
        let (admitted, refusal) = admitted.expect("there is a limit");
        assert!(admitted >= 1000, "{admitted} were admitted");
        assert_eq!((refusal.per_second, refusal.retry_seconds), (1000, 1));
        for (peer, is_local) in [(Some(HERE), true), (Some(ELSEWHERE), false), (None, true)] {
            assert!((0..3000).all(|_| matches!(limits.admit(None, peer, is_local), Ok(None))), "{peer:?} {is_local}");
        }
    }

    #[test]
    fn rejections_are_limited_for_each_address_separately() {
        let limits = RateLimits::new();
        let received =
            (0..MANY).find_map(|count| limits.count_rejection(Some(HERE)).err().map(|refusal| (count, refusal)));
        let (received, refusal) = received.expect("there is a limit");
        assert!(received >= 20, "{received} were sent with a reason");
        assert_eq!((refusal.per_second, refusal.retry_seconds), (20, 1));
        assert!(limits.count_rejection(Some(ELSEWHERE)).is_ok());
        assert!((0..100).all(|_| limits.count_rejection(None).is_ok()));
    }

    #[tokio::test]
    async fn idle_addresses_are_removed_if_there_are_many() {
        let limits = RateLimits::new();
        let count = || [limits.address_limiter.len(), limits.rejection_limiter.len()];
        let address = |number: u32| Some(IpAddr::V4(Ipv4Addr::from_bits((10 << 24) + number)));
        for number in 0..10_000 {
            limits.admit(None, address(number), true).expect("its first request");
        }
        limits.count_rejection(address(0)).expect("its first rejection");
        // An address that sent one request is idle after 1 ms.
        let idle = Duration::from_millis(50);
        tokio::time::sleep(idle).await;
        limits.remove_idle_addresses();
        assert_eq!(count(), [10_000, 1]);
        limits.admit(None, address(10_000), true).expect("its first request");
        tokio::time::sleep(idle).await;
        limits.remove_idle_addresses();
        assert_eq!(count(), [0, 1]);
    }

    #[test]
    fn retry_times_are_rounded_up_to_whole_seconds() {
        for (millis, seconds) in [(0, 1), (1, 1), (999, 1), (1000, 1), (1001, 2), (2500, 3), (4000, 4)] {
            assert_eq!(round_up_seconds(Duration::from_millis(millis)), seconds, "{millis} ms");
        }
    }
}
