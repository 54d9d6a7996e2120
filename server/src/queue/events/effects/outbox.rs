//! Writes events and the webhook deliveries that they are due to.

use proto::job::JobState;

use super::events::NewEvent;
use crate::db;
use crate::queue::{Connection, Result};

/// Job whose events are written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::queue) struct EventSource {
    /// The job's number.
    pub(in crate::queue) job: i64,
    /// Its id.
    pub(in crate::queue) id: String,
    /// Its name.
    pub(in crate::queue) name: String,
    /// Its submitter.
    pub(in crate::queue) submitter: String,
    /// Whether it has webhooks, so that most jobs need no look at them.
    pub(in crate::queue) has_webhooks: bool,
}

/// Writes events in their order.
pub(super) async fn write(connection: &mut Connection, source: &EventSource, events: &[NewEvent]) -> Result<()> {
    match events {
        [] => return Ok(()),
        [event] => insert(connection, source.job, event).await?,
        several => insert_all(connection, source.job, several).await?,
    }
    if source.has_webhooks && events.iter().any(|event| event.webhook_event().is_some()) {
        make_deliveries(connection, source, events).await?;
    }
    Ok(())
}

/// Writes one event, without deliveries.
pub(super) async fn insert(connection: &mut Connection, job: i64, event: &NewEvent) -> Result<()> {
    db::query("INSERT INTO outbox (job, kind, state, body) VALUES (?, ?, ?, ?)")
        .bind(job)
        .bind(event.kind)
        .bind(event.state.map(JobState::name))
        .bind(&event.body)
        .execute(connection)
        .await?;
    Ok(())
}

async fn insert_all(connection: &mut Connection, job: i64, events: &[NewEvent]) -> Result<()> {
    let rows: Vec<_> = events.iter().map(|event| (event.kind, event.state.map(JobState::name), &event.body)).collect();
    db::query(
        "INSERT INTO outbox (job, kind, state, body)
         SELECT CAST(?1 AS BIGINT), listed.value ->> 0, listed.value ->> 1, listed.value ->> 2 FROM @rows(?2)",
    )
    .bind(job)
    .bind(serde_json::json!(rows).to_string())
    .execute(connection)
    .await?;
    Ok(())
}

/// Makes the deliveries of events, due at once; each carries all that its message says, so that it outlives its job.
async fn make_deliveries(connection: &mut Connection, source: &EventSource, events: &[NewEvent]) -> Result<()> {
    let webhooks = db::query("SELECT url, target, events FROM webhook WHERE job = ? ORDER BY number")
        .bind(source.job)
        .fetch_all(&mut *connection)
        .await?;
    let mut due = Vec::new();
    for event in events {
        let Some(name) = event.webhook_event() else { continue };
        for webhook in &webhooks {
            if webhook.get::<String>("events")?.contains(&format!(",{name},")) {
                let (url, target): (String, String) = (webhook.get("url")?, webhook.get("target")?);
                due.push((message_id(), name.clone(), url, target, &event.body));
            }
        }
    }
    if due.is_empty() {
        return Ok(());
    }
    db::query(
        "INSERT INTO delivery (id, event, url, target, submitter, job, name, body, state, next_at_ms)
         SELECT listed.value ->> 0, listed.value ->> 1, listed.value ->> 2, listed.value ->> 3, CAST(?1 AS TEXT),
                CAST(?2 AS TEXT), CAST(?3 AS TEXT), listed.value ->> 4, 'pending', 0
         FROM @rows(?4)",
    )
    .bind(&source.submitter)
    .bind(&source.id)
    .bind(&source.name)
    .bind(serde_json::json!(due).to_string())
    .execute(connection)
    .await?;
    Ok(())
}

/// Random id of a message.
fn message_id() -> String {
    format!("msg_{}", uuid::Uuid::new_v4().simple())
}
