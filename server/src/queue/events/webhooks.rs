//! Webhook deliveries: reads due ones, records attempts, and prunes old ones.
//!
//! `effects` creates them, in the transaction of the event.

use std::collections::HashSet;
use std::time::Duration;

use db::Row;
use proto::JobId;
use proto::webhook::{DeliveryState, DeliveryView};

use crate::clock::rfc3339;
use crate::db;
use crate::db::Durability;
use crate::queue::{Queue, Result, json_list, json_numbers, parse_column};

/// Retention of finished deliveries.
const RETENTION_MS: i64 = 7 * 24 * 3_600_000;
/// Time for which a delivery that was given up is reported to operators.
const FAILURE_SHOWN_MS: i64 = 24 * 3_600_000;
/// Time in which the server that makes an attempt records its outcome, which is longer than an attempt takes.
const ATTEMPT_MS: i64 = 60_000;
/// Number of deliveries deleted in one transaction.
const DROP_BATCH: i64 = 1_000;
/// Maximum number of listed deliveries of a job.
const MAX_LISTED: i64 = 1_000;

/// Due delivery.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Delivery {
    /// Row number of the delivery.
    pub(crate) number: i64,
    /// Message id, the same in every attempt.
    pub(crate) id: String,
    /// Event type.
    pub(crate) event: String,
    /// Receiver's address.
    pub(crate) url: String,
    /// Host and port of the address.
    pub(crate) target: String,
    /// Submitter of the job.
    pub(crate) submitter: String,
    /// The job's id.
    pub(crate) job: String,
    /// The job's name.
    pub(crate) name: String,
    /// Payload, as JSON.
    pub(crate) body: String,
    /// Number of attempts so far.
    pub(crate) attempts: u32,
}

/// Deliveries that must wait: they are under way, or too many of their submitter or to their target are.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct BusyReceivers {
    /// Row numbers of deliveries under way.
    pub(crate) deliveries: Vec<i64>,
    /// Submitters with the maximum of attempts under way.
    pub(crate) submitters: Vec<String>,
    /// Targets with the maximum of attempts under way.
    pub(crate) targets: Vec<String>,
}

/// Outcome of an attempt.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Attempt {
    /// The receiver accepted the message.
    Delivered {
        /// Status of the response.
        status: u16,
    },
    /// The attempt failed.
    Failed {
        /// Status of the response, if there was one.
        status: Option<u16>,
        /// Reason.
        error: String,
        /// Time of the next attempt; `None` means never.
        retry_in: Option<Duration>,
    },
}

/// Deliveries that have failed so far, at most [`MAX_LISTED`] of each.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct FailingWebhooks {
    /// Deliveries that failed and are tried again.
    pub(crate) waiting: i64,
    /// Deliveries of the last day that are not tried again.
    pub(crate) given_up: i64,
    /// Host and port of one of them.
    pub(crate) target: Option<String>,
}

/// See [`FailingWebhooks`].
const FAILING_SQL: &str = "SELECT count(*) FILTER (WHERE state = 'pending') AS waiting,
        count(*) FILTER (WHERE state = 'failed') AS given_up, max(target) AS target
     FROM (SELECT state, target FROM (
               SELECT state, target FROM delivery WHERE state = 'pending' AND next_at_ms > 0 AND attempts > 0
               ORDER BY next_at_ms LIMIT ?1) AS pending
           UNION ALL SELECT state, target FROM (
               SELECT state, target FROM delivery WHERE finished_at_ms > ?2 AND state = 'failed'
               ORDER BY finished_at_ms LIMIT ?1) AS ended) AS failing";

impl Queue {
    /// Deliveries that have failed so far.
    pub(crate) async fn failing_webhooks(&self) -> Result<FailingWebhooks> {
        let query = db::query(FAILING_SQL).bind(MAX_LISTED).bind(self.clock.wall_ms() - FAILURE_SHOWN_MS);
        let row = query.fetch_one(self.readers()).await?;
        Ok(FailingWebhooks { waiting: row.get("waiting")?, given_up: row.get("given_up")?, target: row.get("target")? })
    }

    /// Due deliveries, the longest overdue first, without those that must wait for others.
    pub(crate) async fn due_deliveries(&self, busy: &BusyReceivers, limit: u32) -> Result<Vec<Delivery>> {
        let rows = db::query(
            "SELECT number, id, event, url, target, submitter, job, name, body, attempts FROM delivery
             WHERE state = 'pending' AND next_at_ms <= ?1 AND coalesce(claimed_until_ms, 0) <= ?1
               AND submitter NOT IN (SELECT value FROM @texts(?2))
               AND target NOT IN (SELECT value FROM @texts(?3))
               AND number NOT IN (SELECT value FROM @numbers(?4))
             ORDER BY next_at_ms LIMIT ?5",
        )
        .bind(self.clock.wall_ms())
        .bind(json_list(&busy.submitters))
        .bind(json_list(&busy.targets))
        .bind(json_numbers(busy.deliveries.iter().copied()))
        .bind(limit)
        .fetch_all(self.readers())
        .await?;
        rows.iter()
            .map(|row| {
                Ok(Delivery {
                    number: row.get("number")?,
                    id: row.get("id")?,
                    event: row.get("event")?,
                    url: row.get("url")?,
                    target: row.get("target")?,
                    submitter: row.get("submitter")?,
                    job: row.get("job")?,
                    name: row.get("name")?,
                    body: row.get("body")?,
                    attempts: row.get("attempts")?,
                })
            })
            .collect()
    }

    /// Claims deliveries for an attempt each; returns those that no other server attempts.
    pub(crate) async fn claim_deliveries(&self, numbers: impl IntoIterator<Item = i64>) -> Result<HashSet<i64>> {
        let (numbers, now_ms) = (json_numbers(numbers), self.clock.wall_ms());
        self.database
            .write(Durability::Relaxed, move |connection| {
                Box::pin(async move {
                    let claimed = db::query(
                        "UPDATE delivery SET claimed_until_ms = ?1
                         WHERE number IN (SELECT value FROM @numbers(?2)) AND state = 'pending'
                           AND coalesce(claimed_until_ms, 0) <= ?3 RETURNING number",
                    )
                    .bind(now_ms + ATTEMPT_MS)
                    .bind(numbers)
                    .bind(now_ms)
                    .scalar::<i64>()
                    .fetch_all(connection)
                    .await?;
                    Ok(claimed.into_iter().collect())
                })
            })
            .await
    }

    /// Records the outcome of an attempt. It does not count if another server has recorded one since, because this attempt took more than a minute.
    pub(crate) async fn record_attempt(&self, number: i64, attempt: Attempt) -> Result<()> {
        let wall_ms = self.clock.wall_ms();
        let (state, status, error, again_in) = match attempt {
            Attempt::Delivered { status } => ("delivered", Some(status), None, None),
            Attempt::Failed { status, error, retry_in: None } => ("failed", status, Some(error), None),
            Attempt::Failed { status, error, retry_in: again_in } => ("pending", status, Some(error), again_in),
        };
        let next_at_ms =
            again_in.map(|wait| wall_ms.saturating_add(i64::try_from(wait.as_millis()).unwrap_or(i64::MAX)));
        let finished_at_ms = next_at_ms.is_none().then_some(wall_ms);
        self.database
            .write(Durability::Relaxed, move |connection| {
                Box::pin(async move {
                    db::query(
                        "UPDATE delivery SET state = ?, attempts = attempts + 1, status = ?, error = ?,
                                             next_at_ms = ?, finished_at_ms = ?, claimed_until_ms = NULL
                         WHERE number = ? AND state = 'pending'",
                    )
                    .bind(state)
                    .bind(status)
                    .bind(error)
                    .bind(next_at_ms)
                    .bind(finished_at_ms)
                    .bind(number)
                    .execute(connection)
                    .await?;
                    Ok(())
                })
            })
            .await
    }

    /// A job's deliveries, oldest first.
    pub(crate) async fn deliveries(&self, job: JobId) -> Result<Vec<DeliveryView>> {
        let rows = db::query(
            "SELECT id, event, url, state, attempts, next_at_ms, status, error FROM delivery
             WHERE job = ? ORDER BY number LIMIT ?",
        )
        .bind(job.to_string())
        .bind(MAX_LISTED)
        .fetch_all(self.readers())
        .await?;
        rows.iter().map(view).collect()
    }

    /// Deletes deliveries that finished long ago; returns the number deleted.
    pub(crate) async fn prune_deliveries(&self) -> Result<u64> {
        let ended_before_ms = self.clock.wall_ms() - RETENTION_MS;
        let mut count = 0;
        loop {
            let dropped = self
                .database
                .write(Durability::Relaxed, move |connection| {
                    Box::pin(async move {
                        let dropped = db::query(
                            "DELETE FROM delivery WHERE number IN (
                                 SELECT number FROM delivery
                                 WHERE finished_at_ms IS NOT NULL AND finished_at_ms < ? LIMIT ?)",
                        )
                        .bind(ended_before_ms)
                        .bind(DROP_BATCH)
                        .execute(connection)
                        .await?;
                        Ok(dropped.rows_affected())
                    })
                })
                .await?;
            count += dropped;
            if dropped == 0 {
                return Ok(count);
            }
        }
    }
}

/// Part of an address that may be displayed.
fn receiver(url: &str) -> String {
    reqwest::Url::parse(url).map_or_else(|_| String::new(), |url| url.origin().ascii_serialization())
}

fn view(row: &Row) -> Result<DeliveryView> {
    let state: String = row.get("state")?;
    Ok(DeliveryView {
        id: row.get("id")?,
        event: row.get("event")?,
        receiver: receiver(&row.get::<String>("url")?),
        state: parse_column("delivery.state", &state, DeliveryState::parse)?,
        attempts: row.get("attempts")?,
        next_at: row.get::<Option<i64>>("next_at_ms")?.map(rfc3339),
        status: row.get("status")?,
        error: row.get("error")?,
    })
}
