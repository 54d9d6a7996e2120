//! The audit log: who did what, from where, with what outcome, as rows and as events of the log.
//!
//! A change is recorded in the transaction that makes it, so that neither a crash nor a client that leaves can
//! separate them. Rejections are counted by source, in one row for each source and period. Each kind of entry has
//! its own maximum, so that rejections never evict changes.

mod refusals;

use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

use futures_util::future::BoxFuture;
use proto::JobId;
use proto::audit::{AuditEntry, AuditPage};
use tokio_util::sync::CancellationToken;

use crate::clock::{Clock, rfc3339};
use crate::db::{self, Connection, Database, DatabaseError, Durability, FirstWrite, Row, with_first_write};
use refusals::Refusals;

/// Maximum number of entries of changes to keys, the pool and the farm.
const MAX_ADMIN_ENTRIES: u32 = 100_000;
/// Maximum number of entries of changes to jobs, and of registered workers.
const MAX_WORK_ENTRIES: u32 = 100_000;
/// Maximum number of entries of rejections.
const MAX_REFUSED_ENTRIES: u32 = 20_000;
/// Interval at which counts of rejections are written.
const FLUSH_INTERVAL: Duration = Duration::from_millis(250);
/// Interval at which the oldest entries are pruned.
const PRUNE_INTERVAL: Duration = Duration::from_mins(1);
/// Number of entries deleted in one transaction.
const PRUNE_BATCH: u32 = 1000;

tokio::task_local! {
    /// Entry of the request that the task handles, if the request may change something.
    static ENTRY: Arc<PendingEntry>;
}

/// Kind of an entry; each has its own maximum.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum EntryKind {
    /// Change to keys, the pool or the farm.
    Admin,
    /// Change to a job, or a registered worker.
    Work,
    /// Rejected request.
    Refused,
}

impl EntryKind {
    const ALL: [Self; 3] = [Self::Admin, Self::Work, Self::Refused];

    fn name(self) -> &'static str {
        match self {
            Self::Admin => "admin",
            Self::Work => "work",
            Self::Refused => "refused",
        }
    }

    fn max_entries(self) -> u32 {
        match self {
            Self::Admin => MAX_ADMIN_ENTRIES,
            Self::Work => MAX_WORK_ENTRIES,
            Self::Refused => MAX_REFUSED_ENTRIES,
        }
    }
}

/// An action of a caller, or its rejection.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct AuditRecord {
    /// Kind of the entry.
    pub(crate) kind: EntryKind,
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
    /// Writes it to the log; `times` is the number of equal rejections.
    fn log(&self, times: u32, message: &'static str) {
        tracing::info!(
            target: "audit", who = self.actor, key = self.key, address = self.address, method = self.method,
            route = self.route, job = self.job.map(tracing::field::display), status = self.status,
            code = self.code, id = self.request_id, times, "{message}"
        );
    }
}

/// Entry of a request that may change something, written with the request's first change.
#[derive(Debug)]
pub(crate) struct PendingEntry {
    at_ms: i64,
    /// The request, as far as it is known.
    record: Mutex<AuditRecord>,
    /// Number of the entry, once it is committed.
    number: OnceLock<i64>,
}

impl PendingEntry {
    /// Whether the entry is committed.
    pub(crate) fn is_written(&self) -> bool {
        self.number.get().is_some()
    }
}

impl FirstWrite for PendingEntry {
    fn is_written(&self) -> bool {
        self.number.get().is_some()
    }

    fn insert<'c>(&'c self, connection: &'c mut Connection) -> BoxFuture<'c, Result<i64, DatabaseError>> {
        let record = self.record.lock().expect("no holder panics").clone();
        Box::pin(async move { insert(connection, &record, self.at_ms, 1).await })
    }

    fn set_number(&self, number: i64) {
        // It is set already if this was not the request's first change.
        let _ = self.number.set(number);
    }
}

/// Adds to the record of the request that this task handles; does nothing if the request changes nothing.
pub(crate) fn describe(add: impl FnOnce(&mut AuditRecord)) {
    // Outside a request that may change something there is no entry, which is not an error.
    let _ = ENTRY.try_with(|entry| add(&mut entry.record.lock().expect("no holder panics")));
}

/// The audit log.
#[derive(Debug)]
pub(crate) struct AuditLog {
    store: Arc<Database>,
    clock: Clock,
    refusals: Refusals,
}

impl AuditLog {
    /// Opens the audit log of a database; counts of rejections are written while [`AuditLog::run`] runs.
    pub(crate) fn new(store: Arc<Database>, clock: Clock) -> Self {
        Self { store, clock, refusals: Refusals::default() }
    }

    /// Handles a request so that its first change also commits its entry; `expected` describes a success.
    pub(crate) async fn handle<T>(
        &self,
        expected: AuditRecord,
        handling: impl Future<Output = T>,
    ) -> (T, Arc<PendingEntry>) {
        let entry = Arc::new(PendingEntry {
            at_ms: self.clock.wall_ms(),
            record: Mutex::new(expected),
            number: OnceLock::new(),
        });
        let recorded = with_first_write(Arc::<PendingEntry>::clone(&entry), handling);
        (ENTRY.scope(Arc::clone(&entry), recorded).await, entry)
    }

    /// Records the outcome of a request that changed something, before its response is sent.
    pub(crate) async fn finish(&self, entry: Arc<PendingEntry>, outcome: AuditRecord) {
        outcome.log(1, "done");
        if entry.is_written() && *entry.record.lock().expect("no holder panics") == outcome {
            return;
        }
        let written = self.store.write(Durability::Relaxed, move |connection| {
            Box::pin(async move {
                if let Some(number) = entry.number.get() {
                    remove(connection, *number).await?;
                }
                insert(connection, &outcome, entry.at_ms, 1).await
            })
        });
        log_failure(written.await);
    }

    /// Counts a rejection, and withdraws the entry of a request that was rejected after all.
    pub(crate) async fn reject(&self, entry: Option<Arc<PendingEntry>>, outcome: AuditRecord) {
        self.refusals.count(AuditRecord { kind: EntryKind::Refused, ..outcome }, self.clock.wall_ms());
        let Some(number) = entry.and_then(|entry| entry.number.get().copied()) else { return };
        let removed = self
            .store
            .write(Durability::Relaxed, move |connection| Box::pin(async move { remove(connection, number).await }));
        log_failure(removed.await);
    }

    /// Writes counts of rejections, and prunes the oldest entries, until shutdown.
    pub(crate) async fn run(&self, end: CancellationToken) {
        let mut tick = tokio::time::interval(FLUSH_INTERVAL);
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let mut prune = tokio::time::interval(PRUNE_INTERVAL);
        loop {
            let done = tokio::select! {
                () = end.cancelled() => return log_failure(self.flush().await),
                _ = tick.tick() => self.flush().await,
                _ = prune.tick() => self.prune().await,
            };
            log_failure(done);
        }
    }

    async fn flush(&self) -> Result<(), DatabaseError> {
        let counts = self.refusals.take_unwritten(self.clock.now_ms());
        if counts.is_empty() {
            return Ok(());
        }
        let written = self
            .store
            .write(Durability::Relaxed, move |connection| {
                Box::pin(async move {
                    let mut written = Vec::with_capacity(counts.len());
                    for refused in counts {
                        written.push(refused.write(connection).await?);
                    }
                    Ok(written)
                })
            })
            .await?;
        self.refusals.set_numbers(written);
        Ok(())
    }

    async fn prune(&self) -> Result<(), DatabaseError> {
        for kind in EntryKind::ALL {
            let newest_pruned: Option<i64> =
                db::query_scalar("SELECT number FROM audit WHERE kind = ? ORDER BY number DESC LIMIT 1 OFFSET ?")
                    .bind(kind.name())
                    .bind(kind.max_entries())
                    .fetch_optional(self.store.readers())
                    .await?;
            let Some(newest_pruned) = newest_pruned else { continue };
            while self.prune_batch(kind, newest_pruned).await? == u64::from(PRUNE_BATCH) {}
        }
        Ok(())
    }

    async fn prune_batch(&self, kind: EntryKind, newest_pruned: i64) -> Result<u64, DatabaseError> {
        self.store
            .write(Durability::Relaxed, move |connection| {
                Box::pin(async move {
                    let pruned = db::query(
                        "DELETE FROM audit WHERE number IN (
                             SELECT number FROM audit WHERE kind = ? AND number <= ? ORDER BY number LIMIT ?)",
                    )
                    .bind(kind.name())
                    .bind(newest_pruned)
                    .bind(PRUNE_BATCH)
                    .execute(connection)
                    .await?;
                    Ok(pruned.rows_affected())
                })
            })
            .await
    }

    /// A page of entries, newest first, before the given number.
    pub(crate) async fn page(&self, before: Option<i64>, limit: u32) -> Result<AuditPage, DatabaseError> {
        let rows = db::query(
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

fn log_failure<T>(done: Result<T, DatabaseError>) {
    if let Err(error) = done {
        tracing::error!(%error, cause = ?std::error::Error::source(&error), "could not write the audit log");
    }
}

/// Inserts an entry; returns its number.
pub(crate) async fn insert(
    connection: &mut Connection,
    record: &AuditRecord,
    at_ms: i64,
    times: u32,
) -> Result<i64, DatabaseError> {
    let number = db::query_scalar(
        "INSERT INTO audit (at_ms, who, key, address, method, route, job, status, code, request_id, times, kind)
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?) RETURNING number",
    )
    .bind(at_ms)
    .bind(&record.actor)
    .bind(&record.key)
    .bind(&record.address)
    .bind(&record.method)
    .bind(&record.route)
    .bind(record.job.map(|job| job.to_string()))
    .bind(record.status)
    .bind(&record.code)
    .bind(&record.request_id)
    .bind(times)
    .bind(record.kind.name())
    .fetch_one(connection)
    .await?;
    Ok(number)
}

async fn remove(connection: &mut Connection, number: i64) -> Result<(), DatabaseError> {
    // No row is not an error: it may have been pruned.
    db::query("DELETE FROM audit WHERE number = ?").bind(number).execute(connection).await?;
    Ok(())
}

fn read(row: &Row) -> Result<AuditEntry, DatabaseError> {
    let job: Option<String> = row.get("job")?;
    Ok(AuditEntry {
        number: row.get("number")?,
        at: rfc3339(row.get("at_ms")?),
        who: row.get("who")?,
        key: row.get("key")?,
        address: row.get("address")?,
        method: row.get("method")?,
        route: row.get("route")?,
        job: job.and_then(|job| job.parse().ok()),
        status: row.get("status")?,
        code: row.get("code")?,
        request_id: row.get("request_id")?,
        times: row.get("times")?,
    })
}

#[cfg(test)]
mod tests;
