//! Host and origin check: accepts requests that name this server and do not come from another site's page, nor
//! from a page that may only show.
//!
//! Authentication is in `auth`.

use std::net::IpAddr;
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use crate::config::Config;
use crate::http::error::ApiError;
use crate::http::page::read_only;

/// Rejects requests whose `Host` is not this server (DNS rebinding), and changes requested by pages of other
/// sites.
pub(in crate::http) async fn host_and_origin(
    State(config): State<Arc<Config>>,
    request: Request,
    next: Next,
) -> Response {
    let checked = check_host_and_origin(&config.allowed_hosts, &request);
    match checked.and_then(|()| read_only::check(&config, &request)) {
        Ok(()) => next.run(request).await,
        Err(error) => error.into_response(),
    }
}

fn check_host_and_origin(hosts: &[String], request: &Request) -> Result<(), ApiError> {
    if request.headers().get_all(header::HOST).iter().count() > 1 {
        // RFC 9112, section 3.2: a request with several Host headers is ambiguous.
        return Err(ApiError::WrongRequest("it has more than one Host header"));
    }
    if request.headers().get_all(header::ORIGIN).iter().count() > 1 {
        return Err(ApiError::WrongRequest("it has more than one Origin header"));
    }
    if !is_utf8_path(request.uri().path()) {
        return Err(ApiError::WrongRequest("its path is not UTF-8"));
    }
    let named = match request.uri().authority() {
        Some(authority) => authority.as_str(),
        None => text(request.headers(), &header::HOST),
    };
    if !is_known_host(hosts, named) {
        return Err(ApiError::ForeignHost(named.to_owned()));
    }
    if [Method::GET, Method::HEAD, Method::OPTIONS].contains(request.method()) {
        return Ok(());
    }
    let origin = text(request.headers(), &header::ORIGIN);
    if !origin.is_empty() && origin.strip_prefix("http://").or(origin.strip_prefix("https://")) != Some(named) {
        return Err(ApiError::ForeignOrigin(origin.to_owned()));
    }
    Ok(())
}

/// Whether a path is UTF-8 after percent-decoding.
fn is_utf8_path(path: &str) -> bool {
    let mut parts = path.split('%');
    let mut bytes = parts.next().unwrap_or_default().as_bytes().to_vec();
    for part in parts {
        let escaped = part.get(..2).and_then(|digits| u8::from_str_radix(digits, 16).ok());
        bytes.push(escaped.unwrap_or(b'%'));
        bytes.extend(&part.as_bytes()[if escaped.is_some() { 2 } else { 0 }..]);
    }
    std::str::from_utf8(&bytes).is_ok()
}

fn text<'a>(headers: &'a HeaderMap, name: &header::HeaderName) -> &'a str {
    headers.get(name).map_or("", |value| value.to_str().unwrap_or("?"))
}

/// IP addresses cannot be rebound, so all of them are accepted; names must be known. What has a user before it is no host.
fn is_known_host(hosts: &[String], named: &str) -> bool {
    if named.contains('@') {
        return false;
    }
    let Ok(authority) = named.parse::<Authority>() else { return false };
    let host = authority.host();
    let bare = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(host);
    bare.parse::<IpAddr>().is_ok()
        || host.eq_ignore_ascii_case("localhost")
        || hosts.iter().any(|known| known.eq_ignore_ascii_case(host))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percent_decoded_paths_must_be_utf_8() {
        for text in ["/v1/jobs", "/%41", "/%d1%84", "/%", "/%zz", "/100%"] {
            assert!(is_utf8_path(text), "{text}");
        }
        for bytes in ["/%ff", "/%d1", "/a%80b"] {
            assert!(!is_utf8_path(bytes), "{bytes}");
        }
    }

    #[test]
    fn ip_addresses_localhost_and_known_names_are_accepted() {
        let hosts = ["farm.example".to_owned()];
        for ours in ["127.0.0.1:8080", "localhost", "LOCALHOST:1", "[::1]:80", "192.168.1.5:9", "farm.example:8080"] {
            assert!(is_known_host(&hosts, ours), "{ours}");
        }
        for foreign in [
            "",
            "evil.example",
            "localhost.evil.example",
            "127.0.0.1.evil.example:80",
            "evil@127.0.0.1",
            "a:b@localhost:1",
            "@",
            "?",
        ] {
            assert!(!is_known_host(&hosts, foreign), "{foreign}");
        }
    }
}
