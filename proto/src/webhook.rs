//! What became of the messages to a job's webhooks, as `GET /v1/jobs/{id}/webhooks` shows it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Where a delivery stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DeliveryState {
    /// It will be tried, or tried again.
    Pending,
    /// It was taken.
    Delivered,
    /// Its attempts are used up, or its receiver is gone.
    Failed,
}

impl DeliveryState {
    /// Reads a state as the database spells it.
    pub fn read(name: &str) -> Option<Self> {
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
    /// Its id, as the header `webhook-id` has it in every attempt.
    pub id: String,
    /// What it tells.
    pub event: String,
    /// Whose it is: scheme, host and port of the address, for its path may hold a secret.
    pub receiver: String,
    /// Where it stands.
    pub state: DeliveryState,
    /// Attempts that were made.
    pub attempts: u32,
    /// When it is tried next: RFC 3339, UTC; null at the end.
    pub next_at: Option<String>,
    /// HTTP status of the last attempt's answer.
    pub status: Option<u16>,
    /// Why the last attempt failed.
    pub error: Option<String>,
}

/// A job's deliveries, oldest first.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DeliveryList {
    /// The deliveries.
    pub deliveries: Vec<DeliveryView>,
}
