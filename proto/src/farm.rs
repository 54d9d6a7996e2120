//! State of the farm, as the HTTP API returns it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// State of the farm, as `GET /v1/farm` returns it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct FarmView {
    /// No tiles are leased until the farm is resumed; leased tiles finish and count.
    pub paused: bool,
}
