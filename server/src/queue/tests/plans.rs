//! Every statement of the queue uses an index. The statements are not listed here: they are recorded while
//! random sequences and the queries of users and operators run.

use std::collections::BTreeSet;
use std::fmt;
use std::sync::Mutex;

use db::Readers;
use proptest::strategy::{Strategy, ValueTree};
use proptest::test_runner::TestRunner;
use proto::job::JobState;
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Metadata, Subscriber};

use super::sequences::{Pair, sequence};
use super::{Fixture, new_job};
use crate::db;
use crate::db::Database;
use crate::db::postgres::tests::prepare_all;
use crate::postgres_server;
use crate::queue::ChangePosition;

/// Number of recorded sequences.
const SEQUENCES: usize = 40;
/// Tables that may be scanned: they have one row for each meta value, worker, or submitter, or for each worker in an
/// unfinished job.
const SMALL: [&str; 6] = ["meta", "server", "worker", "share", "strike", "speed"];
/// Indexes that contain only unfinished work, or are read in order up to the first match.
const SHORT: [&str; 10] = [
    "job_to_clean_up",
    "tile_stitch",
    "tile_waiting",
    "lease_live_by_grant",
    "lease_live_by_expiry",
    "lease_live_by_worker",
    "lease_live_by_tile",
    "job_by_place",
    "job_by_share",
    "worker_present",
];

static SEEN: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());

/// Records the statements of databases that emit them; only this test's does.
struct Recorder;

struct Statement(String);

impl Visit for Statement {
    fn record_debug(&mut self, _: &Field, _: &dyn fmt::Debug) {}

    fn record_str(&mut self, field: &Field, value: &str) {
        // The summary comes first, and is the complete statement if that is short.
        if field.name() == "summary" || (field.name() == "db.statement" && !value.is_empty()) {
            value.trim().clone_into(&mut self.0);
        }
    }
}

impl Subscriber for Recorder {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.target() == "sqlx::query"
    }

    fn new_span(&self, _: &Attributes<'_>) -> Id {
        Id::from_u64(1)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}

    fn event(&self, event: &Event<'_>) {
        let mut statement = Statement(String::new());
        event.record(&mut statement);
        SEEN.lock().expect("no holder panics").insert(statement.0);
    }

    fn enter(&self, _: &Id) {}

    fn exit(&self, _: &Id) {}
}

/// Runs the statements that the sequences do not.
async fn ask(bench: &Fixture) {
    let queue = &bench.queue;
    let new = new_job(2);
    let id = new.id;
    let number = queue.submit(new).await.expect("accepted");
    for state in [None, Some(JobState::Running), Some(JobState::Queued)] {
        for submitter in [None, Some("local")] {
            queue.jobs(submitter, state, 10, None).await.expect("lists");
        }
    }
    let hashes = ["0".repeat(64), "1".repeat(64)];
    queue.file(id).await.expect("reads");
    queue.file_of(number).await.expect("reads");
    queue.image(id, 0).await.expect("reads");
    queue.workers().await.expect("lists");
    queue.pool_ready().await.expect("counts");
    queue.demand().await.expect("counts");
    for kind in crate::blobs::ContentKind::ALL {
        queue.orphans(kind, &hashes).await.expect("reads");
        queue.mark_doomed(kind, hashes.to_vec()).await.expect("marks");
        queue.begin_check(&[(kind, hashes[0].clone())]).await.expect("reads");
        let taken = queue.take_doomed(kind, std::time::Duration::ZERO, 10).await.expect("takes");
        queue.record_deleted(kind, taken).await.expect("records");
    }
    queue.has_picture("no key").await.expect("reads");
    queue.is_paused().await.expect("reads");
    let changes = queue.changes_after(ChangePosition::default()).await.expect("reads");
    queue.newest_change().await.expect("reads");
    queue.failing_webhooks().await.expect("reads");
    queue.tiles(id, None, None, 10).await.expect("reads");
    queue.makers(id, 0).await.expect("reads");
    queue.prune().await.expect("prunes");
    queue.failing_workers().await.expect("reads");
    queue.jobs_numbered(&changes.jobs).await.expect("reads");
    queue.prune_changes().await.expect("prunes");
    queue.delete_preview(id).await.expect("reads");
    queue.check().await.expect("responds");
    queue.fail_unreadable(number, "no".to_owned()).await.expect("fails the job");
}

/// Whether a step of a plan reads more than it needs.
fn is_wasteful(step: &str) -> bool {
    let Some(scanned) = step.strip_prefix("SCAN ") else { return false };
    let table = scanned.split(' ').next().unwrap_or_default();
    let is_table = ["job", "frame", "tile", "lease", "outbox", "picture", "pace", "job_file"].contains(&table);
    let by_short = SHORT.iter().any(|index| scanned.ends_with(index));
    !by_short && !SMALL.contains(&table) && (is_table || scanned.contains(" USING "))
}

async fn plan(readers: &Readers, statement: &str) -> Vec<String> {
    let rows = db::made_query(format!("EXPLAIN QUERY PLAN {statement}")).fetch_all(readers).await;
    let rows = rows.unwrap_or_else(|error| panic!("{error}: {statement}"));
    rows.iter().map(|row| row.get("detail").expect("a text")).collect()
}

/// Runs random sequences, and the statements that they do not run.
async fn run_sequences() {
    let mut runner = TestRunner::deterministic();
    for _ in 0..SEQUENCES {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let store = Database::open_traced(folder.path()).await.expect("opens");
        let mut pair = Pair::new(Fixture::with_store(store, folder).await).await;
        for operation in &sequence().new_tree(&mut runner).expect("a sequence").current() {
            pair.apply(operation).await;
        }
        pair.work_off().await;
        ask(&pair.bench).await;
    }
}

#[tokio::test]
async fn every_statement_is_prepared_by_postgresql() {
    if postgres_server::server().is_some() {
        return;
    }
    run_sequences().await;
    if let Some(prepared) = prepare_all().await {
        assert!(prepared >= 120, "only {prepared} statements were recorded");
    }
}

#[tokio::test]
async fn every_statement_uses_an_index() {
    if postgres_server::server().is_some() {
        return;
    }
    tracing::subscriber::set_global_default(Recorder).expect("no other test sets a subscriber");
    run_sequences().await;
    let bench = Fixture::new().await;
    let seen = SEEN.lock().expect("no holder panics").clone();
    let (mut explained, mut wasteful) = (0, Vec::new());
    for statement in &seen {
        let verb = statement.split_whitespace().next().unwrap_or_default();
        if !["SELECT", "UPDATE", "INSERT", "DELETE", "WITH"].contains(&verb) || statement.contains("_sqlx_migrations") {
            continue;
        }
        explained += 1;
        let plan = plan(bench.queue.readers(), statement).await;
        wasteful.extend(
            plan.iter().filter(|step| is_wasteful(step)).map(|step| format!("{step}\n  in {plan:?}\n  of {statement}")),
        );
    }
    assert!(explained >= 60, "only {explained} statements were recorded: {seen:?}");
    assert!(wasteful.is_empty(), "{}", wasteful.join("\n"));
}

#[tokio::test]
async fn a_claim_needs_no_sort() {
    if postgres_server::server().is_some() {
        return;
    }
    let bench = Fixture::new().await;
    for statement in [include_str!("../leases/next_job.sql"), include_str!("../leases/next_tiles.sql")] {
        let plan = plan(bench.queue.readers(), statement).await;
        assert!(!plan.iter().any(|step| step.contains("TEMP B-TREE")), "{plan:?}");
        assert!(plan.iter().any(|step| step.contains("tile_ready")), "{plan:?}");
    }
}
