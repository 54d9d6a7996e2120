//! The farm as a whole, as users see it over HTTP.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The farm, as `GET /v1/farm` shows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct FarmView {
    /// Nothing is leased until it is resumed; what is leased already goes on.
    pub paused: bool,
}
