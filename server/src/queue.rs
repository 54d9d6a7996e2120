//! The queue: the only place that changes the state of a job, frame, tile, lease or worker.
//!
//! One function is one transition is one statement, and each statement's row count is checked. What follows from a
//! transition (events, deliveries, books) is in `effects`, which it calls in its transaction. `Queue` is the entry
//! point: it supplies the time, runs transitions in the writer, and wakes the waiters that a change concerns. It depends
//! on no HTTP types or files.

mod events;
mod frames;
mod jobs;
mod leases;
mod servers;
#[cfg(test)]
mod tests;
mod tiles;
mod verification;
mod workers;

use std::collections::HashSet;
use std::hash::Hash;
use std::sync::Arc;

use proto::{JobId, WorkerId};
use servers::contact::Contact;
use servers::recover::StartingServer;

use crate::clock::Clock;
use crate::db::{self, Connection, Database, DatabaseError, Durability};

pub(crate) use events::Event;
pub(crate) use events::farm_changes::{ChangePosition, FarmChanges};
pub(crate) use events::gaps::mark_restored;
pub(crate) use events::wake::Hints;
use events::wake::{Wake, WakeSignals};
pub(crate) use events::webhooks::{Attempt, BusyReceivers, Delivery};
pub(crate) use frames::makers::PictureMark;
pub(crate) use frames::open::{FrameOpening, OpenOutcome};
pub(crate) use frames::previews::{FrameContents, ReadyWorker};
pub(crate) use frames::{FrameSet, StoredFrame};
pub(crate) use jobs::StoredImage;
pub(crate) use jobs::backlog::{BacklogLimits, ExceededLimit};
pub(crate) use jobs::changes::{ChangeOutcome, RetryOutcome};
pub(crate) use jobs::cleanup::RemovedContent;
pub(crate) use jobs::finish::{CancelOutcome, DeleteOutcome};
pub(crate) use jobs::idempotency::{IdempotencyKey, NewWebhook, SubmitOptions, SubmitOutcome};
pub(crate) use jobs::pause::PauseOutcome;
pub(crate) use jobs::places::{QueuePosition, ReorderOutcome};
pub(crate) use jobs::retention::FinishedJob;
pub(crate) use jobs::submit::NewJob;
pub(crate) use leases::claim::PassedJobs;
pub(crate) use leases::sync::{NextWork, SyncInput, SyncOutcome};
pub(crate) use leases::{LeaseEnd, jitter};
pub(crate) use servers::doomed::{CheckedNames, content_of};
pub(crate) use servers::recover::Recovery;
pub(crate) use servers::repair::{Reopened, absurd_shares, forget_pictures, reset_shares};
pub(crate) use servers::stats::QueueStats;
pub(crate) use tiles::TileCursor;
pub(crate) use tiles::reported::{RejectedResult, ReportedTile};
pub(crate) use verification::VerificationPolicy;
pub(crate) use workers::changes::{WorkerChange, WorkerChangeOutcome};
pub(crate) use workers::minutes::Rendered;
pub(crate) use workers::needs::{LeaseNeed, UploadNeed};
pub(crate) use workers::{MAX_WORKERS_OF_KEY, NewWorker, Registration};

/// Result of a transition.
type Result<T> = std::result::Result<T, DatabaseError>;

/// Time and lease terms of a transition.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TransitionContext {
    /// The server's clock.
    now_ms: i64,
    /// The wall clock.
    wall_ms: i64,
    /// Length of a lease.
    lease_ms: i64,
    /// Boot generation of the server.
    generation: i64,
    /// Whether leases may expire: their workers could have renewed them.
    expires_leases: bool,
    /// Maximum number of rows that one piece of a large change changes.
    piece_rows: i64,
    /// Which results are verified.
    verification: VerificationPolicy,
}

/// Handle to the queue.
#[derive(Clone, Debug)]
pub(crate) struct Queue {
    database: Arc<Database>,
    clock: Clock,
    lease_ms: i64,
    generation: i64,
    server_name: Arc<str>,
    contact: Arc<Contact>,
    piece_rows: i64,
    verification: VerificationPolicy,
    wake_signals: Arc<WakeSignals>,
}

impl Queue {
    /// Opens the queue of a database, after repairing the state that servers have left which have ended. The server's
    /// name is that of its data folder, and stays the same.
    pub(crate) async fn open(
        store: Arc<Database>,
        clock: Clock,
        lease_ms: i64,
        server_name: &str,
    ) -> Result<(Self, Recovery)> {
        let start = StartingServer {
            name: server_name.to_owned(),
            may_have_others: clock.is_lasting(),
            now_ms: clock.now_ms(),
            wall_ms: clock.wall_ms(),
            lease_ms,
        };
        let recovered = store
            .write(Durability::Full, move |connection| {
                Box::pin(async move { servers::recover::recover(connection, &start).await })
            })
            .await?;
        let queue = Self {
            database: store,
            clock,
            lease_ms,
            generation: recovered.generation,
            server_name: server_name.into(),
            contact: Arc::default(),
            piece_rows: jobs::cleanup::PIECE_ROWS,
            verification: VerificationPolicy::default(),
            wake_signals: Arc::default(),
        };
        Ok((queue, recovered))
    }

    /// The same queue, which has a share of results verified.
    pub(crate) fn with_verification(self, verification: VerificationPolicy) -> Self {
        Self { verification, ..self }
    }

    fn context(&self) -> TransitionContext {
        TransitionContext {
            now_ms: self.clock.now_ms(),
            wall_ms: self.clock.wall_ms(),
            lease_ms: self.lease_ms,
            generation: self.generation,
            expires_leases: !self.clock.is_lasting() || self.contact.is_steady(),
            piece_rows: self.piece_rows,
            verification: self.verification,
        }
    }

    /// Length of a lease, in milliseconds.
    pub(crate) fn lease_ms(&self) -> i64 {
        self.lease_ms
    }

    /// Accepts a job; durable when it returns.
    #[cfg(test)]
    pub(crate) async fn submit(&self, job: NewJob) -> Result<i64> {
        let context = self.context();
        let number = self
            .database
            .write(Durability::Full, move |connection| {
                Box::pin(async move { jobs::submit::submit(connection, &job, context).await })
            })
            .await?;
        self.wake(Wake::WORK);
        Ok(number)
    }

    /// Stores a job's next frame from a cached picture; `OpenOutcome::Open` means that there is none.
    pub(crate) async fn reuse(&self, opening: FrameOpening) -> Result<OpenOutcome> {
        let context = self.context();
        self.database
            .write(Durability::Relaxed, move |connection| {
                Box::pin(async move { frames::open::open_from_cache(connection, &opening, context).await })
            })
            .await
    }

    /// Whether a picture with this cache key is stored.
    pub(crate) async fn has_picture(&self, key: &str) -> Result<bool> {
        jobs::has_picture(self.database.readers(), key).await
    }

    /// Runs a worker's sync: takes results, renews leases, grants work. A claim that fails takes no results with it: then
    /// the worker gets no work, and asks again after a while.
    pub(crate) async fn turn(&self, turn: SyncInput) -> Result<Option<SyncOutcome>> {
        let without_claim = turn.wants_work.then(|| turn.clone().without_claim());
        let synced = match (self.turn_at_once(turn).await, without_claim) {
            (Err(error), Some(without_claim)) if !error.is_unreachable() => {
                let worker = without_claim.worker;
                let synced = self.turn_at_once(without_claim).await?;
                tracing::error!(
                    code = "claim_failed", %worker, %error, cause = ?std::error::Error::source(&error),
                    "a claim failed; its worker gets no work: run `sdfarm doctor`"
                );
                synced.map(SyncOutcome::after_failed_claim)
            }
            (synced, _) => synced?,
        };
        if let Some(synced) = &synced {
            self.wake(synced.woken);
        }
        Ok(synced)
    }

    async fn turn_at_once(&self, mut turn: SyncInput) -> Result<Option<SyncOutcome>> {
        let context = self.context();
        let durability = if turn.has_reports() { Durability::Full } else { Durability::Relaxed };
        self.database
            .write_for_worker(durability, move |connection| {
                Box::pin(async move {
                    servers::doomed::save_results(connection, &mut turn).await?;
                    leases::sync::sync(connection, turn, context).await
                })
            })
            .await
    }

    /// Expires overdue leases and marks lost workers; returns the number of expired leases.
    pub(crate) async fn expire_leases(&self) -> Result<u64> {
        let context = self.context();
        let (count, woken) = self
            .database
            .write_for_worker(Durability::Relaxed, move |connection| {
                Box::pin(async move { leases::rescue(connection, context).await })
            })
            .await?;
        self.wake(woken);
        Ok(count)
    }

    /// Releases overdue verifications, and gives up old ones; returns the number of results that remain unverified.
    pub(crate) async fn expire_verifications(&self) -> Result<u64> {
        let context = self.context();
        let (count, woken) = self
            .database
            .write(Durability::Relaxed, move |connection| {
                Box::pin(async move { verification::expire(connection, context).await })
            })
            .await?;
        self.wake(woken);
        Ok(count)
    }

    /// Cancels a job.
    pub(crate) async fn cancel(&self, job: JobId) -> Result<CancelOutcome> {
        let context = self.context();
        let cancelled = self
            .database
            .write_for_worker(Durability::Full, move |connection| {
                Box::pin(async move { jobs::finish::cancel(connection, job, context).await })
            })
            .await?;
        self.wake(Wake::UPDATES);
        Ok(cancelled)
    }

    /// Fails a job whose file was accepted and cannot be parsed any more.
    pub(crate) async fn fail_unreadable(&self, job: i64, message: String) -> Result<()> {
        tracing::error!(job, error = message, "an accepted job cannot be parsed any more");
        let context = self.context();
        self.database
            .write(Durability::Full, move |connection| {
                Box::pin(async move { jobs::finish::refuse(connection, job, &message, context).await })
            })
            .await?;
        self.wake(Wake { work: true, news: true });
        Ok(())
    }

    /// Deletes a job that is not running. It is hidden when this returns; the rows of a large job are deleted
    /// afterwards.
    pub(crate) async fn delete(&self, job: JobId) -> Result<DeleteOutcome> {
        let context = self.context();
        let deleted = self
            .database
            .write(Durability::Full, move |connection| {
                Box::pin(async move { jobs::finish::delete(connection, job, context).await })
            })
            .await?;
        self.wake_signals.cleanup.notify_one();
        Ok(deleted)
    }

    /// Registers a worker; `None` if its key has too many.
    pub(crate) async fn register(&self, worker: NewWorker) -> Result<Option<Registration>> {
        let context = self.context();
        self.database
            .write_for_worker(Durability::Relaxed, move |connection| {
                Box::pin(async move { workers::register(connection, worker, context).await })
            })
            .await
    }

    /// Asks the pool worker with this process id to drain; false if it has not registered yet.
    pub(crate) async fn drain(&self, process: u32) -> Result<bool> {
        let generation = self.generation;
        let drained = self
            .database
            .write_for_worker(Durability::Relaxed, move |connection| {
                Box::pin(async move { workers::drain(connection, process, generation).await })
            })
            .await?;
        self.wake(Wake::UPDATES);
        Ok(drained)
    }

    /// Records that a pool worker's process has ended, and ends its leases immediately.
    pub(crate) async fn worker_exited(
        &self,
        process: u32,
        cause: LeaseEnd,
        message: String,
    ) -> Result<Option<WorkerId>> {
        let context = self.context();
        let (worker, woken) = self
            .database
            .write_for_worker(Durability::Full, move |connection| {
                Box::pin(async move { workers::reaped(connection, process, cause, &message, context).await })
            })
            .await?;
        self.wake(woken);
        Ok(worker)
    }

    /// Deletes rows of exited workers and of leases past their use.
    pub(crate) async fn prune(&self) -> Result<()> {
        loop {
            let piece_rows = self.piece_rows;
            let more = self
                .database
                .write(Durability::Relaxed, move |connection| {
                    Box::pin(async move { servers::recover::tidy(connection, piece_rows).await })
                })
                .await?;
            if !more {
                return Ok(());
            }
        }
    }

    /// Seconds since 1970, by the wall clock.
    pub(crate) fn wall_seconds(&self) -> i64 {
        self.wall_ms() / 1000
    }

    /// Milliseconds since 1970, by the wall clock.
    pub(crate) fn wall_ms(&self) -> i64 {
        self.clock.wall_ms()
    }

    /// Signal sent after every commit.
    pub(crate) fn commits(&self) -> tokio::sync::watch::Receiver<()> {
        self.database.commit_signal()
    }

    /// Size of the database, unless it is a file.
    pub(crate) async fn database_bytes(&self) -> Result<Option<u64>> {
        self.database.remote_bytes().await
    }

    /// Connections for reading.
    pub(crate) fn readers(&self) -> &db::Readers {
        self.database.readers()
    }
}

/// Id of a job, for logs.
async fn job_id(connection: &mut Connection, job: i64) -> Result<String> {
    db::query_scalar("SELECT id FROM job WHERE number = ?").bind(job).fetch_one(connection).await
}

/// Checks how many rows a transition changed.
fn expect_rows(what: &'static str, expected: u64, changed: db::Changed) -> Result<()> {
    let changed = changed.rows_affected();
    if changed == expected { Ok(()) } else { Err(DatabaseError::Rows { what, expected, changed }) }
}

/// Like [`expect_rows`], of rows that the statement returned.
fn expect_rows_in(what: &'static str, expected: usize, changed: usize) -> Result<()> {
    let (expected, changed) = (expected as u64, changed as u64);
    if changed == expected { Ok(()) } else { Err(DatabaseError::Rows { what, expected, changed }) }
}

/// Converts a number of rows to the database's type.
fn row_count(count: usize) -> i64 {
    (count as u64).cast_signed()
}

/// JSON list of names, as `json_each` reads it, each once: PostgreSQL writes no row twice in one statement.
fn json_list<T: ToString>(items: impl IntoIterator<Item = T>) -> String {
    json_set(items.into_iter().map(|item| item.to_string()))
}

/// Like [`json_list`], of row ids.
fn json_numbers(items: impl IntoIterator<Item = i64>) -> String {
    json_set(items)
}

/// JSON list of different values, in the order of the first of each.
fn json_set<T: Into<serde_json::Value> + Clone + Eq + Hash>(items: impl IntoIterator<Item = T>) -> String {
    let mut known = HashSet::new();
    let items = items.into_iter().filter(|item| known.insert(item.clone()));
    serde_json::Value::Array(items.map(Into::into).collect()).to_string()
}

/// Parses a column with one of our names.
fn parse_column<T>(column: &'static str, value: &str, parse: impl FnOnce(&str) -> Option<T>) -> Result<T> {
    parse(value).ok_or_else(|| DatabaseError::Value { column, value: value.to_owned() })
}
