//! Properties that the API cannot show quickly: slow followers, changes of other servers, and changes that followers do not see.

use std::sync::Arc;
use std::time::Duration;

use proto::JobId;
use proto::event::{FarmEvent, SseParser};
use proto::job::JobPatch;
use tokio_util::sync::CancellationToken;

use super::{FarmEvents, FarmSubscriber, MAX_BEHIND, MAX_JOBS};
use crate::blobs::{BlobStore, StoreLocation};
use crate::clock::Clock;
use crate::db::{Database, Sharing};
use crate::postgres_server;
use crate::queue::{NewJob, Queue};
use crate::telemetry::Telemetry;

const DEADLINE: Duration = Duration::from_secs(30);

struct Fixture {
    queue: Queue,
    /// The queue of another server, on PostgreSQL with connections of its own.
    other: Queue,
    events: Arc<FarmEvents>,
    _folder: tempfile::TempDir,
}

impl Fixture {
    async fn new() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let open = async || match postgres_server::database_of(folder.path()) {
            Some(address) => {
                let address = address.parse().expect("an address");
                Some(Arc::new(Database::open_postgres(&address, Sharing::Shared).await.expect("opens")))
            }
            None => None,
        };
        let database = match open().await {
            Some(shared) => shared,
            None => Arc::new(Database::open(folder.path()).await.expect("opens")),
        };
        let others = open().await.unwrap_or_else(|| Arc::clone(&database));
        let clock = Clock::manual_lasting().0;
        let (queue, _) = Queue::open(Arc::clone(&database), clock.clone(), 1000, "one").await.expect("opens");
        let (other, _) = Queue::open(others, clock, 1000, "other").await.expect("opens");
        let content = BlobStore::open(&StoreLocation::Folder, folder.path(), None).await.expect("opens");
        let data = folder.path().to_owned();
        let telemetry = Telemetry::new(data, &database, queue.clone(), Arc::new(content), Arc::default());
        let events = Arc::new(FarmEvents::new(queue.clone(), Arc::new(telemetry)));
        Self { queue, other, events, _folder: folder }
    }

    async fn follow(&self, submitter: Option<&str>) -> FarmSubscriber {
        FarmSubscriber::start(&self.events, submitter, CancellationToken::new()).await.expect("reads")
    }

    async fn look(&self) {
        self.events.look().await.expect("reads");
    }
}

async fn submit(queue: &Queue) -> JobId {
    let new = NewJob::example();
    let id = new.id;
    queue.submit(new).await.expect("accepted");
    id
}

async fn set_priority(queue: &Queue, id: JobId, priority: i32) {
    queue.patch(id, JobPatch { priority: Some(priority) }).await.expect("changes");
}

fn parse(bytes: &[u8]) -> Vec<FarmEvent> {
    let messages = SseParser::default().push(bytes);
    messages.iter().map(|message| FarmEvent::parse(&message.event, &message.data).expect("known")).collect()
}

/// The next events.
async fn next(follower: &mut FarmSubscriber) -> Vec<FarmEvent> {
    let piece = tokio::time::timeout(DEADLINE, follower.next()).await.expect("in time").expect("goes on");
    parse(&piece)
}

/// Events until a job has this priority.
async fn until_priority(follower: &mut FarmSubscriber, priority: i32) -> Vec<FarmEvent> {
    let mut events = Vec::new();
    loop {
        for event in next(follower).await {
            let is_last = matches!(&event, FarmEvent::Job(job) if job.priority == priority);
            events.push(event);
            if is_last {
                return events;
            }
        }
    }
}

#[tokio::test]
async fn a_follower_that_does_not_read_must_read_its_list_again_and_gets_no_older_views() {
    let bench = Fixture::new().await;
    let id = submit(&bench.queue).await;
    let mut slow = bench.follow(None).await;
    assert!(matches!(&next(&mut slow).await[..], [FarmEvent::Hello(_), FarmEvent::Farm(farm)] if farm.queued == 1));
    for (_, priority) in (0..2 * MAX_BEHIND).zip(1..) {
        set_priority(&bench.queue, id, priority).await;
        bench.look().await;
    }
    assert!(matches!(next(&mut slow).await[..], [FarmEvent::Resync]));
    set_priority(&bench.queue, id, -1).await;
    bench.look().await;
    let events = until_priority(&mut slow, -1).await;
    assert_eq!(events.iter().filter(|event| matches!(event, FarmEvent::Job(_))).count(), 1, "{events:?}");
}

#[tokio::test]
async fn many_changes_at_once_are_not_told_one_by_one() {
    let bench = Fixture::new().await;
    let mut follower = bench.follow(None).await;
    next(&mut follower).await;
    for _ in 0..=MAX_JOBS {
        submit(&bench.queue).await;
    }
    bench.look().await;
    assert!(matches!(next(&mut follower).await[..], [FarmEvent::Resync]));
    let id = submit(&bench.queue).await;
    bench.look().await;
    let received: Vec<_> = next(&mut follower).await.into_iter().chain(next(&mut follower).await).collect();
    let id_of = |event: &FarmEvent| if let FarmEvent::Job(job) = event { Some(job.id) } else { None };
    let jobs: Vec<JobId> = received.iter().filter_map(id_of).collect();
    assert_eq!(jobs, [id], "{received:?}");
}

#[tokio::test]
async fn changes_of_other_servers_are_told_without_their_messages() {
    let bench = Fixture::new().await;
    let end = CancellationToken::new();
    let task = tokio::spawn({
        let (events, end) = (Arc::clone(&bench.events), end.clone());
        async move { events.run(end).await }
    });
    let mut follower = bench.follow(None).await;
    assert!(matches!(next(&mut follower).await[..], [FarmEvent::Hello(_), FarmEvent::Farm(_)]));
    let id = submit(&bench.other).await;
    set_priority(&bench.other, id, 7).await;
    until_priority(&mut follower, 7).await;
    bench.other.delete(id).await.expect("deletes");
    loop {
        let events = next(&mut follower).await;
        if events.iter().any(|event| matches!(event, FarmEvent::Deleted(deleted) if deleted.id == id.to_string())) {
            break;
        }
    }
    end.cancel();
    task.await.expect("ends");
}

#[tokio::test]
async fn another_name_is_told_nothing() {
    let bench = Fixture::new().await;
    let (mut own, mut stranger) = (bench.follow(Some("local")).await, bench.follow(Some("stranger")).await);
    for follower in [&mut own, &mut stranger] {
        assert!(matches!(next(follower).await[..], [FarmEvent::Hello(_)]));
    }
    let id = submit(&bench.queue).await;
    bench.look().await;
    bench.queue.delete(id).await.expect("deletes");
    bench.look().await;
    assert!(matches!(&next(&mut own).await[..], [FarmEvent::Job(job)] if job.id == id));
    assert!(matches!(&next(&mut own).await[..], [FarmEvent::Deleted(deleted)] if deleted.id == id.to_string()));
    let waiting = tokio::time::timeout(Duration::from_millis(50), stranger.next());
    assert!(waiting.await.is_err(), "nothing of another name's jobs, and no numbers of the farm");
}

#[tokio::test]
async fn nothing_is_read_without_followers_and_nothing_old_is_told() {
    let bench = Fixture::new().await;
    drop(bench.follow(None).await);
    let old = submit(&bench.queue).await;
    bench.look().await;
    let mut follower = bench.follow(None).await;
    next(&mut follower).await;
    let new = submit(&bench.queue).await;
    assert_ne!(old, new);
    bench.look().await;
    assert!(matches!(&next(&mut follower).await[..], [FarmEvent::Job(job)] if job.id == new));
}
