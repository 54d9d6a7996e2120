//! The audit log: who did what, from where, with what outcome, as rows and as events of the log.
//!
//! Stores the newest 100,000 entries and never blocks a request: if records arrive faster than they can be
//! written, equal ones are counted together and the excess is dropped with a warning.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use proto::JobId;
use proto::audit::{AuditEntry, AuditPage};
use sqlx::Row;
use sqlx::sqlite::{SqliteConnection, SqliteRow};
use tokio::sync::{Mutex, mpsc};
use tokio_util::sync::CancellationToken;

use crate::clock::{Clock, rfc3339};
use crate::database::{Database, DatabaseError, Durability};

/// Maximum number of entries.
const MAX_ENTRIES: i64 = 100_000;
/// Maximum number of records waiting to be written.
const QUEUE_CAPACITY: usize = 4096;
/// Delay in which records are collected before they are written together.
const FLUSH_INTERVAL: Duration = Duration::from_millis(250);

/// An action of a caller, or its rejection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct AuditRecord {
    /// The key's name, or `local`, `pool` or `-`.
    pub(crate) actor: String,
    /// The key's id.
    pub(crate) key: Option<String>,
    /// The caller's address, without port.
    pub(crate) address: String,
    /// The request's method.
    pub(crate) method: String,
    /// The route, with its parameters' names.
    pub(crate) route: String,
    /// Id of the job concerned.
    pub(crate) job: Option<JobId>,
    /// Status of the response.
    pub(crate) status: u16,
    /// Problem code of a rejection.
    pub(crate) code: Option<String>,
    /// The request's id.
    pub(crate) request_id: String,
}

impl AuditRecord {
    /// Whether it is the same rejection, apart from the request id.
    fn is_same_rejection(&self, other: &Self) -> bool {
        self.code.is_some() && *self == Self { request_id: self.request_id.clone(), ..other.clone() }
    }
}

/// Record with the number of its repeats.
#[derive(Debug)]
struct AggregatedRecord {
    deed: AuditRecord,
    at_ms: i64,
    times: u32,
}

/// The audit log.
#[derive(Debug)]
pub(crate) struct AuditLog {
    store: Arc<Database>,
    clock: Clock,
    deeds: mpsc::Sender<AuditRecord>,
    waiting: Mutex<mpsc::Receiver<AuditRecord>>,
    dropped: AtomicU64,
}

impl AuditLog {
    /// Opens the audit log of a database; records are written while [`AuditLog::run`] runs.
    pub(crate) fn new(store: Arc<Database>, clock: Clock) -> Self {
        let (deeds, waiting) = mpsc::channel(QUEUE_CAPACITY);
        Self { store, clock, deeds, waiting: Mutex::new(waiting), dropped: AtomicU64::new(0) }
    }

    /// Queues a record to be written.
    pub(crate) fn record(&self, deed: AuditRecord) {
        if self.deeds.try_send(deed).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Writes records until shutdown, then the remaining ones.
    pub(crate) async fn run(&self, end: CancellationToken) {
        let mut waiting = self.waiting.lock().await;
        loop {
            let first = tokio::select! {
                biased;
                first = waiting.recv() => first,
                () = end.cancelled() => None,
            };
            let Some(first) = first else { return };
            let mut gathered = Vec::new();
            self.aggregate(&mut gathered, first);
            tokio::select! {
                () = end.cancelled() => {}
                () = tokio::time::sleep(FLUSH_INTERVAL) => {}
            }
            while let Ok(deed) = waiting.try_recv() {
                self.aggregate(&mut gathered, deed);
            }
            let unwritten = self.dropped.swap(0, Ordering::Relaxed);
            if unwritten > 0 {
                tracing::warn!(target: "audit", unwritten, "audit records dropped: the queue is full");
            }
            if let Err(error) = self.write(gathered).await {
                tracing::error!(%error, cause = ?std::error::Error::source(&error), "could not write the audit log");
            }
        }
    }

    fn aggregate(&self, gathered: &mut Vec<AggregatedRecord>, deed: AuditRecord) {
        if let Some(like) = gathered.iter_mut().rev().take(16).find(|like| like.deed.is_same_rejection(&deed)) {
            like.times = like.times.saturating_add(1);
        } else {
            gathered.push(AggregatedRecord { deed, at_ms: self.clock.wall_ms(), times: 1 });
        }
    }

    async fn write(&self, gathered: Vec<AggregatedRecord>) -> Result<(), DatabaseError> {
        for AggregatedRecord { deed, times, .. } in &gathered {
            tracing::info!(
                target: "audit", who = deed.actor, key = deed.key, address = deed.address, method = deed.method,
                route = deed.route, job = deed.job.map(tracing::field::display), status = deed.status,
                code = deed.code, id = deed.request_id, times, "done"
            );
        }
        self.store
            .write(Durability::Relaxed, move |connection| {
                Box::pin(async move {
                    for counted in &gathered {
                        insert(connection, counted).await?;
                    }
                    prune(connection).await
                })
            })
            .await
    }

    /// A page of entries, newest first, before the given number.
    pub(crate) async fn page(&self, before: Option<i64>, limit: u32) -> Result<AuditPage, DatabaseError> {
        let rows = sqlx::query(
            "SELECT number, at_ms, who, key, address, method, route, job, status, code, request_id, times
             FROM audit WHERE number < ? ORDER BY number DESC LIMIT ?",
        )
        .bind(before.unwrap_or(i64::MAX))
        .bind(i64::from(limit) + 1)
        .fetch_all(self.store.readers())
        .await?;
        let more = rows.len() > limit as usize;
        let entries = rows.iter().take(limit as usize).map(read).collect::<Result<Vec<_>, _>>()?;
        let next_cursor = entries.last().filter(|_| more).map(|entry| entry.number.to_string());
        Ok(AuditPage { entries, next_cursor })
    }
}

async fn insert(connection: &mut SqliteConnection, counted: &AggregatedRecord) -> Result<(), DatabaseError> {
    let deed = &counted.deed;
    sqlx::query(
        "INSERT INTO audit (at_ms, who, key, address, method, route, job, status, code, request_id, times)
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(counted.at_ms)
    .bind(&deed.actor)
    .bind(&deed.key)
    .bind(&deed.address)
    .bind(&deed.method)
    .bind(&deed.route)
    .bind(deed.job.map(|job| job.to_string()))
    .bind(deed.status)
    .bind(&deed.code)
    .bind(&deed.request_id)
    .bind(counted.times)
    .execute(connection)
    .await?;
    Ok(())
}

async fn prune(connection: &mut SqliteConnection) -> Result<(), DatabaseError> {
    sqlx::query("DELETE FROM audit WHERE number <= (SELECT max(number) FROM audit) - ?")
        .bind(MAX_ENTRIES)
        .execute(connection)
        .await?;
    Ok(())
}

fn read(row: &SqliteRow) -> Result<AuditEntry, DatabaseError> {
    let job: Option<String> = row.try_get("job")?;
    Ok(AuditEntry {
        number: row.try_get("number")?,
        at: rfc3339(row.try_get("at_ms")?),
        who: row.try_get("who")?,
        key: row.try_get("key")?,
        address: row.try_get("address")?,
        method: row.try_get("method")?,
        route: row.try_get("route")?,
        job: job.and_then(|job| job.parse().ok()),
        status: row.try_get("status")?,
        code: row.try_get("code")?,
        request_id: row.try_get("request_id")?,
        times: row.try_get("times")?,
    })
}
