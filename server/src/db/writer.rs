//! The one connection that writes: a task that commits waiting operations together.
//!
//! Each operation runs under its own SAVEPOINT, so that a failing one affects no other. No operation waits for
//! more of them: a single operation is committed at once. Operations of workers run first, and all others have a
//! bounded part of a transaction, so that a claim never waits for a flood of submissions.

use std::collections::VecDeque;
use std::sync::atomic::AtomicU64;
use std::time::Duration;

use futures_util::future::BoxFuture;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use proto::fail_point::{self, FailPoint};
use tokio::sync::{Mutex, mpsc, oneshot, watch};
use tokio::task::JoinHandle;
use tokio::time::Instant;

use super::transaction::WritingConnection;
use super::{Connection, DatabaseError};
use crate::clock::monotonic_now;
use crate::histograms::{counts, seconds};

/// Maximum number of operations committed together.
const MAX_GROUP: usize = 256;
/// After this time, no further operation joins a transaction.
const MAX_GROUP_TIME: Duration = Duration::from_millis(20);
/// Part of a transaction that operations other than the workers' get, if several wait: after this time, the rest waits
/// for the next transaction.
const MAX_ORDINARY_TIME: Duration = Duration::from_millis(10);
/// Maximum number of waiting operations of each urgency; beyond it callers wait.
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

/// Which operations run first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Urgency {
    /// Claims, results, renewals, cancels: what workers wait for.
    Worker,
    /// Everything else.
    Ordinary,
}

/// Durations of transactions.
#[derive(Clone, Debug)]
pub(crate) struct CommitTimes {
    /// Duration of each transaction, with its commit.
    pub(crate) seconds: Histogram,
    /// Longest duration since the start, in seconds.
    pub(crate) longest_seconds: Gauge<f64, AtomicU64>,
    /// Number of operations in each commit.
    pub(crate) operations: Histogram,
    /// Time until each transaction has begun.
    pub(crate) begin_seconds: Histogram,
    /// Number of connections to a PostgreSQL server that ended.
    pub(crate) connections_lost: Counter,
}

impl Default for CommitTimes {
    fn default() -> Self {
        Self {
            seconds: seconds(),
            longest_seconds: Gauge::default(),
            operations: counts(),
            begin_seconds: seconds(),
            connections_lost: Counter::default(),
        }
    }
}

/// Channels on which operations wait, by urgency.
#[derive(Clone, Debug)]
struct Senders {
    worker: mpsc::Sender<Box<dyn WriteOperation>>,
    ordinary: mpsc::Sender<Box<dyn WriteOperation>>,
}

/// Handle to the writer task; clones of its channels queue operations.
#[derive(Debug)]
pub(super) struct Writer {
    operations: std::sync::Mutex<Option<Senders>>,
    task: Mutex<Option<JoinHandle<()>>>,
    signals: ChangeSignals,
}

/// Signals of commits.
#[derive(Clone, Debug, Default)]
struct ChangeSignals {
    /// Every commit that is known.
    every: watch::Sender<()>,
    /// Commits of this writer.
    own: watch::Sender<()>,
}

impl Writer {
    /// Starts the task that owns `connection`.
    pub(super) fn start(connection: WritingConnection, times: CommitTimes) -> Self {
        let (worker, urgent) = mpsc::channel(QUEUE_CAPACITY);
        let (ordinary, rest) = mpsc::channel(QUEUE_CAPACITY);
        let waiting = Waiting { urgent: WaitingQueue::new(urgent), ordinary: WaitingQueue::new(rest) };
        let signals = ChangeSignals::default();
        let task = WriterTask { connection, times, signals: signals.clone() };
        let task = tokio::spawn(task.run(waiting));
        let operations = Senders { worker, ordinary };
        Self { operations: std::sync::Mutex::new(Some(operations)), task: Mutex::new(Some(task)), signals }
    }

    /// Runs one operation; see [`super::Database::write`].
    pub(super) async fn write<T, F>(
        &self,
        urgency: Urgency,
        durability: Durability,
        work: F,
    ) -> Result<T, DatabaseError>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut Connection) -> BoxFuture<'c, Result<T, DatabaseError>> + Send + 'static,
    {
        let senders = self.operations.lock().expect("no holder panics").clone().ok_or(DatabaseError::Closed)?;
        let sender = match urgency {
            Urgency::Worker => senders.worker,
            Urgency::Ordinary => senders.ordinary,
        };
        let (reply, answer) = oneshot::channel();
        let waiting = PendingWrite { durability, work: Some(work), result: None, reply };
        sender.send(Box::new(waiting)).await.map_err(|_| DatabaseError::Closed)?;
        answer.await.map_err(|_| DatabaseError::Closed)?
    }

    /// Signal sent after every commit, and by [`Writer::signal`].
    pub(super) fn changes(&self) -> watch::Receiver<()> {
        self.signals.every.subscribe()
    }

    /// Signal sent after every commit of this writer.
    pub(super) fn own_changes(&self) -> watch::Receiver<()> {
        self.signals.own.subscribe()
    }

    /// Signals a commit that was made elsewhere.
    pub(super) fn signal(&self) {
        self.signals.every.send_replace(());
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
    fn run<'c>(&'c mut self, connection: &'c mut Connection) -> BoxFuture<'c, bool>;
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
    F: for<'c> FnOnce(&'c mut Connection) -> BoxFuture<'c, Result<T, DatabaseError>> + Send,
{
    fn durability(&self) -> Durability {
        self.durability
    }

    fn run<'c>(&'c mut self, connection: &'c mut Connection) -> BoxFuture<'c, bool> {
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

/// Operations of one urgency: those that an earlier transaction left, then those in the channel.
struct WaitingQueue {
    left: VecDeque<Box<dyn WriteOperation>>,
    channel: mpsc::Receiver<Box<dyn WriteOperation>>,
}

impl WaitingQueue {
    fn new(channel: mpsc::Receiver<Box<dyn WriteOperation>>) -> Self {
        Self { left: VecDeque::new(), channel }
    }

    /// Takes waiting operations out of the channel.
    fn fill(&mut self) {
        while self.left.len() < MAX_GROUP
            && let Ok(next) = self.channel.try_recv()
        {
            self.left.push_back(next);
        }
    }

    fn is_durable(&self) -> bool {
        self.left.iter().any(|operation| operation.durability() == Durability::Full)
    }
}

/// All waiting operations.
struct Waiting {
    urgent: WaitingQueue,
    ordinary: WaitingQueue,
}

impl Waiting {
    /// Waits for an operation, and takes in all that wait with it; false if there will be none.
    async fn fill(&mut self) -> bool {
        if self.is_empty() {
            tokio::select! {
                Some(next) = self.urgent.channel.recv() => self.urgent.left.push_back(next),
                Some(next) = self.ordinary.channel.recv() => self.ordinary.left.push_back(next),
                else => return false,
            }
        }
        self.urgent.fill();
        self.ordinary.fill();
        true
    }

    fn is_empty(&self) -> bool {
        self.urgent.left.is_empty() && self.ordinary.left.is_empty()
    }
}

/// Chooses the operations of one transaction: the workers' first, and at least one of the others.
struct Turn {
    begun: Instant,
    /// Start of the first ordinary operation.
    ordinary_begun: Option<Instant>,
    count: usize,
}

impl Turn {
    fn next(&mut self, waiting: &mut Waiting) -> Option<Box<dyn WriteOperation>> {
        let now = monotonic_now();
        let is_over = self.count >= MAX_GROUP || now - self.begun >= MAX_GROUP_TIME;
        let next = match self.ordinary_begun {
            None => match waiting.urgent.left.pop_front() {
                Some(next) if self.count == 0 || !is_over => Some(next),
                left => {
                    if let Some(left) = left {
                        waiting.urgent.left.push_front(left);
                    }
                    self.ordinary_begun = Some(now);
                    waiting.ordinary.left.pop_front()
                }
            },
            Some(begun) if is_over || now - begun >= MAX_ORDINARY_TIME => None,
            Some(_) => waiting.ordinary.left.pop_front(),
        };
        self.count += usize::from(next.is_some());
        next
    }
}

struct WriterTask {
    connection: WritingConnection,
    times: CommitTimes,
    signals: ChangeSignals,
}

impl WriterTask {
    async fn run(mut self, mut waiting: Waiting) {
        let mut folded = true;
        loop {
            if folded {
                if !waiting.fill().await {
                    break;
                }
            } else {
                match tokio::time::timeout(IDLE, waiting.fill()).await {
                    Ok(true) => {}
                    Ok(false) => break,
                    Err(_) => {
                        self.connection.checkpoint().await;
                        folded = true;
                        continue;
                    }
                }
            }
            let (group, committed) = self.commit(&mut waiting).await;
            let is_full = committed.as_ref().is_err_and(DatabaseError::is_full);
            if is_full || group.iter().any(|operation| operation.has_found_disk_full()) {
                // A shorter WAL leaves room for the operations that delete something.
                self.connection.checkpoint().await;
            }
            self.signals.every.send_replace(());
            self.signals.own.send_replace(());
            fail_point::trigger_infallible(FailPoint::GroupCommitted);
            for operation in group {
                operation.reply(committed.clone());
            }
            self.connection.checkpoint_if_large().await;
            folded = false;
        }
        self.connection.checkpoint().await;
        if let Err(error) = self.connection.close().await {
            tracing::error!(%error, "could not close the database");
        }
    }

    /// Runs and commits some of the waiting operations, which it returns with the outcome.
    async fn commit(&mut self, waiting: &mut Waiting) -> (Vec<Box<dyn WriteOperation>>, Result<(), DatabaseError>) {
        let begun = monotonic_now();
        let mut group = Vec::new();
        let done = self.run_group(waiting, &mut group).await;
        let took_seconds = begun.elapsed().as_secs_f64();
        self.times.seconds.observe(took_seconds);
        self.times.longest_seconds.set(self.times.longest_seconds.get().max(took_seconds));
        self.times.operations.observe(group.len() as f64);
        if done.is_err() {
            self.connection.roll_back().await;
        }
        (group, done)
    }

    async fn run_group(
        &mut self,
        waiting: &mut Waiting,
        group: &mut Vec<Box<dyn WriteOperation>>,
    ) -> Result<(), DatabaseError> {
        let durable = waiting.urgent.is_durable() || waiting.ordinary.is_durable();
        let begin = monotonic_now();
        let begun = self.connection.begin(if durable { Durability::Full } else { Durability::Relaxed }).await;
        self.times.begin_seconds.observe(begin.elapsed().as_secs_f64());
        let limit = self.connection.time_limit();
        let operations = self.run_operations(waiting, group, begun);
        match limit {
            None => operations.await?,
            Some(limit) => match tokio::time::timeout(limit, operations).await {
                Ok(done) => done?,
                Err(_) => return Err(self.connection.give_up().await),
            },
        }
        fail_point::trigger(FailPoint::DatabaseCommit).map_err(struck_down)?;
        self.connection.commit().await
    }

    /// Runs some of the waiting operations in the transaction that has begun; if it has not, the first one fails.
    async fn run_operations(
        &mut self,
        waiting: &mut Waiting,
        group: &mut Vec<Box<dyn WriteOperation>>,
        begun: Result<(), DatabaseError>,
    ) -> Result<(), DatabaseError> {
        let mut turn = Turn { begun: monotonic_now(), ordinary_begun: None, count: 0 };
        let mut was_kept = None;
        while let Some(operation) = turn.next(waiting) {
            group.push(operation);
            if let Err(error) = &begun {
                return Err(error.clone());
            }
            if let Some(was_kept) = was_kept {
                self.connection.next_operation(was_kept).await?;
            }
            let operation = group.last_mut().expect("it was just added");
            was_kept = Some(operation.run(self.connection.connection()).await);
        }
        if was_kept == Some(false) {
            self.connection.undo_operation().await?;
        }
        Ok(())
    }
}

/// Write error caused by a triggered fail point.
fn struck_down(struck: fail_point::FailPointError) -> DatabaseError {
    sqlx::Error::Io(std::io::Error::other(struck)).into()
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use futures_util::future::BoxFuture;
    use tokio::sync::oneshot;

    use crate::db::{Connection, Database, DatabaseError, Durability};

    /// Operation that records that it ran.
    fn record(
        order: &Arc<Mutex<Vec<&'static str>>>,
        name: &'static str,
    ) -> impl for<'c> FnOnce(&'c mut Connection) -> BoxFuture<'c, Result<(), DatabaseError>> + Send + 'static {
        let order = Arc::clone(order);
        move |_| {
            Box::pin(async move {
                order.lock().expect("no holder panics").push(name);
                Ok(())
            })
        }
    }

    #[tokio::test]
    async fn what_workers_wait_for_runs_before_a_flood_of_submissions() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let store = Arc::new(Database::open(folder.path()).await.expect("opens"));
        let order: Arc<Mutex<Vec<&str>>> = Arc::default();
        let (begun, has_begun) = oneshot::channel();
        let (release, released) = oneshot::channel::<()>();
        let gate = store.write(Durability::Relaxed, move |_| {
            Box::pin(async move {
                begun.send(()).expect("the test waits");
                released.await.expect("released");
                Ok(())
            })
        });
        let flood = futures_util::future::join_all(
            (0..50).map(|_| store.write(Durability::Full, record(&order, "submission"))),
        );
        let claims = futures_util::future::join_all(
            (0..3).map(|_| store.write_for_worker(Durability::Relaxed, record(&order, "claim"))),
        );
        let others = async {
            has_begun.await.expect("begins");
            // Both are polled, so that all operations wait, before the first one is released.
            let all = futures_util::future::join(flood, claims);
            tokio::pin!(all);
            assert!(futures_util::poll!(all.as_mut()).is_pending());
            release.send(()).expect("it waits");
            all.await
        };
        let (gate, (flood, claims)) = futures_util::future::join(gate, others).await;
        gate.expect("runs");
        assert!(flood.iter().chain(&claims).all(Result::is_ok));
        let order = order.lock().expect("no holder panics").clone();
        assert_eq!(order[..3], ["claim"; 3], "{order:?}");
        assert_eq!(order.len(), 53);
    }
}
