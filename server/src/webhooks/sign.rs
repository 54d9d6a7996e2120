//! Signs messages by the Standard Webhooks specification (standardwebhooks.com), and manages their secret.
//!
//! The secret is in a file of the data folder that only its owner can read, or comes from the operator; it
//! appears in no log and no debug output.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use hmac::{Hmac, KeyInit, Mac};
use proto::Secret;
use sha2::Sha256;

use crate::private_files::WEBHOOK_SECRET_FILE;

/// Prefix of a secret.
const PREFIX: &str = "whsec_";
/// Size of a new secret, in bytes.
const SECRET_BYTES: usize = 32;
/// Sizes of secrets that the specification permits, in bytes.
const ALLOWED_BYTES: std::ops::RangeInclusive<usize> = 24..=64;
/// File mode: only the owner can read it.
const MODE: u32 = 0o600;

/// Error that prevents signing.
#[derive(Debug, thiserror::Error)]
pub enum SecretError {
    /// The file cannot be read or created.
    #[error("cannot read or create the webhook secret {file}: {source}")]
    File {
        /// The file.
        file: std::path::PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// It is not a webhook secret.
    #[error("the webhook secret is invalid: it must be whsec_ and 24 to 64 bytes in base64")]
    Malformed,
}

/// Signs messages.
#[derive(Clone)]
pub(crate) struct Signer {
    key: Vec<u8>,
}

impl std::fmt::Debug for Signer {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("Signer(…)")
    }
}

impl Signer {
    /// Signs with this secret.
    pub(crate) fn new(secret: &Secret) -> Result<Self, SecretError> {
        let encoded = secret.expose().trim().strip_prefix(PREFIX).ok_or(SecretError::Malformed)?;
        let key = STANDARD.decode(encoded).map_err(|_| SecretError::Malformed)?;
        if ALLOWED_BYTES.contains(&key.len()) { Ok(Self { key }) } else { Err(SecretError::Malformed) }
    }

    /// Value of the `webhook-signature` header.
    pub(crate) fn signature(&self, id: &str, timestamp_seconds: i64, body: &str) -> String {
        let mut mac = Hmac::<Sha256>::new_from_slice(&self.key).expect("a key may have any length");
        mac.update(format!("{id}.{timestamp_seconds}.{body}").as_bytes());
        format!("v1,{}", STANDARD.encode(mac.finalize().into_bytes()))
    }
}

/// Secret that signs a data folder's webhooks; created if missing.
pub fn webhook_secret(data: &Path) -> Result<Secret, SecretError> {
    let file = data.join(WEBHOOK_SECRET_FILE);
    let failed = |source| SecretError::File { file: file.clone(), source };
    match fs::read_to_string(&file) {
        Ok(text) if !text.trim().is_empty() => return Ok(text.trim().to_owned().into()),
        // The process was killed between creating and writing the file.
        Ok(_) => fs::remove_file(&file).map_err(failed)?,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {}
        Err(error) => return Err(failed(error)),
    }
    let mut key = [0; SECRET_BYTES];
    getrandom::fill(&mut key).map_err(|error| failed(io::Error::other(error)))?;
    let secret = format!("{PREFIX}{}", STANDARD.encode(key));
    let mut made = OpenOptions::new().write(true).create_new(true).mode(MODE).open(&file).map_err(failed)?;
    made.write_all(secret.as_bytes()).and_then(|()| made.sync_all()).map_err(failed)?;
    Ok(secret.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_signature_matches_the_specifications_example() {
        // Example from the tests of the Standard Webhooks libraries.
        let secret = Secret::from("whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw".to_owned());
        let signer = Signer::new(&secret).expect("a secret");
        let signature = signer.signature("msg_p5jXN8AQM9LWM0D4loKWxJek", 1_614_265_330, r#"{"test": 2432232314}"#);
        assert_eq!(signature, "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE=");
    }

    #[test]
    fn the_secret_is_created_once_for_its_owner_only() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().expect("a temporary folder");
        let first = webhook_secret(folder.path()).expect("made");
        assert!(Signer::new(&first).is_ok());
        assert_eq!(webhook_secret(folder.path()).expect("read"), first);
        let mode = fs::metadata(folder.path().join(WEBHOOK_SECRET_FILE)).expect("there").permissions().mode();
        assert_eq!(mode & 0o777, MODE);
        for wrong in ["", "whsec_", "whsec_c2hvcnQ=", "MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw", "whsec_?"] {
            assert!(Signer::new(&wrong.to_owned().into()).is_err(), "{wrong}");
        }
    }
}
