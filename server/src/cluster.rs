//! This server among the others of its database: it renews its row, tells the others of changes, and hears of theirs.
//!
//! Messages between servers are hints that may be lost. Once a second the database is asked, which decides.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use proto::fail_point::{self, FailPoint};
use tokio_util::sync::CancellationToken;

use crate::counters::ServerCounters;
use crate::db::{Database, DatabaseError, Notifications};
use crate::queue::{Hints, Queue};

/// Interval between two renewals, and two questions to the database.
const INTERVAL: Duration = Duration::from_secs(1);
/// Changes within this time are one message.
const TELL_INTERVAL: Duration = Duration::from_millis(10);
/// Delay before a lost listener is made again.
const LISTEN_AGAIN: Duration = Duration::from_millis(300);

/// Task of a server among others.
#[derive(Debug)]
pub(crate) struct Cluster {
    queue: Queue,
    database: Arc<Database>,
    counters: Arc<ServerCounters>,
}

impl Cluster {
    /// Connects the server of this queue with others.
    pub(crate) fn new(queue: Queue, database: Arc<Database>, counters: Arc<ServerCounters>) -> Self {
        Self { queue, database, counters }
    }

    /// Runs until the server ends; a farm in a file has no other servers.
    pub(crate) async fn run(self, end: CancellationToken) {
        let Some(notifications) = self.database.notifications() else { return };
        let tasks = async { tokio::join!(self.renew(), self.tell(&notifications), self.hear(&notifications)) };
        tokio::select! {
            _ = tasks => {}
            () = end.cancelled() => {}
        }
    }

    /// Renews this server's row, and asks the database what others may have changed.
    async fn renew(&self) {
        let mut ticks = tokio::time::interval(INTERVAL);
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let mut newest = 0;
        loop {
            ticks.tick().await;
            match self.queue.renew_server().await {
                Ok(others) => {
                    self.counters.other_servers.store(others.unsigned_abs(), Ordering::Relaxed);
                    if others > 0
                        && let Err(error) = self.ask(&mut newest).await
                    {
                        tracing::warn!(%error, "could not ask the database for changes of other servers");
                    }
                }
                Err(error) => tracing::warn!(%error, "could not renew this server's row"),
            }
        }
    }

    /// Sends the signals of changes without a message.
    async fn ask(&self, newest: &mut i64) -> Result<(), DatabaseError> {
        let found = self.queue.newest_event().await?;
        if found != *newest {
            *newest = found;
            self.database.announce_commit();
        }
        if self.queue.has_claimable_work().await? {
            self.queue.take_hints(Hints::WORK);
        }
        Ok(())
    }

    /// Tells the others of this server's changes.
    async fn tell(&self, notifications: &Notifications) {
        let mut commits = self.database.own_commit_signal();
        loop {
            tokio::select! {
                changed = commits.changed() => if changed.is_err() { return },
                () = self.queue.hints_added() => {}
            }
            tokio::time::sleep(TELL_INTERVAL).await;
            commits.borrow_and_update();
            let hints = self.queue.drain_hints();
            let has_others = self.counters.other_servers.load(Ordering::Relaxed) > 0;
            if !has_others || fail_point::trigger(FailPoint::Telling).is_err() {
                continue;
            }
            let message = format!("{} {}", self.queue.generation(), hints.as_bits());
            match notifications.send(&message).await {
                Ok(()) => drop(self.counters.hints_sent.fetch_add(1, Ordering::Relaxed)),
                Err(error) => tracing::debug!(%error, "could not tell the other servers of a change"),
            }
        }
    }

    /// Hears of the others' changes.
    async fn hear(&self, notifications: &Notifications) {
        loop {
            if let Err(error) = self.listen(notifications).await {
                tracing::debug!(%error, "cannot hear the other servers");
            }
            tokio::time::sleep(LISTEN_AGAIN).await;
        }
    }

    async fn listen(&self, notifications: &Notifications) -> Result<(), DatabaseError> {
        let mut listener = notifications.listen().await?;
        loop {
            // Without a message, some may have been lost.
            let message = listener.next().await?;
            let hints = match message.as_deref().map(|text| text.split_once(' ')) {
                Some(Some((server, _))) if server.parse() == Ok(self.queue.generation()) => continue,
                Some(Some((_, bits))) => bits.parse().map_or(Hints::ALL, Hints::from_bits),
                Some(None) | None => Hints::ALL,
            };
            self.counters.hints_received.fetch_add(1, Ordering::Relaxed);
            self.database.announce_commit();
            self.queue.take_hints(hints);
        }
    }
}
