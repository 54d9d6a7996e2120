//! The one connection that writes: a task that commits waiting operations together.
//!
//! Each operation runs under its own SAVEPOINT, so that a failing one affects no other. No operation waits for
//! more of them: a single operation is committed at once.

use std::time::Duration;

use futures_util::future::BoxFuture;
use prometheus_client::metrics::histogram::Histogram;
use proto::fail_point::{self, FailPoint};
use sqlx::Connection;
use sqlx::sqlite::SqliteConnection;
use tokio::sync::{Mutex, mpsc, oneshot, watch};
use tokio::task::JoinHandle;

use super::DatabaseError;
use super::wal::Wal;
use crate::clock::monotonic_now;
use crate::telemetry::{counts, seconds};

/// Maximum number of operations committed together.
const MAX_GROUP: usize = 256;
/// Maximum number of waiting operations; beyond it callers wait.
const QUEUE_CAPACITY: usize = 1024;
/// After this long without writes, the WAL is checkpointed.
const IDLE: Duration = Duration::from_secs(5);

/// Whether an operation must survive a power cut once it has returned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Durability {
    /// Durable: the commit is fsynced.
    Full,
    /// Not durable on return: the next durable commit includes it.
    Relaxed,
}

/// Durations of commits.
#[derive(Clone, Debug)]
pub(crate) struct CommitTimes {
    /// Duration of each commit.
    pub(crate) seconds: Histogram,
    /// Number of operations in each commit.
    pub(crate) operations: Histogram,
}

impl Default for CommitTimes {
    fn default() -> Self {
        Self { seconds: seconds(), operations: counts() }
    }
}

/// Handle to the writer task; clones of its channel queue operations.
#[derive(Debug)]
pub(super) struct Writer {
    operations: std::sync::Mutex<Option<mpsc::Sender<Box<dyn WriteOperation>>>>,
    task: Mutex<Option<JoinHandle<()>>>,
    bell: watch::Sender<()>,
}

impl Writer {
    /// Starts the task that owns `connection`.
    pub(super) fn start(connection: SqliteConnection, times: CommitTimes, log: Wal) -> Self {
        let (operations, waiting) = mpsc::channel(QUEUE_CAPACITY);
        let bell = watch::Sender::new(());
        let task = WriterTask { connection, synchronous: Durability::Full, times, bell: bell.clone(), log };
        let task = tokio::spawn(task.run(waiting));
        Self { operations: std::sync::Mutex::new(Some(operations)), task: Mutex::new(Some(task)), bell }
    }

    /// Runs one operation; see [`super::Database::write`].
    pub(super) async fn write<T, F>(&self, durability: Durability, work: F) -> Result<T, DatabaseError>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut SqliteConnection) -> BoxFuture<'c, Result<T, DatabaseError>> + Send + 'static,
    {
        let sender = self.operations.lock().expect("no holder panics").clone().ok_or(DatabaseError::Closed)?;
        let (reply, answer) = oneshot::channel();
        let waiting = PendingWrite { durability, work: Some(work), result: None, reply };
        sender.send(Box::new(waiting)).await.map_err(|_| DatabaseError::Closed)?;
        answer.await.map_err(|_| DatabaseError::Closed)?
    }

    /// Signal sent after every commit.
    pub(super) fn bell(&self) -> watch::Receiver<()> {
        self.bell.subscribe()
    }

    /// Stops the task after the waiting operations.
    pub(super) async fn close(&self) {
        drop(self.operations.lock().expect("no holder panics").take());
        if let Some(task) = self.task.lock().await.take()
            && let Err(error) = task.await
        {
            tracing::error!(%error, "the database's writer panicked");
        }
    }
}

/// Operation waiting for the writer.
trait WriteOperation: Send {
    fn durability(&self) -> Durability;
    /// Runs it; if this returns false, it must be rolled back.
    fn run<'c>(&'c mut self, connection: &'c mut SqliteConnection) -> BoxFuture<'c, bool>;
    /// Whether it failed because the disk is full.
    fn has_found_disk_full(&self) -> bool;
    /// Sends the result to the caller, once the transaction has ended.
    fn reply(self: Box<Self>, committed: Result<(), DatabaseError>);
}

struct PendingWrite<T, F> {
    durability: Durability,
    work: Option<F>,
    result: Option<Result<T, DatabaseError>>,
    reply: oneshot::Sender<Result<T, DatabaseError>>,
}

impl<T, F> WriteOperation for PendingWrite<T, F>
where
    T: Send,
    F: for<'c> FnOnce(&'c mut SqliteConnection) -> BoxFuture<'c, Result<T, DatabaseError>> + Send,
{
    fn durability(&self) -> Durability {
        self.durability
    }

    fn run<'c>(&'c mut self, connection: &'c mut SqliteConnection) -> BoxFuture<'c, bool> {
        Box::pin(async move {
            let work = self.work.take().expect("an operation runs once");
            let result = match fail_point::trigger(FailPoint::DatabaseWrite) {
                Ok(()) => work(connection).await,
                Err(struck) => Err(struck_down(struck)),
            };
            let keep = result.is_ok();
            self.result = Some(result);
            keep
        })
    }

    fn has_found_disk_full(&self) -> bool {
        matches!(&self.result, Some(Err(error)) if error.is_full())
    }

    fn reply(self: Box<Self>, committed: Result<(), DatabaseError>) {
        let result = match (committed, self.result) {
            (Ok(()), Some(result)) => result,
            (Ok(()), None) => Err(DatabaseError::Closed),
            (Err(_), Some(Err(error))) | (Err(error), _) => Err(error),
        };
        // A caller that no longer waits wanted the effect, not the result.
        drop(self.reply.send(result));
    }
}

struct WriterTask {
    connection: SqliteConnection,
    synchronous: Durability,
    times: CommitTimes,
    bell: watch::Sender<()>,
    log: Wal,
}

impl WriterTask {
    async fn run(mut self, mut waiting: mpsc::Receiver<Box<dyn WriteOperation>>) {
        let mut folded = true;
        loop {
            let first = if folded {
                waiting.recv().await
            } else if let Ok(next) = tokio::time::timeout(IDLE, waiting.recv()).await {
                next
            } else {
                self.checkpoint().await;
                folded = true;
                continue;
            };
            let Some(first) = first else { break };
            let mut group = vec![first];
            while group.len() < MAX_GROUP
                && let Ok(next) = waiting.try_recv()
            {
                group.push(next);
            }
            let committed = self.commit(&mut group).await;
            let is_full = committed.as_ref().is_err_and(DatabaseError::is_full);
            if is_full || group.iter().any(|operation| operation.has_found_disk_full()) {
                // A shorter WAL leaves room for the operations that delete something.
                self.checkpoint().await;
            }
            self.bell.send_replace(());
            fail_point::trigger_infallible(FailPoint::GroupCommitted);
            for operation in group {
                operation.reply(committed.clone());
            }
            self.log.checkpoint_if_large(&mut self.connection).await;
            folded = false;
        }
        self.checkpoint().await;
        if let Err(error) = self.connection.close().await {
            tracing::error!(%error, "could not close the database");
        }
    }

    async fn commit(&mut self, group: &mut [Box<dyn WriteOperation>]) -> Result<(), DatabaseError> {
        let begun = monotonic_now();
        let done = self.run_group(group).await;
        self.times.seconds.observe(begun.elapsed().as_secs_f64());
        self.times.operations.observe(group.len() as f64);
        if done.is_err() {
            // SQLite ends a transaction automatically after some errors; then there is nothing to roll back.
            drop(sqlx::query("ROLLBACK").execute(&mut self.connection).await);
        }
        done
    }

    /// Statements between two operations are sent to the engine together, because each call of its thread
    /// costs two context switches.
    async fn run_group(&mut self, group: &mut [Box<dyn WriteOperation>]) -> Result<(), DatabaseError> {
        let durable = group.iter().any(|operation| operation.durability() == Durability::Full);
        self.begin(if durable { Durability::Full } else { Durability::Relaxed }).await?;
        let last = group.len() - 1;
        for (index, operation) in group.iter_mut().enumerate() {
            let is_kept = operation.run(&mut self.connection).await;
            let next = match (is_kept, index == last) {
                (true, true) => continue,
                (false, true) => "ROLLBACK TO operation",
                (true, false) => "RELEASE operation; SAVEPOINT operation",
                (false, false) => "ROLLBACK TO operation; RELEASE operation; SAVEPOINT operation",
            };
            sqlx::query(next).execute(&mut self.connection).await?;
        }
        fail_point::trigger(FailPoint::DatabaseCommit).map_err(struck_down)?;
        // Releases the last savepoint as well.
        sqlx::query("COMMIT").execute(&mut self.connection).await?;
        Ok(())
    }

    /// Begins a transaction, and its first operation's savepoint.
    async fn begin(&mut self, durability: Durability) -> Result<(), DatabaseError> {
        let begin = match durability {
            _ if durability == self.synchronous => "BEGIN IMMEDIATE; SAVEPOINT operation",
            Durability::Full => "PRAGMA synchronous = FULL; BEGIN IMMEDIATE; SAVEPOINT operation",
            Durability::Relaxed => "PRAGMA synchronous = NORMAL; BEGIN IMMEDIATE; SAVEPOINT operation",
        };
        // If it fails half-way the setting is unknown: the weaker one is assumed.
        self.synchronous = Durability::Relaxed;
        sqlx::query(begin).execute(&mut self.connection).await?;
        self.synchronous = durability;
        Ok(())
    }

    async fn checkpoint(&mut self) {
        if let Err(error) = sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(&mut self.connection).await {
            tracing::warn!(%error, "could not checkpoint the database's WAL");
        }
    }
}

/// Write error caused by a triggered fail point.
fn struck_down(struck: fail_point::FailPointError) -> DatabaseError {
    sqlx::Error::Io(std::io::Error::other(struck)).into()
}
