//! Sends followers of the whole farm its changes: one task looks for changes and reads the jobs once for all of them.
//!
//! It asks the database for changes after a position, at once after a commit of this server or another, and at least once
//! a second, so that a lost message between servers delays a change but never hides it. Without followers it reads nothing.

mod subscriber;
#[cfg(test)]
mod tests;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use bytes::Bytes;
use proto::event::DeletedEvent;
use proto::farm::FarmCounts;
use serde::Serialize;
use tokio::sync::{broadcast, watch};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use crate::clock::monotonic_now;
use crate::db::DatabaseError;
use crate::queue::{ChangePosition, FarmChanges, Queue};
use crate::telemetry::Telemetry;

pub(crate) use subscriber::FarmSubscriber;

/// Minimum interval between two looks for changes, and so between two views of a job.
const LOOK_INTERVAL: Duration = Duration::from_millis(250);
/// Maximum interval between two looks, and minimum between two counts.
const COUNT_INTERVAL: Duration = Duration::from_secs(1);
/// Number of changed jobs up to which each is sent; if there are more, followers read their lists again.
const MAX_JOBS: usize = 500;
/// Number of batches that a follower may be behind before it has to read its list again.
const MAX_BEHIND: usize = 16;
/// Time without a look after which unsent changes may have been pruned.
const MAX_GAP: Duration = Duration::from_mins(1);

/// An event, and who may see it.
#[derive(Clone, Debug, PartialEq, Eq)]
struct VisibleEvent {
    /// Submitter of the job; `None` if it is an event of the farm, for those who may read it.
    submitter: Option<String>,
    text: Bytes,
}

/// Events that are sent together.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Batch {
    Events(Vec<VisibleEvent>),
    /// Changes that cannot be sent.
    Resync,
}

/// Changes that followers have received.
#[derive(Debug, Default)]
struct Progress {
    position: ChangePosition,
    looked_at: Option<Instant>,
    counts: Option<FarmCounts>,
    counted_at: Option<Instant>,
}

/// Sends followers of the farm its changes.
#[derive(Debug)]
pub(crate) struct FarmEvents {
    queue: Queue,
    telemetry: Arc<Telemetry>,
    progress: Mutex<Progress>,
    batches: broadcast::Sender<Arc<Batch>>,
    follower_added: watch::Sender<()>,
}

/// An event in the form of the HTML standard's event streams, without an id: a client that reconnects reads its list again.
fn encode_event(kind: &str, value: &impl Serialize) -> Bytes {
    let body = serde_json::to_string(value).expect("an event has text as keys");
    format!("event: {kind}\ndata: {body}\n\n").into()
}

impl FarmEvents {
    /// Sends the changes of this queue.
    pub(crate) fn new(queue: Queue, telemetry: Arc<Telemetry>) -> Self {
        let batches = broadcast::Sender::new(MAX_BEHIND);
        Self { queue, telemetry, progress: Mutex::default(), batches, follower_added: watch::Sender::new(()) }
    }

    /// The farm's numbers, and a receiver of everything that changes after this call has returned.
    async fn receive(&self) -> Result<(FarmCounts, broadcast::Receiver<Arc<Batch>>), DatabaseError> {
        let counts = self.telemetry.farm_counts().await?;
        let newest = self.queue.newest_change().await?;
        let mut progress = self.progress.lock().expect("no holder panics");
        if self.batches.receiver_count() == 0 {
            *progress = Progress {
                position: newest,
                looked_at: Some(monotonic_now()),
                counts: Some(counts),
                ..Progress::default()
            };
        }
        let receiver = self.batches.subscribe();
        drop(progress);
        // Commits since `newest` was read have already sent their signal.
        self.follower_added.send_replace(());
        Ok((counts, receiver))
    }

    /// Sends changes until the farm shuts down.
    pub(crate) async fn run(&self, end: CancellationToken) {
        let mut commits = self.queue.commits();
        let mut wanted = self.follower_added.subscribe();
        loop {
            let has_followers = self.batches.receiver_count() > 0;
            tokio::select! {
                () = end.cancelled() => return,
                changed = commits.changed(), if has_followers => if changed.is_err() { return },
                changed = wanted.changed() => if changed.is_err() { return },
                () = tokio::time::sleep(COUNT_INTERVAL), if has_followers => {}
            }
            let started = monotonic_now();
            if let Err(error) = self.look().await {
                tracing::error!(%error, "could not read what has changed");
            }
            tokio::select! {
                () = end.cancelled() => return,
                () = tokio::time::sleep_until(started + LOOK_INTERVAL) => {}
            }
        }
    }

    /// Sends all changes since the last look.
    async fn look(&self) -> Result<(), DatabaseError> {
        let (position, looked_at) = {
            let progress = self.progress.lock().expect("no holder panics");
            if self.batches.receiver_count() == 0 {
                return Ok(());
            }
            (progress.position, progress.looked_at)
        };
        let begun = monotonic_now();
        let mut changes = self.queue.changes_after(position).await?;
        let mut batches = Vec::new();
        if changes.jobs.len() + changes.deleted.len() > MAX_JOBS || looked_at.is_none_or(|at| begun - at > MAX_GAP) {
            changes = FarmChanges { position: self.queue.newest_change().await?, ..FarmChanges::default() };
            batches.push(Batch::Resync);
        } else {
            let events = self.events(&changes).await?;
            batches.extend((!events.is_empty()).then_some(Batch::Events(events)));
        }
        {
            let mut progress = self.progress.lock().expect("no holder panics");
            // The last follower has left, and another has come: it reads all this in its list.
            if progress.position != position {
                return Ok(());
            }
            (progress.position, progress.looked_at) = (changes.position, Some(begun));
        }
        for batch in batches {
            // Without receivers nothing is sent.
            let _ = self.batches.send(Arc::new(batch));
        }
        self.count().await
    }

    /// Events of changes.
    async fn events(&self, changes: &FarmChanges) -> Result<Vec<VisibleEvent>, DatabaseError> {
        let jobs = self.queue.jobs_numbered(&changes.jobs).await?;
        let jobs = jobs
            .iter()
            .map(|job| VisibleEvent { submitter: Some(job.submitter.clone()), text: encode_event("job", job) });
        let deleted = changes.deleted.iter().map(|job| {
            let event = DeletedEvent { id: job.id.clone() };
            VisibleEvent { submitter: Some(job.submitter.clone()), text: encode_event("deleted", &event) }
        });
        Ok(jobs.chain(deleted).collect())
    }

    /// Sends the farm's numbers if they have changed. No event of a job has the change of its view by a pause.
    async fn count(&self) -> Result<(), DatabaseError> {
        let now = monotonic_now();
        if self.progress.lock().expect("no holder panics").counted_at.is_some_and(|at| now - at < COUNT_INTERVAL) {
            return Ok(());
        }
        let counts = self.telemetry.farm_counts().await?;
        let before = {
            let mut progress = self.progress.lock().expect("no holder panics");
            progress.counted_at = Some(now);
            progress.counts.replace(counts)
        };
        if before == Some(counts) {
            return Ok(());
        }
        let event = VisibleEvent { submitter: None, text: encode_event("farm", &counts) };
        let _ = self.batches.send(Arc::new(Batch::Events(vec![event])));
        if before.is_some_and(|before| before.paused != counts.paused) {
            let _ = self.batches.send(Arc::new(Batch::Resync));
        }
        Ok(())
    }
}
