//! Secrets: random bits, stored as their hash, compared in constant time.

use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

use super::ApiKeyError;

/// Prefix of every key, so that people and secret scanners recognize it.
const PREFIX: &str = "sdf_";
/// Number of random bytes of a key.
const SECRET_BYTES: usize = 32;
/// Number of random bytes of a key's id.
const ID_BYTES: usize = 6;

/// A new secret; it has no `Debug`, so that no log can show it.
pub(super) struct GeneratedSecret {
    pub(super) id: String,
    pub(super) secret: String,
    pub(super) digest: [u8; 32],
}

/// Generates a secret and an id.
pub(super) fn generate() -> Result<GeneratedSecret, ApiKeyError> {
    let mut bits = [0; SECRET_BYTES];
    getrandom::fill(&mut bits).map_err(ApiKeyError::Random)?;
    let mut id = [0; ID_BYTES];
    getrandom::fill(&mut id).map_err(ApiKeyError::Random)?;
    let secret = format!("{PREFIX}{}", URL_SAFE_NO_PAD.encode(bits));
    let id = id.iter().fold("key_".to_owned(), |text, byte| format!("{text}{byte:02x}"));
    Ok(GeneratedSecret { id, digest: digest(&secret), secret })
}

/// Stored hash of a secret.
pub(super) fn digest(secret: &str) -> [u8; 32] {
    Sha256::digest(secret.as_bytes()).into()
}

/// Compares two secrets in constant time.
pub(crate) fn constant_time_eq(left: &str, right: &str) -> bool {
    digest(left).ct_eq(&digest(right)).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_have_256_bits_and_differ() {
        let (one, two) = (generate().expect("random bits"), generate().expect("random bits"));
        assert_ne!(one.secret, two.secret);
        assert_ne!(one.id, two.id);
        assert_eq!(one.secret.len(), PREFIX.len() + 43);
        assert_eq!(one.digest, digest(&one.secret));
        assert!(constant_time_eq(&one.secret, &one.secret.clone()) && !constant_time_eq(&one.secret, &two.secret));
    }
}
