//! Permitted webhook addresses: public addresses over TLS, and ranges that the operator allows.
//!
//! Addresses are checked at submission and again for each connection, after the name has been resolved, so that
//! an attacker gains nothing by changing the address of a name.

use std::net::{IpAddr, SocketAddr};
use std::str::FromStr;
use std::sync::Arc;

use ipnet::{IpNet, Ipv4Net, Ipv6Net};
use reqwest::Url;
use reqwest::dns::{Addrs, Name, Resolve, Resolving};

/// Ports below this one belong to other services, except the web's.
const FIRST_FREE_PORT: u16 = 1024;

/// Ranges outside the public internet, from IANA's special-purpose registry for IPv4, and multicast.
const NON_PUBLIC_V4: [&str; 17] = [
    "0.0.0.0/8",
    "10.0.0.0/8",
    "100.64.0.0/10",
    "127.0.0.0/8",
    "169.254.0.0/16",
    "172.16.0.0/12",
    "192.0.0.0/24",
    "192.0.2.0/24",
    "192.31.196.0/24",
    "192.52.193.0/24",
    "192.88.99.0/24",
    "192.168.0.0/16",
    "192.175.48.0/24",
    "198.18.0.0/15",
    "198.51.100.0/24",
    "203.0.113.0/24",
    "224.0.0.0/3",
];
/// The range of IPv6 assigned to the public internet.
const GLOBAL_UNICAST_V6: &str = "2000::/3";
/// Ranges within it that are not public: protocols (Teredo, ORCHID, benchmarks), documentation, and embedded
/// IPv4.
const NON_PUBLIC_V6: [&str; 5] = ["2001::/23", "2001:db8::/32", "2002::/16", "2620:4f:8000::/48", "3fff::/20"];

/// Range of addresses, as an operator writes it: `10.0.0.0/8`, or one address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AddressRange(IpNet);

impl FromStr for AddressRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let one = || text.parse::<IpAddr>().map(IpNet::from);
        text.parse::<IpNet>()
            .or_else(|_| one())
            .map(|range| Self(range.trunc()))
            .map_err(|_| format!("{text:?} is not an address range: write it as 10.0.0.0/8 or fd00::/8"))
    }
}

/// Reason why a webhook may not reach an address.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum AddressRejected {
    /// It is not an http or https URL.
    #[error("invalid webhook address ({0}): write it as https://HOST/PATH")]
    Unreadable(String),
    /// The connection would be unencrypted.
    #[error(
        "webhook addresses with {0}:// are not allowed: use https; http works only to ranges of the server's --allow-webhook-to"
    )]
    Scheme(String),
    /// The address has a user name or password.
    #[error("the webhook's address has a user name or password: put a token into its path instead")]
    Credentials,
    /// The port belongs to another service.
    #[error("webhooks cannot use port {0}: use 443, 80, or a port from {FIRST_FREE_PORT}")]
    Port(u16),
    /// The address is not on the public internet.
    #[error(
        "webhooks cannot use {0}, which is not on the public internet: ask the operator to allow it with --allow-webhook-to"
    )]
    NotPublic(String),
}

/// Decides which addresses are permitted.
#[derive(Clone, Debug, Default)]
pub(crate) struct AddressPolicy {
    allowed: Arc<[AddressRange]>,
}

impl AddressPolicy {
    /// Guard that also permits these ranges.
    pub(crate) fn new(allowed: &[AddressRange]) -> Self {
        Self { allowed: allowed.into() }
    }

    /// Parses a webhook's address, and rejects one that is invalid whatever its name resolves to.
    pub(crate) fn check(&self, text: &str) -> Result<Url, AddressRejected> {
        let mut url = Url::parse(text).map_err(|error| AddressRejected::Unreadable(error.to_string()))?;
        let is_http = url.scheme() == "http";
        if !is_http && url.scheme() != "https" {
            return Err(AddressRejected::Scheme(url.scheme().to_owned()));
        }
        if !url.username().is_empty() || url.password().is_some() {
            return Err(AddressRejected::Credentials);
        }
        url.set_fragment(None);
        let host = url.host_str().unwrap_or_default().to_owned();
        match ip_host(&host) {
            Some(address) if !self.may_connect(address, is_http) => return Err(AddressRejected::NotPublic(host)),
            Some(address) if self.is_allowed(address) => return Ok(url),
            None if is_http && self.allowed.is_empty() => return Err(AddressRejected::Scheme("http".to_owned())),
            None if is_local(&host) && self.allowed.is_empty() => return Err(AddressRejected::NotPublic(host)),
            Some(_) | None => {}
        }
        match url.port_or_known_default() {
            Some(port) if port >= FIRST_FREE_PORT || port == 443 || port == 80 => Ok(url),
            port => Err(AddressRejected::Port(port.unwrap_or_default())),
        }
    }

    /// Whether a connection to an address is permitted; plain HTTP only within the operator's ranges.
    pub(crate) fn may_connect(&self, address: IpAddr, is_http: bool) -> bool {
        self.is_allowed(address) || (!is_http && is_public(address))
    }

    fn is_allowed(&self, address: IpAddr) -> bool {
        self.allowed.iter().any(|range| range.0.contains(&address))
    }

    /// Resolves names for connections over TLS, or over plain HTTP, and returns only permitted addresses.
    pub(crate) fn resolver(&self, is_http: bool) -> Arc<dyn Resolve> {
        Arc::new(GuardedResolver { guard: self.clone(), is_http })
    }
}

/// IP address of a URL's host, if the host is not a name.
fn ip_host(host: &str) -> Option<IpAddr> {
    host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(host).parse().ok()
}

/// Whether a name can only mean this machine or its network.
fn is_local(host: &str) -> bool {
    let host = host.trim_end_matches('.').to_ascii_lowercase();
    !host.contains('.') || [".localhost", ".local", ".internal", ".home.arpa"].iter().any(|end| host.ends_with(end))
}

/// Whether an address is on the public internet.
fn is_public(address: IpAddr) -> bool {
    match address {
        IpAddr::V4(address) => !NON_PUBLIC_V4.iter().any(|net| v4(net).contains(&address)),
        IpAddr::V6(address) => {
            v6(GLOBAL_UNICAST_V6).contains(&address) && !NON_PUBLIC_V6.iter().any(|net| v6(net).contains(&address))
        }
    }
}

fn v4(net: &str) -> Ipv4Net {
    net.parse().expect("the table above has valid networks")
}

fn v6(net: &str) -> Ipv6Net {
    net.parse().expect("the table above has valid networks")
}

struct GuardedResolver {
    guard: AddressPolicy,
    is_http: bool,
}

impl Resolve for GuardedResolver {
    fn resolve(&self, name: Name) -> Resolving {
        let (guard, is_http) = (self.guard.clone(), self.is_http);
        Box::pin(async move {
            let found = tokio::net::lookup_host((name.as_str(), 0)).await?;
            let open: Vec<SocketAddr> = found.filter(|address| guard.may_connect(address.ip(), is_http)).collect();
            if open.is_empty() {
                return Err(AddressRejected::NotPublic(name.as_str().to_owned()).into());
            }
            Ok(Box::new(open.into_iter()) as Addrs)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Non-public addresses that must be rejected, in all their spellings.
    const CLOSED: [&str; 62] = [
        "https://127.0.0.1/",
        "https://127.1/",
        "https://127.0.0.1:8443/",
        "https://0x7f.1/",
        "https://0x7f000001/",
        "https://2130706433/",
        "https://017700000001/",
        "https://127.0.0.1./",
        "https://%31%32%37.0.0.1/",
        "https://①②⑦.0.0.1/",
        "https://127。0。0。1/",
        "https://0/",
        "https://0.0.0.0/",
        "https://0.1.2.3/",
        "https://10.0.0.1/",
        "https://10.255.255.255/",
        "https://012.0.0.1/",
        "https://100.64.0.1/",
        "https://100.127.255.255/",
        "https://169.254.169.254/",
        "https://0xa9fea9fe/",
        "https://2852039166/",
        "https://172.16.0.1/",
        "https://172.31.255.255/",
        "https://192.0.0.1/",
        "https://192.0.0.170/",
        "https://192.0.2.1/",
        "https://192.88.99.1/",
        "https://192.168.0.1/",
        "https://192.168.255.255/",
        "https://198.18.0.1/",
        "https://198.19.255.255/",
        "https://198.51.100.1/",
        "https://203.0.113.1/",
        "https://224.0.0.1/",
        "https://239.255.255.255/",
        "https://240.0.0.1/",
        "https://255.255.255.255/",
        "https://[::]/",
        "https://[::1]/",
        "https://[0:0:0:0:0:0:0:1]/",
        "https://[::ffff:127.0.0.1]/",
        "https://[::ffff:10.0.0.1]/",
        "https://[::ffff:8.8.8.8]/",
        "https://[::127.0.0.1]/",
        "https://[64:ff9b::127.0.0.1]/",
        "https://[64:ff9b::8.8.8.8]/",
        "https://[64:ff9b:1::1]/",
        "https://[100::1]/",
        "https://[2001::1]/",
        "https://[2001:2::1]/",
        "https://[2001:10::1]/",
        "https://[2001:db8::1]/",
        "https://[2002:7f00:1::]/",
        "https://[3fff::1]/",
        "https://[5f00::1]/",
        "https://[fc00::1]/",
        "https://[fd00:ec2::254]/",
        "https://[fe80::1]/",
        "https://[fec0::1]/",
        "https://[ff02::1]/",
        "https://localhost/",
    ];
    /// Other rejected addresses, with their reasons.
    const WRONG: [&str; 16] = [
        "",
        "farm.example",
        "//farm.example/",
        "https://",
        "https:///x",
        "http://farm.example/",
        "http://8.8.8.8/",
        "ftp://farm.example/",
        "file:///etc/passwd",
        "gopher://farm.example/",
        "javascript:alert(1)",
        "https://user:secret@farm.example/",
        "https://user@farm.example/",
        "https://farm.example:22/",
        "https://farm.example:25/",
        "https://localhost.:443/",
    ];
    const OPEN: [&str; 8] = [
        "https://farm.example/hook?token=1",
        "https://farm.example:8443/",
        "https://8.8.8.8/",
        "https://1.1.1.1:443/",
        "https://[2606:4700:4700::1111]/",
        "https://172.32.0.1/",
        "https://100.128.0.1/",
        "https://farm.example:80/",
    ];

    #[test]
    fn non_public_addresses_are_rejected_in_every_spelling() {
        let guard = AddressPolicy::default();
        for closed in CLOSED {
            assert!(
                matches!(guard.check(closed), Err(AddressRejected::NotPublic(_))),
                "{closed}: {:?}",
                guard.check(closed)
            );
        }
        for wrong in WRONG {
            assert!(guard.check(wrong).is_err(), "{wrong}");
        }
        for open in OPEN {
            assert!(guard.check(open).is_ok(), "{open}: {:?}", guard.check(open));
        }
    }

    #[test]
    fn only_ranges_allowed_by_the_operator_are_added() {
        let guard = AddressPolicy::new(&["10.1.0.0/16".parse().expect("a range"), "::1".parse().expect("an address")]);
        for open in ["https://10.1.2.3/", "http://10.1.2.3:81/", "http://[::1]:9/", "http://render.internal/hook"] {
            assert!(guard.check(open).is_ok(), "{open}: {:?}", guard.check(open));
        }
        for closed in ["https://10.2.0.1/", "https://127.0.0.1/", "http://8.8.8.8/", "https://[::ffff:10.1.2.3]/"] {
            assert!(guard.check(closed).is_err(), "{closed}");
        }
        for wrong in ["", "10.0.0.0/33", "ten"] {
            assert!(wrong.parse::<AddressRange>().is_err(), "{wrong}");
        }
    }

    #[tokio::test]
    async fn names_that_resolve_to_this_machine_are_rejected() {
        let name = || "localhost".parse::<Name>().expect("a name");
        assert!(AddressPolicy::default().resolver(false).resolve(name()).await.is_err());
        let guard = AddressPolicy::new(&["127.0.0.0/8".parse().expect("a range"), "::1".parse().expect("an address")]);
        assert!(guard.resolver(true).resolve(name()).await.is_ok());
    }
}
