//! Signed links to pictures: any client with a link can read that picture until the link expires, without a
//! key.

use std::fmt;

use schemars::JsonSchema;
use serde::de::{Error, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

/// Maximum validity of a link, in seconds.
pub const MAX_LINK_SECONDS: u32 = 366 * 86_400;

/// Content of a link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LinkContent {
    /// The stored picture.
    #[default]
    Image,
    /// PNG of the finished part so far.
    Preview,
}

impl LinkContent {
    /// Name used in link addresses.
    pub fn name(self) -> &'static str {
        match self {
            Self::Image => "image",
            Self::Preview => "preview",
        }
    }
}

/// Request for a link.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LinkRequest {
    /// Validity of the link, in seconds.
    #[schemars(range(min = 1, max = MAX_LINK_SECONDS))]
    #[serde(deserialize_with = "expiry_seconds")]
    pub expires_in_seconds: u32,
    /// Content of the link.
    #[serde(default)]
    pub shows: LinkContent,
}

/// Parses a validity; any other value gets an error with the range.
fn expiry_seconds<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    deserializer.deserialize_u64(ExpiryVisitor)
}

struct ExpiryVisitor;

impl Visitor<'_> for ExpiryVisitor {
    type Value = u32;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a whole number of seconds from 1 to {MAX_LINK_SECONDS}")
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<u32, E> {
        let seconds = u32::try_from(value).ok().filter(|seconds| (1..=MAX_LINK_SECONDS).contains(seconds));
        seconds.ok_or_else(|| E::invalid_value(Unexpected::Unsigned(value), &self))
    }
}

/// A signed link.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct LinkView {
    /// Path and query of the link, to be appended to the server's address.
    pub url: String,
    /// Time of expiry: RFC 3339, UTC.
    pub expires_at: String,
}
