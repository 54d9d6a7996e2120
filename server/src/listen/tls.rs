//! TLS: reads the certificate and its key from files, and rereads them when they change.
//!
//! If the files become unreadable while the server runs, the old certificate stays in use.

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

/// Bytes of responses that TLS buffers for a client that does not read.
const MAX_BUFFERED_BYTES: usize = 16 << 10;

/// Error of a certificate.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TlsError {
    /// A file cannot be read.
    #[error("cannot read {file} as PEM: {reason}")]
    File {
        /// The file.
        file: PathBuf,
        /// Reason.
        reason: String,
    },
    /// The certificate and the key do not match.
    #[error("the certificate in {certificate} does not match the key in {key}: {reason}")]
    Pair {
        /// The certificate's file.
        certificate: PathBuf,
        /// The key's file.
        key: PathBuf,
        /// Reason.
        reason: String,
    },
    /// TLS cannot be set up.
    #[error("cannot set up TLS: {0}")]
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

// A derived implementation might print the key.
impl std::fmt::Debug for Tls {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Tls").field("certificate", &self.certificate).finish_non_exhaustive()
    }
}

/// Certificate that is in use.
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
    /// Reads a certificate chain, the server's own certificate first, and its key.
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
        let mut stream = self.acceptor.accept(stream).await?;
        stream.get_mut().1.set_buffer_limit(Some(MAX_BUFFERED_BYTES));
        Ok(stream)
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

    /// Reloads the files if they have changed since `seen`, or on request.
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
                tracing::info!(certificate = %self.certificate.display(), "reloaded the certificate");
            }
            Err(error) => tracing::error!(%error, "cannot use the new certificate: the old one stays in use"),
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
        return Err(wrong(certificate, "it has no certificate".to_owned()));
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
        Error::NoItemsFound => "it has no certificate or key".to_owned(),
        _ => "it is not PEM, or damaged".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    /// Writes a self-signed certificate and its key.
    fn write(certificate: &Path, key: &Path) {
        let pair = rcgen::generate_simple_self_signed(["localhost".to_owned()]).expect("a certificate");
        fs::write(key, pair.signing_key.serialize_pem()).expect("written");
        fs::write(certificate, pair.cert.pem()).expect("written");
    }

    #[test]
    fn an_unusable_certificate_is_never_used() {
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
        assert_eq!(seen, tls.stamp(), "the change was noticed");
        write(&certificate, &key);
        tls.look(&mut seen, true);
        assert_ne!(shown(), first);
    }
}
