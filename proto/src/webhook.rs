//! Deliveries to a job's webhooks, as `GET /v1/jobs/{id}/webhooks` returns them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// State of a delivery.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DeliveryState {
    /// An attempt is due now or later.
    Pending,
    /// The receiver accepted the message.
    Delivered,
    /// All attempts failed, or the receiver responded 410 Gone.
    Failed,
}

impl DeliveryState {
    /// Reads a state as the database spells it.
    pub fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "pending" => Self::Pending,
            "delivered" => Self::Delivered,
            "failed" => Self::Failed,
            _ => return None,
        })
    }
}

/// A message to a webhook.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DeliveryView {
    /// Message id, sent in the `webhook-id` header of every attempt.
    pub id: String,
    /// Event type.
    pub event: String,
    /// Scheme, host and port of the receiver's address; the path is omitted because it may contain a secret.
    pub receiver: String,
    /// State.
    pub state: DeliveryState,
    /// Number of attempts so far.
    pub attempts: u32,
    /// Time of the next attempt: RFC 3339, UTC; null if there is none.
    pub next_at: Option<String>,
    /// HTTP status of the last attempt's response.
    pub status: Option<u16>,
    /// Error of the last attempt.
    pub error: Option<String>,
}

/// A job's deliveries, oldest first.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DeliveryList {
    /// The deliveries.
    pub deliveries: Vec<DeliveryView>,
}
