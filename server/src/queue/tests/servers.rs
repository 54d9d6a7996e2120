//! Several servers on one database: what each may end, what becomes of one that has ended, and what only one may do.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use proto::WorkerId;
use proto::worker_protocol::LeaseOutcome;

use super::workers::{claim, report, state};
use super::{Fixture, leases};
use crate::clock::{Clock, ManualClock};
use crate::db::{self, Database, Sharing};
use crate::postgres_server;
use crate::queue::servers::SERVER_GONE_MS;
use crate::queue::{BusyReceivers, LeaseEnd, Queue};

/// Longer than a server may leave its row unrenewed.
const GONE: Duration = Duration::from_millis(SERVER_GONE_MS.unsigned_abs() + 1);
/// Longer than a lease, for tests in which no lease expires.
const LONG_LEASE_MS: i64 = 100 * SERVER_GONE_MS;

/// Servers on one database, with one time.
pub(super) struct Servers {
    clock: Clock,
    hand: ManualClock,
    database: Arc<Database>,
    folder: tempfile::TempDir,
}

impl Servers {
    pub(super) async fn new() -> Self {
        let (clock, hand) = Clock::manual_lasting();
        let folder = tempfile::tempdir().expect("a folder");
        let database = match open_shared(folder.path()).await {
            Some(shared) => shared,
            None => Arc::new(Database::open(folder.path()).await.expect("opens")),
        };
        Self { clock, hand, database, folder }
    }

    /// Starts a server, on PostgreSQL with connections of its own.
    pub(super) async fn start(&self, name: &str) -> Fixture {
        let own = open_shared(self.folder.path()).await.unwrap_or_else(|| Arc::clone(&self.database));
        let opened = Queue::open(own, self.clock.clone(), LONG_LEASE_MS, name).await;
        let folder = tempfile::tempdir_in(self.folder.path()).expect("a folder");
        Fixture { queue: opened.expect("opens").0, hand: self.hand.clone(), folder }
    }
}

/// Another handle to the database of a folder; `None` unless it is on PostgreSQL.
async fn open_shared(folder: &Path) -> Option<Arc<Database>> {
    let address = postgres_server::database_of(folder)?.parse().expect("an address");
    Some(Arc::new(Database::open_postgres(&address, Sharing::Shared).await.expect("opens")))
}

/// Number of live leases of a worker.
async fn live(server: &Fixture, worker: WorkerId) -> i64 {
    let count = db::query_scalar("SELECT count(*) FROM lease WHERE worker = ? AND ended IS NULL");
    count.bind(worker.to_string()).fetch_one(server.queue.readers()).await.expect("reads")
}

#[tokio::test]
async fn a_server_that_starts_ends_the_leases_of_its_own_last_pool_only() {
    let servers = Servers::new().await;
    let (first, second) = (servers.start("first").await, servers.start("second").await);
    first.submit(4, 1).await;
    let pool_of_first = first.register(None, Some(7)).await;
    let pool_of_second = second.register(None, Some(7)).await;
    let remote = first.worker(None).await;
    for (server, worker) in [(&first, pool_of_first), (&second, pool_of_second), (&second, remote)] {
        claim(server, worker).await.expect("work");
    }
    let again = servers.start("first").await;
    assert_eq!(live(&again, pool_of_first).await, 0);
    assert_eq!(state(&again, pool_of_first).await, "gone");
    assert!(live(&again, pool_of_second).await > 0 && live(&again, remote).await > 0);
    assert_eq!(state(&again, pool_of_second).await, "ready");
    assert!(again.queue.generation() > second.queue.generation());
}

#[tokio::test]
async fn equal_process_ids_of_two_servers_are_two_workers() {
    let servers = Servers::new().await;
    let (first, second) = (servers.start("first").await, servers.start("second").await);
    let (own, other) = (first.register(None, Some(7)).await, second.register(None, Some(7)).await);
    assert!(first.queue.drain(7).await.expect("drains"));
    assert_eq!((state(&first, own).await, state(&first, other).await), ("draining".to_owned(), "ready".to_owned()));
    let ended = first.queue.worker_exited(7, LeaseEnd::Lost, "it ended".to_owned()).await.expect("reaps");
    assert_eq!(ended, Some(own));
    assert_eq!(state(&first, other).await, "ready");
}

#[tokio::test]
async fn leases_of_a_server_that_has_ended_are_handed_back_by_another() {
    let servers = Servers::new().await;
    let (first, second) = (servers.start("first").await, servers.start("second").await);
    first.submit(2, 1).await;
    let lost = second.register(None, Some(8)).await;
    let remote = second.worker(None).await;
    let run = claim(&second, lost).await.expect("work");
    claim(&second, remote).await.expect("work");
    assert_eq!(first.queue.renew_server_if(true).await.expect("renews"), 1);
    servers.hand.advance(GONE);
    // It may have been cut off itself, so that it does not judge yet.
    assert_eq!(first.queue.renew_server_if(false).await.expect("renews"), 1);
    assert!(live(&first, lost).await > 0);
    assert_eq!(first.queue.renew_server_if(true).await.expect("renews"), 0);
    assert_eq!((live(&first, lost).await, state(&first, lost).await), (0, "gone".to_owned()));
    assert!(live(&first, remote).await > 0, "any server renews the leases of remote workers");
    // It had not ended: it comes back, and its worker has to register again.
    assert_eq!(second.queue.renew_server_if(true).await.expect("renews"), 1);
    assert!(second.turn(super::turn(lost)).await.is_none());
    let next = second.register(None, Some(8)).await;
    let taken = claim(&second, next).await.expect("what was handed back");
    assert_eq!((taken.job, taken.frame), (run.job, run.frame));
}

#[tokio::test]
async fn the_first_server_of_a_farm_gives_remote_workers_another_lease_length() {
    let servers = Servers::new().await;
    let first = servers.start("first").await;
    first.submit(1, 1).await;
    let remote = first.worker(None).await;
    let run = claim(&first, remote).await.expect("work");
    servers.hand.advance(Duration::from_millis(LONG_LEASE_MS.unsigned_abs() * 2));
    // Nothing could renew it in the meantime.
    let second = servers.start("second").await;
    assert_eq!(second.queue.expire_leases().await.expect("expires"), 0);
    let hash = blake3::hash(b"picture").to_hex().to_string();
    let outcomes = leases(&run).map(|_| LeaseOutcome::Picture { hash: hash.clone(), size_bytes: 7 }).collect();
    assert!(report(&second, remote, &run, outcomes).await.revoked_leases.is_empty());
}

#[tokio::test]
async fn leases_do_not_expire_while_workers_could_not_renew_them() {
    let servers = Servers::new().await;
    let server = servers.start("first").await;
    server.submit(1, 1).await;
    let remote = server.worker(None).await;
    let run = claim(&server, remote).await.expect("work");
    // The first renewal begins the time of grace.
    server.queue.renew_server().await.expect("renews");
    servers.hand.advance(Duration::from_millis(LONG_LEASE_MS.unsigned_abs() * 2));
    assert_eq!(server.queue.expire_leases().await.expect("looks"), 0);
    let renewed = super::SyncInput { held_leases: leases(&run).collect(), ..super::turn(remote) };
    assert!(server.turn(renewed).await.expect("known").revoked_leases.is_empty());
}

#[tokio::test]
async fn one_server_attempts_a_delivery_and_another_after_it_has_ended() {
    let servers = Servers::new().await;
    let (first, second) = (servers.start("first").await, servers.start("second").await);
    let made = db::query(
        "INSERT INTO delivery (id, event, url, target, job, name, body, state, next_at_ms)
         VALUES ('msg_1', 'job.succeeded', 'https://hooks.example/', 'hooks.example:443', 'j', 'n', '{}', 'pending', 0)",
    );
    let written = servers
        .database
        .write(db::Durability::Full, move |connection| {
            Box::pin(async move { made.execute(connection).await.map(drop) })
        })
        .await;
    written.expect("writes");
    let due = async |server: &Fixture| {
        let due = server.queue.due_deliveries(&BusyReceivers::default(), 10).await.expect("reads");
        due.iter().map(|delivery| delivery.number).collect::<Vec<_>>()
    };
    let numbers = due(&first).await;
    assert_eq!((numbers.len(), due(&second).await), (1, numbers.clone()));
    let claim = async |server: &Fixture| server.queue.claim_deliveries(numbers.clone()).await.expect("claims").len();
    assert_eq!((claim(&first).await, claim(&second).await), (1, 0));
    assert!(due(&second).await.is_empty());
    servers.hand.advance(Duration::from_mins(2));
    assert_eq!((due(&second).await, claim(&second).await), (numbers.clone(), 1));
    // The first one was slow; its outcome counts if it is the first to be recorded, and no other does.
    for (server, status) in [(&first, 200), (&second, 500)] {
        let attempt = match status {
            200 => crate::queue::Attempt::Delivered { status },
            _ => crate::queue::Attempt::Failed { status: Some(status), error: "no".to_owned(), retry_in: None },
        };
        server.queue.record_attempt(numbers[0], attempt).await.expect("records");
    }
    let state: String =
        db::query_scalar("SELECT state FROM delivery").fetch_one(first.queue.readers()).await.expect("reads");
    assert_eq!(state, "delivered");
}

#[tokio::test]
async fn servers_agree_on_a_secret_which_changes_only_if_all_have_stopped() {
    let servers = Servers::new().await;
    let (first, second) = (servers.start("first").await, servers.start("second").await);
    assert!(first.queue.agrees_on_secret(1).await.expect("writes"));
    assert!(second.queue.agrees_on_secret(1).await.expect("reads"));
    assert!(!second.queue.agrees_on_secret(2).await.expect("reads"));
    first.queue.end_server().await.expect("ends");
    assert!(second.queue.agrees_on_secret(2).await.expect("writes"));
    assert!(second.queue.agrees_on_secret(2).await.expect("reads"));
}

#[tokio::test]
async fn a_server_asks_whether_there_is_work() {
    let servers = Servers::new().await;
    let server = servers.start("first").await;
    assert!(!server.queue.has_claimable_work().await.expect("reads"));
    server.submit(1, 1).await;
    assert!(server.queue.has_claimable_work().await.expect("reads"));
    server.queue.pause_all(true).await.expect("pauses");
    assert!(!server.queue.has_claimable_work().await.expect("reads"));
}
