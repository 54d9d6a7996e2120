//! Retention as users write it (`36h`, `7d`, `forever`), and the result of a garbage collection.
//!
//! Does not depend on the current time.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::JobId;

/// Longest finite retention; a longer one is written `forever`.
const MAX_RETENTION_SECONDS: u64 = 100 * 366 * 86_400;

/// The units, largest first.
const UNITS: [(char, u64); 5] = [('w', 604_800), ('d', 86_400), ('h', 3_600), ('m', 60), ('s', 1)];

/// How long a job is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Retention {
    /// Until a user deletes it.
    Forever,
    /// For this long after it finishes.
    For(Duration),
}

/// Error returned when a text is not a retention.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} is not a retention: write a number and s, m, h, d or w, such as 36h or 7d (at most 100 years), or forever"
)]
pub struct ParseRetentionError(String);

impl FromStr for Retention {
    type Err = ParseRetentionError;

    fn from_str(text: &str) -> Result<Self, ParseRetentionError> {
        if text == "forever" {
            return Ok(Self::Forever);
        }
        let wrong = || ParseRetentionError(text.chars().take(40).collect());
        let unit = UNITS.iter().find(|(unit, _)| text.ends_with(*unit)).ok_or_else(wrong)?;
        let digits = &text[..text.len() - 1];
        if digits.is_empty() || !digits.bytes().all(|byte| byte.is_ascii_digit()) {
            return Err(wrong());
        }
        let seconds = digits.parse::<u64>().ok().and_then(|count| count.checked_mul(unit.1));
        let seconds = seconds.filter(|seconds| *seconds <= MAX_RETENTION_SECONDS).ok_or_else(wrong)?;
        Ok(Self::For(Duration::from_secs(seconds)))
    }
}

impl fmt::Display for Retention {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self::For(time) = self else { return f.write_str("forever") };
        let seconds = time.as_secs();
        let (unit, length) = UNITS.into_iter().find(|(_, length)| seconds % length == 0).unwrap_or(('s', 1));
        write!(f, "{}{unit}", seconds / length)
    }
}

/// Reason for a deletion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RemovalReason {
    /// It finished longer ago than its retention.
    Age,
    /// The store is larger than its limit, and the job is among those that finished first.
    Size,
}

impl RemovalReason {
    /// The name used in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Age => "age",
            Self::Size => "size",
        }
    }
}

/// Deleted job.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct RemovedJob {
    /// Its id.
    pub id: JobId,
    /// Its name.
    pub name: String,
    /// Time at which it reached its final state: RFC 3339, UTC.
    pub finished_at: String,
    /// Reason for its deletion.
    pub reason: RemovalReason,
    /// Bytes of pictures that no other job uses.
    pub freed_bytes: u64,
}

/// Response to `POST /v1/gc`: the jobs that were deleted, or would be.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct GcReport {
    /// True if nothing was deleted; the response lists the jobs that would be.
    pub dry_run: bool,
    /// Bytes of pictures and tiles before.
    pub store_bytes: u64,
    /// The store's limit; null means no limit.
    pub max_store_bytes: Option<u64>,
    /// Bytes of the jobs' pictures.
    pub freed_bytes: u64,
    /// The jobs, in the order of deletion.
    pub jobs: Vec<RemovedJob>,
    /// More jobs may be past their retention: repeat the request.
    pub more: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn retentions_round_trip() {
        for (text, seconds) in [("1s", 1), ("90m", 5_400), ("36h", 129_600), ("10d", 864_000), ("4w", 2_419_200)] {
            assert_eq!(text.parse(), Ok(Retention::For(Duration::from_secs(seconds))), "{text}");
            assert_eq!(Retention::For(Duration::from_secs(seconds)).to_string(), text);
        }
        assert_eq!("forever".parse(), Ok(Retention::Forever));
        assert_eq!(Retention::Forever.to_string(), "forever");
        assert_eq!("7d".parse::<Retention>().map(|keep| keep.to_string()).as_deref(), Ok("1w"));
    }

    #[test]
    fn invalid_retentions_are_rejected() {
        for text in ["", "d", "7", "-7d", "7.5d", "7 d", "7D", "1e3s", "18446744073709551615w", "101000w", "üd", "∞"]
        {
            assert!(text.parse::<Retention>().is_err(), "{text}");
        }
    }
}
