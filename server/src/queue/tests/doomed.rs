//! Sweeps of some servers and reports of another, in every order of their steps: no row refers to bytes that are gone.

use std::time::Duration;

use proto::WorkerId;
use proto::worker_protocol::{LeaseOutcome, LeaseReport};

use super::servers::Servers;
use super::workers::claim;
use super::{Fixture, leases, turn};
use crate::blobs::{BlobStore, ContentHash, ContentKind, Swept};
use crate::queue::{CheckedNames, SyncInput};

const KIND: ContentKind = ContentKind::Picture;
/// Steps of a sweep: mark, take, delete, record.
const SWEEP_STEPS: usize = 4;
/// Steps of a report: store, begin the check, look for the bytes, commit.
const REPORT_STEPS: usize = 4;

/// Bytes that nothing else has.
struct Content {
    bytes: bytes::Bytes,
    name: ContentHash,
}

impl Content {
    fn new(number: u64) -> Self {
        let bytes = bytes::Bytes::from(format!("content {number}"));
        let name = ContentHash::parse(blake3::hash(&bytes).to_hex().as_str()).expect("a hash");
        Self { bytes, name }
    }

    fn names(&self) -> Vec<String> {
        vec![self.name.as_str().to_owned()]
    }

    async fn put(&self, store: &BlobStore) {
        let bytes = futures_util::stream::iter([Ok(self.bytes.clone())]);
        store.put(KIND, &self.name, bytes, u64::MAX).await.expect("stores");
    }
}

/// A sweep, step by step.
#[derive(Default)]
struct Sweep {
    taken: Vec<String>,
    swept: Vec<(String, Swept)>,
}

impl Sweep {
    async fn step(&mut self, step: usize, server: &Fixture, store: &BlobStore, content: &Content) {
        let queue = &server.queue;
        match step {
            0 => queue.mark_doomed(KIND, content.names()).await.expect("marks"),
            1 => self.taken = queue.take_doomed(KIND, Duration::ZERO, 10).await.expect("takes"),
            2 => self.swept = store.delete_old(KIND, &self.taken).await,
            _ => {
                assert!(self.swept.iter().all(|(_, swept)| matches!(swept, Swept::Deleted | Swept::Missing)));
                queue.record_deleted(KIND, std::mem::take(&mut self.taken)).await.expect("records");
            }
        }
    }
}

/// A report of a frame's picture, step by step.
struct Report {
    worker: WorkerId,
    reports: Vec<LeaseReport>,
    checked: Option<CheckedNames>,
    is_found: bool,
    is_accepted: bool,
}

impl Report {
    /// A worker that has rendered a frame.
    async fn new(server: &Fixture, content: &Content) -> Self {
        server.submit(1, 1).await;
        let worker = server.worker(None).await;
        let run = claim(server, worker).await.expect("work");
        let (hash, size_bytes) = (content.name.as_str().to_owned(), content.bytes.len() as u64);
        let outcome = LeaseOutcome::Picture { hash, size_bytes };
        let report = |lease| LeaseReport { lease, outcome: outcome.clone() };
        let reports = leases(&run).map(report).collect();
        Self { worker, reports, checked: None, is_found: false, is_accepted: false }
    }

    async fn step(&mut self, step: usize, server: &Fixture, store: &BlobStore, content: &Content) {
        match step {
            0 => content.put(store).await,
            1 => {
                let names = [(KIND, content.name.as_str().to_owned())];
                self.checked = Some(server.queue.begin_check(&names).await.expect("reads"));
            }
            2 => {
                let checked = self.checked.as_ref().expect("it has begun");
                self.is_found = checked.find(store, KIND, &content.name).await.expect("looks").is_some();
            }
            _ if self.is_found => {
                let reports = std::mem::take(&mut self.reports);
                let synced =
                    server.turn(SyncInput { reports, checked: self.checked.take(), ..turn(self.worker) }).await;
                self.is_accepted = synced.expect("known").rejected == 0;
            }
            _ => {}
        }
    }
}

/// Every order of `first` steps of one and `second` steps of another.
fn orders(first: usize, second: usize) -> Vec<Vec<usize>> {
    match (first, second) {
        (0, _) => vec![vec![1; second]],
        (_, 0) => vec![vec![0; first]],
        (_, _) => {
            let begin = |actor: usize, rest: Vec<Vec<usize>>| {
                rest.into_iter().map(move |rest| [vec![actor], rest].concat()).collect::<Vec<_>>()
            };
            [begin(0, orders(first - 1, second)), begin(1, orders(first, second - 1))].concat()
        }
    }
}

/// Outcomes of reports.
#[derive(Debug, Default)]
struct Outcomes {
    accepted: u32,
    rejected: u32,
}

/// Runs the steps in this order: 0 is the report, the others are sweeps of other servers. Then what no row refers to can be
/// stored and reported.
async fn run(servers: &[Fixture], stores: &[BlobStore], order: &[usize], content: &Content, outcomes: &mut Outcomes) {
    let mut report = Report::new(&servers[0], content).await;
    let mut sweeps: Vec<_> = (1..servers.len()).map(|_| Sweep::default()).collect();
    let mut steps = vec![0; servers.len()];
    for &actor in order {
        let (server, store, step) = (&servers[actor], &stores[actor], steps[actor]);
        match actor {
            0 => report.step(step, server, store, content).await,
            _ => sweeps[actor - 1].step(step, server, store, content).await,
        }
        steps[actor] += 1;
    }
    if report.is_accepted {
        outcomes.accepted += 1;
    } else {
        outcomes.rejected += 1;
        report = Report::new(&servers[0], content).await;
        for step in 0..REPORT_STEPS {
            report.step(step, &servers[0], &stores[0], content).await;
        }
        assert!(report.is_accepted, "{order:?}: the next report is not rejected");
    }
    let is_used = servers[0].queue.orphans(KIND, &content.names()).await.expect("reads").is_empty();
    assert!(is_used, "{order:?}");
    // Whatever was known of it, no later sweep deletes it.
    let mut later = Sweep::default();
    for step in 0..SWEEP_STEPS {
        later.step(step, &servers[1], &stores[1], content).await;
    }
    let found = stores[1].ends_now(KIND, &content.name).await.expect("looks");
    assert!(found.is_some(), "{order:?}: a row refers to bytes that were deleted");
}

#[tokio::test]
async fn no_order_of_a_sweep_and_a_report_loses_bytes() {
    let servers = Servers::new().await;
    let both = [servers.start("reports").await, servers.start("sweeps").await];
    let spool = tempfile::tempdir().expect("a folder");
    let stores = BlobStore::in_memory(2, spool.path());
    let (mut outcomes, mut number) = (Outcomes::default(), 0);
    // Before: nothing, bytes that this server stored, bytes that the other stored, and a mark.
    for (stored_by, is_marked) in [(None, false), (Some(0), false), (Some(1), false), (Some(0), true), (Some(1), true)]
    {
        for order in orders(REPORT_STEPS, SWEEP_STEPS) {
            number += 1;
            let content = Content::new(number);
            if let Some(server) = stored_by {
                content.put(&stores[server]).await;
            }
            if is_marked {
                both[1].queue.mark_doomed(KIND, content.names()).await.expect("marks");
            }
            run(&both, &stores, &order, &content, &mut outcomes).await;
        }
    }
    assert!(outcomes.accepted > 20 && outcomes.rejected > 20, "both happen: {outcomes:?}");
}

#[tokio::test]
async fn no_order_of_two_sweeps_and_a_report_loses_bytes() {
    let servers = Servers::new().await;
    let all = [servers.start("reports").await, servers.start("sweeps").await, servers.start("sweeps as well").await];
    let spool = tempfile::tempdir().expect("a folder");
    let stores = BlobStore::in_memory(3, spool.path());
    let mut outcomes = Outcomes::default();
    for number in 0..150 {
        let content = Content::new(number);
        content.put(&stores[number as usize % 3]).await;
        // A random order, the same in each run.
        let mut order = [vec![0; REPORT_STEPS], vec![1; SWEEP_STEPS], vec![2; SWEEP_STEPS]].concat();
        let mut random = blake3::Hasher::new().update(&number.to_le_bytes()).finalize_xof();
        for place in (1..order.len()).rev() {
            let mut byte = [0];
            random.fill(&mut byte);
            order.swap(place, usize::from(byte[0]) % (place + 1));
        }
        run(&all, &stores, &order, &content, &mut outcomes).await;
    }
    assert!(outcomes.accepted > 0 && outcomes.rejected > 20, "both happen: {outcomes:?}");
}

#[tokio::test]
async fn a_mark_lasts_for_the_grace_and_a_deletion_for_longer_than_any_check() {
    let servers = Servers::new().await;
    let server = servers.start("one").await;
    let (queue, content) = (&server.queue, Content::new(0));
    let grace = Duration::from_mins(15);
    let take = async || queue.take_doomed(KIND, grace, 10).await.expect("takes");
    queue.mark_doomed(KIND, content.names()).await.expect("marks");
    server.hand.advance(Duration::from_mins(14));
    // A second mark changes nothing.
    queue.mark_doomed(KIND, content.names()).await.expect("marks");
    assert!(take().await.is_empty(), "it is too early");
    server.hand.advance(Duration::from_mins(1));
    assert_eq!(take().await, content.names());
    assert!(take().await.is_empty(), "another server deletes it");
    // That server was killed: another one deletes it, and so on.
    server.hand.advance(grace);
    assert_eq!(take().await, content.names());
    queue.record_deleted(KIND, content.names()).await.expect("records");
    let known = async || crate::db::query_scalar::<i64>("SELECT count(*) FROM doomed").fetch_one(queue.readers()).await;
    server.hand.advance(grace / 2);
    assert!(take().await.is_empty());
    assert_eq!(known().await.expect("counts"), 1);
    server.hand.advance(grace / 2);
    assert!(take().await.is_empty());
    assert_eq!(known().await.expect("counts"), 0);
    // Content that was stored again meanwhile waits for another grace.
    queue.mark_doomed(KIND, content.names()).await.expect("marks");
    server.hand.advance(grace);
    assert_eq!(take().await, content.names());
    queue.mark_again(KIND, content.names()).await.expect("marks");
    assert!(take().await.is_empty());
    server.hand.advance(grace);
    assert_eq!(take().await, content.names());
}
