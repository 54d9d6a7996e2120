//! Signed, expiring links to pictures: HMAC-SHA256 over the content and the expiry, with a secret that is
//! created at the first start and stored in the data folder, or that the servers of a farm share.
//!
//! Does not depend on the current time, or on whether the picture exists.

use std::fmt;
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use base64::Engine;
use base64::prelude::BASE64_URL_SAFE_NO_PAD;
use hmac::{Hmac, KeyInit, Mac};
use proto::JobId;
use proto::link::LinkContent;
use sha2::Sha256;

use crate::private_files::LINK_SECRET_FILE;

/// Size of the secret, in bytes.
const SECRET_BYTES: usize = 32;
/// Prefix of the signed text, so that a signature is valid for nothing else.
const MAC_CONTEXT: &str = "sdfarm picture link, version 1";

/// Content and expiry of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct LinkClaims {
    /// The job.
    pub(crate) job: JobId,
    /// The frame, from 0.
    pub(crate) frame: u32,
    /// Content: the picture or a preview.
    pub(crate) content: LinkContent,
    /// Expiry, in seconds since 1970.
    pub(crate) expires_seconds: i64,
}

/// Signs and verifies links.
pub(crate) struct LinkSigner {
    secret: [u8; SECRET_BYTES],
}

impl fmt::Debug for LinkSigner {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Links(secret)")
    }
}

impl LinkSigner {
    /// Reads the secret of a data folder, or creates one.
    pub(crate) fn open(data: &Path) -> io::Result<Self> {
        let path = data.join(LINK_SECRET_FILE);
        let mut secret = [0; SECRET_BYTES];
        match File::open(&path) {
            Ok(mut file) => {
                let mut bytes = Vec::new();
                Read::by_ref(&mut file).take(SECRET_BYTES as u64 + 1).read_to_end(&mut bytes)?;
                secret = bytes.try_into().map_err(|_| {
                    io::Error::other(format!(
                        "{LINK_SECRET_FILE} is damaged: remove it, which invalidates all signed links"
                    ))
                })?;
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                getrandom::fill(&mut secret).map_err(io::Error::other)?;
                write_secret(data, &path, &secret)?;
            }
            Err(error) => return Err(error),
        }
        Ok(Self { secret })
    }

    /// Signs with this secret.
    pub(crate) fn new(secret: [u8; SECRET_BYTES]) -> Self {
        Self { secret }
    }

    /// Signature of a link.
    pub(crate) fn sign(&self, linked: &LinkClaims) -> String {
        BASE64_URL_SAFE_NO_PAD.encode(self.mac(linked).finalize().into_bytes())
    }

    /// Whether a signature matches a link, in constant time.
    pub(crate) fn verify(&self, linked: &LinkClaims, signature: &str) -> bool {
        BASE64_URL_SAFE_NO_PAD
            .decode(signature)
            .is_ok_and(|signature| self.mac(linked).verify_slice(&signature).is_ok())
    }

    fn mac(&self, linked: &LinkClaims) -> Hmac<Sha256> {
        let LinkClaims { job, frame, content: shown, expires_seconds } = linked;
        let mut code = Hmac::<Sha256>::new_from_slice(&self.secret).expect("HMAC takes keys of any length");
        code.update(format!("{MAC_CONTEXT}\n{job}\n{frame}\n{}\n{expires_seconds}", shown.name()).as_bytes());
        code
    }
}

/// Writes the secret atomically, readable by its owner only.
fn write_secret(data: &Path, path: &Path, secret: &[u8]) -> io::Result<()> {
    let half = data.join(format!("{LINK_SECRET_FILE}.part"));
    match std::fs::remove_file(&half) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        Ok(()) | Err(_) => {}
    }
    let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&half)?;
    file.write_all(secret)?;
    file.sync_all()?;
    std::fs::rename(&half, path)?;
    File::open(data)?.sync_all()
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn the_secret_survives_restarts_and_only_its_owner_reads_it() {
        let folder = tempfile::tempdir().expect("a folder");
        let linked =
            LinkClaims { job: JobId::new(), frame: 3, content: LinkContent::Image, expires_seconds: 1_700_000_000 };
        let signature = LinkSigner::open(folder.path()).expect("made").sign(&linked);
        let again = LinkSigner::open(folder.path()).expect("read");
        assert!(again.verify(&linked, &signature));
        let mode = std::fs::metadata(folder.path().join(LINK_SECRET_FILE)).expect("there").permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
        assert_eq!(format!("{again:?}"), "Links(secret)");
        let elsewhere = tempfile::tempdir().expect("a folder");
        assert!(!LinkSigner::open(elsewhere.path()).expect("made").verify(&linked, &signature));
    }

    #[test]
    fn a_signature_is_valid_for_its_link_only() {
        let folder = tempfile::tempdir().expect("a folder");
        let links = LinkSigner::open(folder.path()).expect("made");
        let linked = LinkClaims { job: JobId::new(), frame: 3, content: LinkContent::Image, expires_seconds: 100 };
        let signature = links.sign(&linked);
        for other in [
            LinkClaims { job: JobId::new(), ..linked },
            LinkClaims { frame: 4, ..linked },
            LinkClaims { content: LinkContent::Preview, ..linked },
            LinkClaims { expires_seconds: 101, ..linked },
        ] {
            assert!(!links.verify(&other, &signature), "{other:?}");
        }
        for wrong in ["", "AAAA", &signature[1..], &format!("{signature}="), &format!("{signature}A"), "%%%"] {
            assert!(!links.verify(&linked, wrong), "{wrong}");
        }
    }

    #[test]
    fn a_damaged_secret_is_reported_with_its_fix() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join(LINK_SECRET_FILE), b"short").expect("written");
        let error = LinkSigner::open(folder.path()).expect_err("too short").to_string();
        assert!(error.contains("remove it"), "{error}");
    }
}
