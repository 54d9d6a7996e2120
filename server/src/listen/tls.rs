//! TLS: the certificate and its key, read from files, and read again when those change.
//!
//! Files that cannot be read while the server runs leave the old certificate in use.

use std::path::{Path, PathBuf};
use std::sync::{Arc, RwLock};
use std::time::{Duration, SystemTime};

use rustls::ServerConfig;
use rustls::crypto::ring;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::server::{ClientHello, ResolvesServerCert};
use rustls::sign::CertifiedKey;
use tokio::net::TcpStream;
use tokio::signal::unix::{SignalKind, signal};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;
use tokio_util::sync::CancellationToken;

/// Interval at which the files are checked.
const FILE_CHECK_INTERVAL: Duration = Duration::from_secs(1);

/// Error of a certificate.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TlsError {
    /// A file can't be read.
    #[error("{file} can't be read as PEM: {reason}")]
    File {
        /// The file.
        file: PathBuf,
        /// Reason.
        reason: String,
    },
    /// The certificate and the key do not match.
    #[error("the certificate in {certificate} is not for the key in {key}: {reason}")]
    Pair {
        /// The certificate's file.
        certificate: PathBuf,
        /// The key's file.
        key: PathBuf,
        /// Reason.
        reason: String,
    },
    /// TLS can't be spoken here.
    #[error("TLS can't be set up: {0}")]
    Set(#[from] rustls::Error),
}

/// Modification times and sizes of the certificate's and the key's file.
type Stamp = [Option<(SystemTime, u64)>; 2];

/// Accepts connections over TLS.
pub(crate) struct Tls {
    acceptor: TlsAcceptor,
    shown: Arc<CurrentCertificate>,
    certificate: PathBuf,
    key: PathBuf,
}

// A derived one might show the key.
impl std::fmt::Debug for Tls {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Tls").field("certificate", &self.certificate).finish_non_exhaustive()
    }
}

/// The certificate that is shown at present.
struct CurrentCertificate(RwLock<Arc<CertifiedKey>>);

impl std::fmt::Debug for CurrentCertificate {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("CurrentCertificate")
    }
}

impl ResolvesServerCert for CurrentCertificate {
    fn resolve(&self, _: ClientHello<'_>) -> Option<Arc<CertifiedKey>> {
        Some(Arc::clone(&self.0.read().expect("no holder panics")))
    }
}

impl Tls {
    /// Reads a chain of certificates, the server's own first, and its key.
    pub(crate) fn open(certificate: &Path, key: &Path) -> Result<Self, TlsError> {
        let shown = Arc::new(CurrentCertificate(RwLock::new(Arc::new(read(certificate, key)?))));
        let mut config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()?
            .with_no_client_auth()
            .with_cert_resolver(Arc::clone(&shown) as Arc<dyn ResolvesServerCert>);
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        let acceptor = TlsAcceptor::from(Arc::new(config));
        Ok(Self { acceptor, shown, certificate: certificate.to_owned(), key: key.to_owned() })
    }

    /// Performs the handshake.
    pub(super) async fn accept(&self, stream: TcpStream) -> std::io::Result<TlsStream<TcpStream>> {
        self.acceptor.accept(stream).await
    }

    /// Reloads the files when they change, and at SIGHUP, until shutdown.
    pub(crate) async fn watch_files(&self, end: CancellationToken) {
        let mut seen = self.stamp();
        let mut hang_up = signal(SignalKind::hangup()).ok();
        loop {
            let asked = tokio::select! {
                () = end.cancelled() => return,
                () = tokio::time::sleep(FILE_CHECK_INTERVAL) => false,
                () = sighup(&mut hang_up) => true,
            };
            self.look(&mut seen, asked);
        }
    }

    /// Reloads the files if they have changed since they were `seen`, or on request.
    fn look(&self, seen: &mut Stamp, asked: bool) {
        let now = self.stamp();
        if now == *seen && !asked {
            return;
        }
        // One of the two may be half written, or still the old one: the next change triggers another attempt.
        *seen = now;
        match read(&self.certificate, &self.key) {
            Ok(pair) => {
                *self.shown.0.write().expect("no holder panics") = Arc::new(pair);
                tracing::info!(certificate = %self.certificate.display(), "a new certificate is shown from now on");
            }
            Err(error) => tracing::error!(%error, "the old certificate stays: the new one can't be used"),
        }
    }

    /// Modification times and sizes of the files.
    fn stamp(&self) -> Stamp {
        [&self.certificate, &self.key].map(|file| {
            let metadata = std::fs::metadata(file).ok()?;
            Some((metadata.modified().ok()?, metadata.len()))
        })
    }
}

async fn sighup(signal: &mut Option<tokio::signal::unix::Signal>) {
    match signal {
        Some(signal) => {
            signal.recv().await;
        }
        None => std::future::pending().await,
    }
}

fn read(certificate: &Path, key: &Path) -> Result<CertifiedKey, TlsError> {
    let wrong = |file: &Path, reason: String| TlsError::File { file: file.to_owned(), reason };
    let chain = CertificateDer::pem_file_iter(certificate)
        .and_then(Iterator::collect::<Result<Vec<_>, _>>)
        .map_err(|error| wrong(certificate, pem_error_text(&error)))?;
    if chain.is_empty() {
        return Err(wrong(certificate, "it holds no certificate".to_owned()));
    }
    let secret = PrivateKeyDer::from_pem_file(key).map_err(|error| wrong(key, pem_error_text(&error)))?;
    let secret = ring::sign::any_supported_type(&secret).map_err(|error| wrong(key, error.to_string()))?;
    let pair = CertifiedKey::new(chain, secret);
    pair.keys_match().map_err(|error| TlsError::Pair {
        certificate: certificate.to_owned(),
        key: key.to_owned(),
        reason: error.to_string(),
    })?;
    Ok(pair)
}

/// The PEM reader's message, without the content it read.
fn pem_error_text(error: &rustls::pki_types::pem::Error) -> String {
    use rustls::pki_types::pem::Error;
    match error {
        Error::Io(error) => error.to_string(),
        Error::NoItemsFound => "it holds none".to_owned(),
        _ => "it is not PEM, or damaged".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    /// Writes a certificate that vouches for itself, and its key.
    fn write(certificate: &Path, key: &Path) {
        let pair = rcgen::generate_simple_self_signed(["localhost".to_owned()]).expect("a certificate");
        fs::write(key, pair.signing_key.serialize_pem()).expect("written");
        fs::write(certificate, pair.cert.pem()).expect("written");
    }

    #[test]
    fn a_certificate_that_can_not_be_used_is_never_shown() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let (certificate, key) = (folder.path().join("cert.pem"), folder.path().join("key.pem"));
        write(&certificate, &key);
        let tls = Tls::open(&certificate, &key).expect("a certificate and its key");
        let mut seen = tls.stamp();
        let shown = || tls.shown.0.read().expect("no holder panics").cert.clone();
        let first = shown();
        fs::write(&key, "no key").expect("written");
        tls.look(&mut seen, false);
        assert_eq!(shown(), first);
        assert_eq!(seen, tls.stamp(), "it was looked at");
        write(&certificate, &key);
        tls.look(&mut seen, true);
        assert_ne!(shown(), first);
    }
}
