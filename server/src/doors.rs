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

use crate::clock::Clock;
use crate::deeds::Audit;
use crate::keys::{Key, Keys};
use crate::store::{Store, StoreError};

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
