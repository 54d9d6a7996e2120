//! Properties that the API cannot show quickly: old events are pruned, and slow subscribers miss none.

use proto::JobId;
use proto::event::{Snapshot, SseMessage, SseParser};
use proto::job::JobState;
use tokio_util::sync::CancellationToken;

use super::{EventHub, EventSubscriber, MAX_RECENT, SubscribeOutcome};
use crate::clock::{Clock, ManualClock};
use crate::db;
use crate::db::{Database, Durability};
use crate::queue::{NewJob, Queue};

struct Fixture {
    queue: Queue,
    events: EventHub,
    hand: ManualClock,
    store: std::sync::Arc<Database>,
    _folder: tempfile::TempDir,
}

impl Fixture {
    async fn new() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let store = std::sync::Arc::new(Database::open(folder.path()).await.expect("opens"));
        let (clock, hand) = Clock::manual();
        let (queue, _) = Queue::open(std::sync::Arc::clone(&store), clock, 1000, "test").await.expect("opens");
        Self { events: EventHub::new(queue.clone()), queue, hand, store, _folder: folder }
    }

    async fn submit(&self) -> JobId {
        let new = NewJob::example();
        let id = new.id;
        self.queue.submit(new).await.expect("accepted");
        id
    }

    /// Inserts many events at once, in the form that the queue writes.
    async fn happen(&self, job: i64, count: usize) {
        self.store
            .write(Durability::Relaxed, move |connection| {
                Box::pin(async move {
                    let list = serde_json::json!((0..count).collect::<Vec<_>>()).to_string();
                    db::query(
                        "INSERT INTO outbox (job, kind, body)
                         SELECT ?, 'tile', CAST(value AS TEXT) FROM @numbers(?) ORDER BY listed.value",
                    )
                    .bind(job)
                    .bind(list)
                    .execute(connection)
                    .await?;
                    Ok(())
                })
            })
            .await
            .expect("written");
    }

    async fn follow(&self, job: JobId, after: Option<i64>) -> Option<Box<EventSubscriber>> {
        match EventSubscriber::start(&self.events, job, after, CancellationToken::new()).await.expect("reads") {
            SubscribeOutcome::Subscribed(follower) => Some(follower),
            SubscribeOutcome::Ended | SubscribeOutcome::UnknownJob => None,
        }
    }
}

/// Messages that a subscriber receives, up to `count`.
async fn received(follower: &mut EventSubscriber, count: usize) -> Vec<SseMessage> {
    let (mut lines, mut messages) = (SseParser::default(), Vec::new());
    while messages.len() < count
        && let Some(bytes) = follower.next().await.expect("reads")
    {
        messages.extend(lines.push(&bytes));
    }
    messages
}

#[tokio::test]
async fn a_slow_subscriber_reads_missed_events_from_the_database() {
    let bench = Fixture::new().await;
    let id = bench.submit().await;
    let job = bench.queue.event_position(id, 0).await.expect("reads").expect("there").job;
    let mut slow = bench.follow(id, None).await.expect("a job");
    let mut quick = bench.follow(id, None).await.expect("a job");
    assert_eq!(received(&mut quick, 1).await[0].event, "state");
    for _ in 0..3 {
        bench.happen(job, MAX_RECENT).await;
        bench.events.publish().await.expect("publishes");
        assert_eq!(received(&mut quick, MAX_RECENT).await.len(), MAX_RECENT);
    }
    let all = received(&mut slow, 3 * MAX_RECENT + 1).await;
    let bodies: Vec<usize> = all[1..].iter().map(|message| message.data.parse().expect("a number")).collect();
    assert_eq!(bodies, (0..3 * MAX_RECENT).map(|number| number % MAX_RECENT).collect::<Vec<_>>());
}

#[tokio::test]
async fn events_of_old_finished_jobs_are_replaced_by_a_snapshot() {
    let bench = Fixture::new().await;
    let (old, open) = (bench.submit().await, bench.submit().await);
    bench.queue.cancel(old).await.expect("cancels");
    bench.hand.advance(std::time::Duration::from_hours(23));
    assert_eq!(bench.queue.prune_events().await.expect("prunes"), 0);
    bench.hand.advance(std::time::Duration::from_hours(2));
    assert_eq!(bench.queue.prune_events().await.expect("prunes"), 2, "one job's");
    let mut follower = bench.follow(old, None).await.expect("a snapshot");
    let story = received(&mut follower, usize::MAX).await;
    let snapshot: Snapshot = serde_json::from_str(&story[0].data).expect("a snapshot");
    assert_eq!((story.len(), snapshot.state), (1, JobState::Cancelled));
    let after = story[0].id.as_ref().and_then(|id| id.parse().ok());
    assert!(bench.follow(old, after).await.is_none(), "nothing follows the snapshot");
    let mut follower = bench.follow(open, None).await.expect("its events are kept");
    assert_eq!(received(&mut follower, 1).await[0].event, "state");
}

#[tokio::test]
async fn the_oldest_events_beyond_the_maximum_are_pruned() {
    let bench = Fixture::new().await;
    let id = bench.submit().await;
    let job = bench.queue.event_position(id, 0).await.expect("reads").expect("there").job;
    bench.happen(job, 100).await;
    let dropped = bench.queue.prune_surplus(10).await.expect("prunes");
    assert_eq!(dropped, 91);
    let mut follower = bench.follow(id, Some(50)).await.expect("a snapshot");
    assert_eq!(received(&mut follower, 1).await[0].event, "snapshot");
    let mut follower = bench.follow(id, Some(91)).await.expect("nothing was missed");
    assert_eq!(received(&mut follower, 10).await.len(), 10);
}

/// A backup is restored, and events that clients have received are undone.
#[tokio::test]
async fn a_client_that_has_seen_undone_events_gets_a_snapshot() {
    let bench = Fixture::new().await;
    let id = bench.submit().await;
    let job = bench.queue.event_position(id, 0).await.expect("reads").expect("there").job;
    bench.happen(job, 10).await;
    let restored = bench.store.write(Durability::Full, |connection| {
        Box::pin(async move {
            db::query("DELETE FROM outbox WHERE number > 6").execute(&mut *connection).await?;
            crate::queue::mark_restored(connection).await
        })
    });
    restored.await.expect("written");
    let (queue, _) =
        Queue::open(std::sync::Arc::clone(&bench.store), Clock::manual().0, 1000, "test").await.expect("opens");
    let bench = Fixture { events: EventHub::new(queue.clone()), queue, ..bench };
    bench.happen(job, 10).await;
    let mut follower = bench.follow(id, Some(6)).await.expect("nothing was missed");
    let numbers: Vec<i64> = received(&mut follower, 10)
        .await
        .iter()
        .map(|received| received.id.as_deref().expect("an id").parse().expect("a number"))
        .collect();
    assert_eq!(numbers, ((1 << 32)..(1 << 32) + 10).collect::<Vec<i64>>());
    for undone in [7, 11, 12, (1 << 32) - 1] {
        let mut follower = bench.follow(id, Some(undone)).await.expect("a snapshot");
        let first = received(&mut follower, 1).await.remove(0);
        assert_eq!((first.event.as_str(), first.id), ("snapshot", Some(((1_i64 << 32) + 9).to_string())));
    }
    // Another start is no restore.
    let opened =
        Queue::open(std::sync::Arc::clone(&bench.store), Clock::manual().0, 1000, "test").await.expect("opens");
    drop(opened);
    bench.happen(job, 1).await;
    assert_eq!(bench.queue.newest_event().await.expect("reads"), (1 << 32) + 10);
}
