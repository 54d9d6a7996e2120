//! Budgets that callers share: requests in progress, bytes of request bodies, bytes of responses in memory.
//!
//! Workers have budgets of their own, so that no user delays a claim or a delivery. Health checks
//! and administrators have places of their own, so that they are served however many requests others have.

use std::net::{IpAddr, Ipv6Addr};
use std::sync::Arc;

use crate::budget::{Budget, Exhausted, Share};

/// Bytes of request bodies of users in memory.
const USER_BODY_BYTES: usize = 176 << 20;
/// Part of one user.
const USER_BODY_PART_BYTES: usize = 64 << 20;
/// Bytes of request bodies of workers in memory.
const WORKER_BODY_BYTES: usize = 64 << 20;
/// Part of one worker key.
const WORKER_BODY_PART_BYTES: usize = 48 << 20;
/// Bytes of responses in memory until they are sent, for users and for workers each.
const RESPONSE_BYTES: usize = 64 << 20;
/// Part of one caller.
const RESPONSE_PART_BYTES: usize = 32 << 20;
/// Size up to which a body is not counted; the number of requests in progress bounds these.
pub(crate) const UNCOUNTED_BYTES: usize = 16 << 10;
/// Requests in progress that workers, and health checks and administrators, have at least.
const MIN_REQUESTS: usize = 8;
/// Significant bits of an IPv6 address: one customer has this network, and any number of addresses in it.
const IPV6_NETWORK_BITS: u32 = 64;

/// Kind of caller, as far as limits are concerned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CallerClass {
    /// A user.
    User,
    /// A worker.
    Worker,
    /// A health check or an administrator.
    Reserved,
}

/// Caller whose part of each budget is limited: a key's name, or an address.
#[derive(Clone, Debug)]
pub(crate) struct Holder {
    /// Its class.
    pub(crate) class: CallerClass,
    /// Name for messages, unique among all holders.
    pub(crate) name: String,
}

impl Holder {
    /// Holder that is known by its address only.
    pub(crate) fn of_address(class: CallerClass, address: Option<IpAddr>) -> Self {
        Self { class, name: address.map_or_else(|| "this server".to_owned(), address_name) }
    }
}

/// Name of the holder that an address belongs to.
pub(crate) fn address_name(address: IpAddr) -> String {
    match address {
        IpAddr::V4(_) => format!("address {address}"),
        IpAddr::V6(address) => {
            let network = address.to_bits() & (u128::MAX << (128 - IPV6_NETWORK_BITS));
            format!("network {}/{IPV6_NETWORK_BITS}", Ipv6Addr::from_bits(network))
        }
    }
}

/// Budgets of a server.
#[derive(Debug)]
pub(crate) struct Shares {
    user_requests: Arc<Budget>,
    worker_requests: Arc<Budget>,
    reserved_requests: Arc<Budget>,
    user_bodies: Arc<Budget>,
    worker_bodies: Arc<Budget>,
    user_responses: Arc<Budget>,
    worker_responses: Arc<Budget>,
}

impl Shares {
    /// Divides this many connections: 5/8 for users, 2/8 for workers, 1/8 for health checks and administrators.
    /// One caller may have `caller_requests` in progress; a worker key, which many workers may share, half of
    /// the workers' connections.
    pub(crate) fn new(connections: usize, caller_requests: usize) -> Self {
        let part = |eighths: usize| connections / 8 * eighths + connections % 8 * eighths / 8;
        let workers = part(2).max(MIN_REQUESTS);
        Self {
            user_requests: Budget::new(part(5).max(1), caller_requests),
            worker_requests: Budget::new(workers, (workers / 2).max(MIN_REQUESTS)),
            reserved_requests: Budget::new(part(1).max(MIN_REQUESTS), caller_requests),
            user_bodies: Budget::new(USER_BODY_BYTES, USER_BODY_PART_BYTES),
            worker_bodies: Budget::new(WORKER_BODY_BYTES, WORKER_BODY_PART_BYTES),
            user_responses: Budget::new(RESPONSE_BYTES, RESPONSE_PART_BYTES),
            worker_responses: Budget::new(RESPONSE_BYTES, RESPONSE_PART_BYTES),
        }
    }

    /// Requests in progress of each class.
    pub(crate) fn requests_in_progress(&self) -> [(&'static str, usize); 3] {
        [("user", &self.user_requests), ("worker", &self.worker_requests), ("reserved", &self.reserved_requests)]
            .map(|(name, requests)| (name, requests.taken()))
    }

    /// Counted bytes of request bodies in memory.
    pub(crate) fn body_bytes(&self) -> usize {
        self.user_bodies.taken() + self.worker_bodies.taken()
    }

    /// Place for a request until its response is sent.
    pub(crate) fn request(&self, holder: &Holder) -> Result<Share, Exhausted> {
        let requests = match holder.class {
            CallerClass::User => &self.user_requests,
            CallerClass::Worker => &self.worker_requests,
            CallerClass::Reserved => &self.reserved_requests,
        };
        requests.take(&holder.name, 1)
    }

    /// Room for a body that is not counted up to [`UNCOUNTED_BYTES`]; it grows with the body.
    pub(crate) fn body(&self, holder: &Holder) -> Share {
        let bodies = match holder.class {
            CallerClass::User | CallerClass::Reserved => &self.user_bodies,
            CallerClass::Worker => &self.worker_bodies,
        };
        bodies.empty(&holder.name)
    }

    /// Room for a response in memory, until it is sent.
    pub(crate) fn response(&self, holder: &Holder, size_bytes: usize) -> Result<Share, Exhausted> {
        let responses = match holder.class {
            CallerClass::User | CallerClass::Reserved => &self.user_responses,
            CallerClass::Worker => &self.worker_responses,
        };
        responses.take(&holder.name, size_bytes)
    }
}

/// Shares that a response has until it is sent: an extension of the response.
#[derive(Clone, Debug)]
pub(crate) struct ResponseShares(
    #[expect(dead_code, reason = "held, and returned when it is dropped")] Arc<(Share, Option<Share>)>,
);

impl ResponseShares {
    /// Shares of a request and of its response's bytes.
    pub(crate) fn new(request: Share, bytes: Option<Share>) -> Self {
        Self(Arc::new((request, bytes)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn holder(class: CallerClass, name: &str) -> Holder {
        Holder { class, name: name.to_owned() }
    }

    #[test]
    fn users_leave_places_for_workers_and_health_checks() {
        for (connections, places) in [(1, [1, 8, 8]), (17, [10, 8, 8]), (16_384, [10_240, 4096, 2048])] {
            let shares = Shares::new(connections, usize::MAX);
            for (class, places) in
                [CallerClass::User, CallerClass::Worker, CallerClass::Reserved].into_iter().zip(places)
            {
                let taken: Vec<_> =
                    (0..).map_while(|number| shares.request(&holder(class, &format!("{number}"))).ok()).collect();
                assert_eq!(taken.len(), places, "{class:?} of {connections}");
            }
        }
    }

    #[test]
    fn a_caller_has_a_limit_of_requests_in_progress() {
        let shares = Shares::new(100, 2);
        let anna = holder(CallerClass::User, "anna");
        let taken = [shares.request(&anna).expect("one"), shares.request(&anna).expect("two")];
        assert_eq!(shares.request(&anna).expect_err("three"), Exhausted::Holder(2));
        shares.request(&holder(CallerClass::User, "bert")).expect("another caller");
        drop(taken);
        shares.request(&anna).expect("none is in progress");
    }

    #[test]
    fn unfinished_bodies_are_bounded_together() {
        const { assert!(USER_BODY_BYTES + WORKER_BODY_BYTES <= 256 << 20) }
        let shares = Shares::new(100, 100);
        let mut bodies: Vec<_> =
            ["anna", "bert", "carl"].map(|name| shares.body(&holder(CallerClass::User, name))).into();
        assert_eq!(bodies[0].grow(65 << 20), Err(Exhausted::Holder(64 << 20)));
        assert_eq!(bodies[0].grow(64 << 20), Ok(()));
        assert_eq!(bodies[1].grow(64 << 20), Ok(()));
        assert_eq!(bodies[2].grow(64 << 20), Err(Exhausted::Total(176 << 20)));
        let mut delivery = shares.body(&holder(CallerClass::Worker, "pool"));
        assert_eq!(delivery.grow(48 << 20), Ok(()), "users never take the workers' part");
    }

    #[test]
    fn addresses_of_one_ipv6_network_are_one_holder() {
        let name = |text: &str| address_name(text.parse().expect("an address"));
        assert_eq!(name("10.1.2.3"), "address 10.1.2.3");
        assert_eq!(name("2001:db8:1:2::5"), "network 2001:db8:1:2::/64");
        assert_eq!(name("2001:db8:1:2:ffff::"), name("2001:db8:1:2::5"));
        assert_ne!(name("2001:db8:1:3::5"), name("2001:db8:1:2::5"));
    }
}
