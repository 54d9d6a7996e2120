//! Identifiers: UUIDv7 newtypes, so that one kind is never taken for another and later ids sort after earlier
//! ones.

use std::fmt;
use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use uuid::Uuid;

macro_rules! ids {
    ($($(#[$doc:meta])* $Id:ident),* $(,)?) => { $(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
        #[serde(transparent)]
        #[schemars(with = "Uuid")]
        pub struct $Id(Uuid);

        impl $Id {
            /// New id, greater than every earlier id of this process.
            pub fn new() -> Self {
                Self(Uuid::now_v7())
            }

            /// Time at which it was made, in milliseconds since 1970; 0 for an id of another kind.
            pub fn made_at_ms(self) -> i64 {
                let (seconds, nanoseconds) = self.0.get_timestamp().map_or((0, 0), |time| time.to_unix());
                i64::try_from(seconds).map_or(0, |seconds| seconds * 1000 + i64::from(nanoseconds) / 1_000_000)
            }

            /// The last eight characters, which are random: enough for people to tell ids apart.
            pub fn short(self) -> String {
                self.to_string().split_off(28)
            }
        }

        impl Default for $Id {
            fn default() -> Self {
                Self::new()
            }
        }

        impl fmt::Display for $Id {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }

        impl FromStr for $Id {
            type Err = uuid::Error;

            fn from_str(text: &str) -> Result<Self, Self::Err> {
                Uuid::from_str(text).map(Self)
            }
        }
    )* };
}

ids![
    /// A job: the result of one `POST /v1/jobs`.
    JobId,
    /// Worker process, from its start to its exit.
    WorkerId,
    /// One worker's time-limited claim on one tile or stitch.
    LeaseId,
];
