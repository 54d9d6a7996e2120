//! The model's events and webhook deliveries, made by the same pure functions as the queue's, and their comparison with
//! the rows of the database.

use std::collections::BTreeMap;

use proto::JobId;

use crate::db::{self, Readers};
use crate::queue::events::effects::NewEvent;

/// Event of a job as a row has it: job, kind, state, body.
type EventRow = (String, String, Option<String>, String);
/// Delivery as a row has it: job, event, address, body.
type DeliveryRow = (String, String, String, String);

/// Events and deliveries of the model.
#[derive(Clone, Debug, Default)]
pub(super) struct Outbox {
    events: Vec<(JobId, NewEvent)>,
    deliveries: Vec<DeliveryRow>,
    /// Addresses of a job's webhooks, with the events that each is sent.
    webhooks: BTreeMap<JobId, Vec<(String, Vec<&'static str>)>>,
}

impl Outbox {
    /// Registers a job's webhooks, after its first event.
    pub(super) fn register(&mut self, job: JobId, webhooks: Vec<(String, Vec<&'static str>)>) {
        self.webhooks.insert(job, webhooks);
    }

    /// Adds an event, and its deliveries.
    pub(super) fn add(&mut self, job: JobId, event: NewEvent) {
        if let Some(name) = event.webhook_event() {
            let all = self.webhooks.get(&job).into_iter().flatten();
            for (url, _) in all.filter(|(_, events)| events.contains(&name.as_str())) {
                self.deliveries.push((job.to_string(), name.clone(), url.clone(), event.body.clone()));
            }
        }
        self.events.push((job, event));
    }

    /// Forgets a deleted job's events; its deliveries stay.
    pub(super) fn forget(&mut self, job: JobId) {
        self.events.retain(|(owner, _)| *owner != job);
    }

    /// Asserts that the database has the model's rows, in the same order.
    pub(super) async fn compare(&self, readers: &Readers) {
        let rows = db::query(
            "SELECT job.id, outbox.kind, outbox.state, outbox.body FROM outbox @join job ON job.number = outbox.job
             WHERE job.cleanup IS NULL OR job.cleanup <> 'delete' ORDER BY outbox.number",
        );
        let rows = rows.fetch_all(readers).await.expect("reads");
        let text = |row: &db::Row, column: usize| row.get::<String>(column).expect("a text");
        let stored: Vec<EventRow> =
            rows.iter().map(|row| (text(row, 0), text(row, 1), row.get(2).expect("a state"), text(row, 3))).collect();
        let expected = self.events.iter().map(|(job, event)| {
            (
                job.to_string(),
                event.kind.to_owned(),
                event.state.map(|state| state.name().to_owned()),
                event.body.clone(),
            )
        });
        assert_eq!(stored, expected.collect::<Vec<EventRow>>(), "events");
        let rows = db::query("SELECT job, event, url, body FROM delivery ORDER BY number");
        let rows = rows.fetch_all(readers).await.expect("reads");
        let stored: Vec<DeliveryRow> =
            rows.iter().map(|row| (text(row, 0), text(row, 1), text(row, 2), text(row, 3))).collect();
        assert_eq!(stored, self.deliveries, "deliveries");
    }
}
