//! Client authentication: trusted certificates, and the API key to send.
//!
//! It makes no authorization decision, and none of its secrets appears in logs or errors.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Once;
use std::time::Duration;

use reqwest::{Certificate, ClientBuilder, RequestBuilder, Url};

/// Idle time after which clients close a connection: shorter than any sdfarm server's.
const IDLE_TIMEOUT: Duration = Duration::from_secs(15);

/// Key or token; readable only through [`Secret::expose`].
#[derive(Clone, PartialEq, Eq)]
pub struct Secret(String);

impl Secret {
    /// The secret itself, for the one place that sends or compares it.
    pub fn expose(&self) -> &str {
        &self.0
    }
}

impl From<String> for Secret {
    fn from(text: String) -> Self {
        Self(text)
    }
}

impl FromStr for Secret {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(Self(text.trim().to_owned()))
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Secret(…)")
    }
}

/// Error when preparing calls to a server.
#[derive(Debug, thiserror::Error)]
pub enum ClientAuthError {
    /// The server's address is invalid.
    #[error("{server:?} is not a server address: write http://HOST:PORT or https://HOST:PORT")]
    Address {
        /// Given address.
        server: String,
    },
    /// The CA certificates cannot be read.
    #[error("cannot read CA certificates from {file} ({reason}): pass a PEM file with --ca")]
    CaFile {
        /// The file.
        file: PathBuf,
        /// Reason.
        reason: String,
    },
    /// The secret has characters that no header can carry.
    #[error("the API key is empty or has invalid characters: set SDFARM_KEY to the key that `sdfarm key new` printed")]
    Key,
}

/// How to call a server. The default sends no key and trusts the system's certificates.
#[derive(Clone, Debug, Default)]
pub struct ClientAuth {
    key: Option<Secret>,
    ca_certificates: Vec<Certificate>,
}

impl ClientAuth {
    /// Sends this key, to servers whose certificates are signed by the CAs of a PEM file, or by the system's
    /// CAs without a file.
    pub fn new(key: Option<Secret>, authorities: Option<&Path>) -> Result<Self, ClientAuthError> {
        let is_plain = |key: &Secret| !key.0.is_empty() && key.0.bytes().all(|byte| byte.is_ascii_graphic());
        if !key.as_ref().is_none_or(is_plain) {
            return Err(ClientAuthError::Key);
        }
        let authorities = match authorities {
            Some(file) => read_authorities(file)?,
            None => Vec::new(),
        };
        Ok(Self { key, ca_certificates: authorities })
    }

    /// HTTP client builder for this server, to be completed with timeouts.
    pub fn client(&self, server: &Url) -> ClientBuilder {
        let builder = client_builder();
        if server.scheme() == "https" && self.ca_certificates.is_empty() {
            return builder;
        }
        // Without TLS the system's certificates are not needed, and reading them takes time.
        builder.tls_certs_only(self.ca_certificates.iter().cloned())
    }

    /// The request, with the key.
    pub fn authorize(&self, request: RequestBuilder) -> RequestBuilder {
        match &self.key {
            Some(key) => request.bearer_auth(key.expose()),
            None => request,
        }
    }
}

fn read_authorities(file: &Path) -> Result<Vec<Certificate>, ClientAuthError> {
    let wrong = |reason: String| ClientAuthError::CaFile { file: file.to_owned(), reason };
    let pem = std::fs::read(file).map_err(|error| wrong(error.to_string()))?;
    let certificates = Certificate::from_pem_bundle(&pem).map_err(|error| wrong(error.to_string()))?;
    if certificates.is_empty() { Err(wrong("it has no certificates".to_owned())) } else { Ok(certificates) }
}

/// Reads a server's address: `http://HOST:PORT` or `https://HOST:PORT`.
pub fn server_url(server: &str) -> Result<Url, ClientAuthError> {
    let wrong = || ClientAuthError::Address { server: server.to_owned() };
    let url = Url::parse(server.trim_end_matches('/')).map_err(|_| wrong())?;
    let is_plain = url.has_host()
        && url.query().is_none()
        && url.fragment().is_none()
        && url.username().is_empty()
        && url.password().is_none();
    if is_plain && ["http", "https"].contains(&url.scheme()) { Ok(url) } else { Err(wrong()) }
}

/// Starts every HTTP client of this process but that of the object store, because the process has to choose its TLS
/// library before the first client is built.
///
/// It speaks HTTP/1.1 whatever other packages enable in reqwest: a worker's uploads and its waiting calls must not share
/// a connection.
pub fn client_builder() -> ClientBuilder {
    install_crypto_provider();
    reqwest::Client::builder().pool_idle_timeout(IDLE_TIMEOUT).http1_only()
}

/// Chooses the TLS library of this process, before a client is built that does not come from [`client_builder`].
pub fn install_crypto_provider() {
    static CRYPTO_PROVIDER: Once = Once::new();
    // Fails only if another part of the process has installed a provider already; that one is used.
    CRYPTO_PROVIDER.call_once(|| drop(rustls::crypto::ring::default_provider().install_default()));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invalid_server_addresses_are_rejected() {
        for good in ["http://127.0.0.1:8080", "http://farm.example:80/", "http://[::1]:9", "https://farm.example"] {
            assert!(server_url(good).is_ok(), "{good}");
        }
        for bad in ["", "127.0.0.1:8080", "ftp://farm.example", "http://", "http://a?b", "https://a:b@farm.example"] {
            assert!(matches!(server_url(bad), Err(ClientAuthError::Address { .. })), "{bad}");
        }
    }

    #[test]
    fn debug_output_hides_the_secret() {
        let access = ClientAuth::new(Some("sdf_geheim".parse().expect("a secret")), None).expect("plain");
        assert!(!format!("{access:?}").contains("geheim"));
    }

    #[test]
    fn key_with_invalid_header_characters_is_rejected() {
        for bad in ["", "a b", "a\nb", "ä"] {
            assert!(matches!(ClientAuth::new(Some(bad.to_owned().into()), None), Err(ClientAuthError::Key)), "{bad:?}");
        }
    }

    #[test]
    fn missing_and_empty_authority_files_are_named() {
        let error = ClientAuth::new(None, Some(Path::new("/nonexistent.pem"))).expect_err("there is none").to_string();
        assert!(error.contains("/nonexistent.pem") && error.contains("--ca"), "{error}");
        let error = ClientAuth::new(None, Some(Path::new("/dev/null"))).expect_err("it is empty").to_string();
        assert!(error.contains("no certificates"), "{error}");
    }
}
