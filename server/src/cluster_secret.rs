//! The secret that the servers of one farm share. The secrets that sign links and webhooks are derived from it, so that
//! each server's signatures are valid at every other.

use std::str::FromStr;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use hmac::{Hmac, KeyInit, Mac};
use proto::Secret;
use sha2::Sha256;

/// Minimum length, in characters.
const MIN_LENGTH: usize = 32;

/// Secret of the servers of a farm.
#[derive(Clone, Debug)]
pub struct ClusterSecret(Secret);

/// Error returned when text is too short for a secret.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("it has {0} characters: give at least 32 random ones, such as those of `openssl rand -base64 32`")]
pub struct ShortSecretError(usize);

impl FromStr for ClusterSecret {
    type Err = ShortSecretError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let text = text.trim();
        match text.chars().count() {
            length if length < MIN_LENGTH => Err(ShortSecretError(length)),
            _ => Ok(Self(text.to_owned().into())),
        }
    }
}

impl ClusterSecret {
    /// Secret that signs links.
    pub(crate) fn for_links(&self) -> [u8; 32] {
        self.derive("links")
    }

    /// Secret that signs webhooks, for their receivers.
    pub fn for_webhooks(&self) -> Secret {
        format!("whsec_{}", STANDARD.encode(self.derive("webhooks"))).into()
    }

    /// Number by which servers notice that their secrets differ. It tells nothing about the secret.
    pub(crate) fn fingerprint(&self) -> i64 {
        let bytes = self.derive("fingerprint");
        i64::from_be_bytes(bytes[..8].try_into().expect("eight bytes")) & i64::MAX
    }

    fn derive(&self, purpose: &str) -> [u8; 32] {
        let mut code =
            Hmac::<Sha256>::new_from_slice(self.0.expose().as_bytes()).expect("HMAC takes keys of any length");
        code.update(format!("sdfarm {purpose}, version 1").as_bytes());
        code.finalize().into_bytes().into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_for_each_purpose_differ_and_are_never_shown() {
        let secret: ClusterSecret = "0123456789abcdef0123456789abcdef\n".parse().expect("long enough");
        let again: ClusterSecret = "0123456789abcdef0123456789abcdef".parse().expect("long enough");
        let other: ClusterSecret = "0123456789abcdef0123456789abcdeg".parse().expect("long enough");
        assert_eq!(secret.for_links(), again.for_links());
        assert_ne!(secret.for_links(), other.for_links());
        assert_ne!(secret.fingerprint(), other.fingerprint());
        assert_ne!(secret.for_webhooks().expose(), &format!("whsec_{}", STANDARD.encode(secret.for_links())));
        assert!(crate::webhooks::Signer::new(&secret.for_webhooks()).is_ok());
        assert!(!format!("{secret:?}").contains("0123"));
        let short = "a short secret".parse::<ClusterSecret>().expect_err("too short").to_string();
        assert!(short.contains("14 characters") && short.contains("openssl rand"), "{short}");
    }
}
