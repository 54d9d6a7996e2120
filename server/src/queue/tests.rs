//! Properties that the API cannot show: statements use indexes, the queue matches its model under random
//! operations, and shares are fair.

mod doomed;
mod effects;
mod fair_share;
mod large_jobs;
mod model;
mod owners;
mod places;
mod plans;
mod recorded;
mod sequences;
mod servers;
mod several_batches;
mod sharing;
mod statements;
mod tile_makers;
mod workers;

use proto::bounded::RaysPerSecond;
use proto::worker_protocol::RegisterRequest;
use proto::{JobId, WorkerId};

use crate::clock::{Clock, ManualClock};
use crate::db;
use crate::db::Database;
use crate::postgres_server;
use crate::queue::{FrameOpening, NewJob, NewWorker, NextWork, PassedJobs, Queue, Registration, SyncInput};
use crate::tile_plan::TilePlan;

const LEASE_MS: i64 = 1000;

pub(super) struct Fixture {
    pub(super) queue: Queue,
    hand: ManualClock,
    folder: tempfile::TempDir,
}

impl Fixture {
    pub(super) async fn new() -> Self {
        Self::in_folder(tempfile::tempdir().expect("a temporary folder")).await
    }

    /// Opens the database on a file system in memory if there is one, because these tests gain nothing
    /// from waiting for a disk.
    async fn in_memory() -> Self {
        let folder = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir());
        Self::in_folder(folder.expect("a temporary folder")).await
    }

    async fn in_folder(folder: tempfile::TempDir) -> Self {
        let store = Database::open(folder.path()).await.expect("opens");
        Self::with_store(store, folder).await
    }

    async fn with_store(store: Database, folder: tempfile::TempDir) -> Self {
        let (clock, hand) = Clock::manual();
        let (queue, _) = Queue::open(store.into(), clock, LEASE_MS, "test").await.expect("opens");
        Self { queue, hand, folder }
    }

    /// Stops the server and starts another on the same database; its clock starts at zero.
    async fn restart(&mut self) {
        self.queue.database.close().await;
        let store = Database::open(self.folder.path()).await.expect("opens again");
        let (clock, hand) = Clock::manual();
        let (queue, _) = Queue::open(store.into(), clock, LEASE_MS, "test").await.expect("opens again");
        (self.queue, self.hand) = (queue, hand);
    }

    /// Registers a worker; with a process id it belongs to the pool.
    async fn register(&self, max_nodes: Option<u32>, process: Option<u32>) -> WorkerId {
        self.try_register("local", max_nodes, process).await.expect("they are few").worker
    }

    async fn try_register(&self, owner: &str, max_nodes: Option<u32>, process: Option<u32>) -> Option<Registration> {
        let pool = process.is_some();
        let hello = RegisterRequest {
            name: String::new(),
            device: "cpu".to_owned(),
            picture_version: 1,
            max_nodes,
            process: process.unwrap_or_default(),
        };
        self.queue
            .register(NewWorker { request: hello, pool, name: "test".to_owned(), owner: owner.to_owned() })
            .await
            .expect("registers")
    }

    /// Process id of a worker.
    async fn process(&self, worker: WorkerId) -> u32 {
        let process = db::query_scalar("SELECT process FROM worker WHERE id = ?").bind(worker.to_string());
        process.fetch_optional(self.queue.readers()).await.expect("reads").unwrap_or(u32::MAX)
    }

    pub(super) async fn submit(&self, frames: u32, nodes: u32) -> JobId {
        let new = NewJob { nodes, ..new_job(frames) };
        let id = new.id;
        self.queue.submit(new).await.expect("accepted");
        id
    }

    async fn worker(&self, max_nodes: Option<u32>) -> WorkerId {
        self.register(max_nodes, None).await
    }

    /// A worker's sync, with frames opened as needed.
    async fn turn(&self, mut turn: SyncInput) -> Option<super::SyncOutcome> {
        loop {
            let synced = self.queue.turn(turn.clone()).await.expect("a sync")?;
            let NextWork::OpenFrame { job, frame, plan } = synced.next else { return Some(synced) };
            turn.reports.clear();
            turn.opening = Some(opening(job, frame, plan));
            let next = (frame + 1..plan.frames).take(turn.max_batches as usize - 1);
            turn.next_openings = next.map(|frame| opening(job, frame, plan)).collect();
        }
    }

    /// Asserts that every job's and frame's counters match their tiles.
    async fn check(&self) {
        const CHECKS: [&str; 10] = [
            "SELECT count(*) FROM job WHERE cleanup IS DISTINCT FROM 'delete' AND tiles_done + 0 <> (
                 SELECT count(*) FROM tile WHERE tile.job = job.number AND kind = 'render' AND state = 'done')",
            "SELECT count(*) FROM job WHERE cleanup IS DISTINCT FROM 'delete' AND rays_done <> (
                 SELECT CAST(coalesce(sum(rays), 0) AS BIGINT) FROM tile WHERE tile.job = job.number AND kind = 'render' AND state = 'done')",
            "SELECT count(*) FROM job WHERE cleanup IS DISTINCT FROM 'delete' AND tiles_dead <> (
                 SELECT count(*) FROM tile WHERE tile.job = job.number AND state = 'dead')",
            "SELECT count(*) FROM job WHERE cleanup IS DISTINCT FROM 'delete' AND frames_stored <> (
                 SELECT count(*) FROM frame WHERE frame.job = job.number AND state = 'stored')",
            "SELECT count(*) FROM frame WHERE (SELECT cleanup FROM job WHERE job.number = frame.job) IS DISTINCT FROM 'delete'
                 AND tiles_done <> (
                 SELECT count(*) FROM tile WHERE tile.job = frame.job AND tile.frame = frame.number
                 AND kind = 'render' AND state = 'done')",
            "SELECT count(*) FROM tile WHERE (state = 'leased') <> EXISTS (
                 SELECT 1 FROM lease WHERE lease.tile = tile.id AND ended IS NULL)",
            "SELECT count(*) FROM tile WHERE (
                 SELECT count(*) FROM lease WHERE lease.tile = tile.id AND ended IS NULL) > 2",
            "SELECT count(*) FROM tile WHERE (
                 SELECT count(DISTINCT worker) FROM lease WHERE lease.tile = tile.id AND ended IS NULL) <> (
                 SELECT count(*) FROM lease WHERE lease.tile = tile.id AND ended IS NULL)",
            "SELECT count(*) FROM share WHERE jobs <> (
                 SELECT count(*) FROM job WHERE job.submitter = share.submitter AND job.priority = share.priority
                 AND finished_at_ms IS NULL AND paused = 0)",
            "SELECT count(*) FROM job WHERE finished_at_ms IS NOT NULL AND cleanup IS NULL AND EXISTS (
                 SELECT 1 FROM tile WHERE tile.job = job.number AND state IN ('ready', 'leased'))",
        ];
        let all = CHECKS.map(|check| format!("SELECT ({check}) AS wrong")).join(" UNION ALL ");
        let wrong: Vec<i64> = db::made_query(all).scalar().fetch_all(self.queue.readers()).await.expect("counts");
        for (check, wrong) in CHECKS.iter().zip(wrong) {
            assert_eq!(wrong, 0, "{check}");
        }
    }
}

fn new_job(frames: u32) -> NewJob {
    let plan = TilePlan { width_px: 128, height_px: 96, samples: 1, pixel_bytes: 16, edge_px: Some(32), frames };
    NewJob::of_plan("local", plan)
}

/// Opening of a frame, whose key belongs to it alone.
fn opening(job: i64, frame: u32, plan: TilePlan) -> FrameOpening {
    let picture_key = format!("key {job} {frame}");
    FrameOpening { job, frame, picture_key, scene: None, tiles: plan.tiles(), samples: plan.samples }
}

fn speed(rays_per_second: f64) -> Option<RaysPerSecond> {
    RaysPerSecond::new(rays_per_second)
}

fn turn(worker: WorkerId) -> SyncInput {
    SyncInput {
        worker,
        owner: "local".to_owned(),
        rays_per_second: None,
        held_leases: Vec::new(),
        reports: Vec::new(),
        records: Vec::new(),
        rejected: Vec::new(),
        checked: None,
        wants_work: false,
        beside: false,
        shutting_down: false,
        opening: None,
        passed: PassedJobs::default(),
        max_batches: 1,
        next_openings: Vec::new(),
    }
}

fn leases(run: &proto::worker_protocol::Batch) -> impl Iterator<Item = proto::LeaseId> {
    run.leases().map(|(lease, _)| lease)
}

#[tokio::test]
async fn a_full_disk_rejects_jobs_until_space_is_freed() {
    if postgres_server::server().is_some() {
        return;
    }
    let bench = Fixture::new().await;
    let worker = bench.worker(None).await;
    let limit = async |statement: &'static str| {
        bench
            .queue
            .database
            .write(db::Durability::Relaxed, move |connection| {
                Box::pin(async move {
                    db::query(statement).execute(connection).await?;
                    Ok(())
                })
            })
            .await
            .expect("sets the limit");
    };
    limit("PRAGMA max_page_count = 1").await;
    let mut new = new_job(1);
    new.file_text = " ".repeat(1 << 20);
    let refused = bench.queue.submit(new.clone()).await.expect_err("there is no room");
    assert!(refused.is_full(), "{refused:?}");
    limit("PRAGMA max_page_count = 1000000").await;
    bench.queue.submit(new).await.expect("there is room");
    let said = SyncInput { wants_work: true, ..turn(worker) };
    assert!(matches!(bench.turn(said).await.expect("known").next, NextWork::Run(_)));
    bench.check().await;
}

#[tokio::test]
async fn a_failing_operation_affects_no_other() {
    let bench = Fixture::new().await;
    let good = (0..20).map(|_| bench.queue.submit(new_job(1)));
    let taken = new_job(1);
    bench.queue.submit(taken.clone()).await.expect("accepted");
    let bad = (0..20).map(|_| bench.queue.submit(taken.clone()));
    let (good, bad) = tokio::join!(futures_util::future::join_all(good), futures_util::future::join_all(bad));
    assert!(good.iter().all(Result::is_ok), "{good:?}");
    assert!(bad.iter().all(Result::is_err), "an id is taken once");
    assert_eq!(bench.queue.jobs(None, None, 1000, None).await.expect("lists").jobs.len(), 21);
}

#[tokio::test]
async fn a_job_of_unknown_size_goes_to_any_worker() {
    let bench = Fixture::new().await;
    let worker = bench.worker(Some(1)).await;
    let job = bench.submit(1, 0).await;
    let said = SyncInput { wants_work: true, ..turn(worker) };
    let NextWork::Run(run) = bench.turn(said).await.expect("known").next else { panic!("there is work") };
    assert_eq!(run.job, job);
}

/// Runs a statement in the writer.
async fn execute(bench: &Fixture, statement: &'static str) {
    let write = bench.queue.database.write(db::Durability::Relaxed, move |connection| {
        Box::pin(async move {
            db::query(statement).execute(connection).await?;
            Ok(())
        })
    });
    write.await.expect("executes");
}

#[tokio::test]
async fn a_claim_that_fails_takes_no_results_with_it() {
    let bench = Fixture::new().await;
    let worker = bench.worker(None).await;
    let (first, second) = (bench.submit(1, 1).await, bench.submit(1, 1).await);
    let asks = SyncInput { wants_work: true, rays_per_second: speed(1e9), ..turn(worker) };
    let NextWork::Run(run) = bench.turn(asks.clone()).await.expect("known").next else { panic!("there is work") };
    assert_eq!(run.job, first);
    if postgres_server::server().is_some() {
        execute(
            &bench,
            "CREATE FUNCTION refuse() RETURNS trigger LANGUAGE plpgsql AS 'BEGIN RAISE ''no leases today''; END'",
        )
        .await;
        execute(&bench, "CREATE TRIGGER broken BEFORE INSERT ON lease EXECUTE FUNCTION refuse()").await;
    } else {
        execute(
            &bench,
            "CREATE TRIGGER broken BEFORE INSERT ON lease BEGIN SELECT raise(ABORT, 'no leases today'); END",
        )
        .await;
    }
    let hash = blake3::hash(b"pixels").to_hex().to_string();
    let outcome = proto::worker_protocol::LeaseOutcome::Picture { hash, size_bytes: 1 };
    let reports = leases(&run).map(|lease| proto::worker_protocol::LeaseReport { lease, outcome: outcome.clone() });
    let synced = bench.turn(SyncInput { reports: reports.collect(), ..asks.clone() }).await.expect("known");
    assert!(matches!(synced.next, NextWork::Nothing(Some(_))), "{:?}", synced.next);
    assert_eq!(synced.revoked_leases, []);
    let state = bench.queue.job(first).await.expect("reads").expect("a job").state;
    assert_eq!(state, proto::job::JobState::Succeeded, "the result counts");
    bench.check().await;
    execute(
        &bench,
        if postgres_server::server().is_some() { "DROP TRIGGER broken ON lease" } else { "DROP TRIGGER broken" },
    )
    .await;
    let NextWork::Run(run) = bench.turn(asks).await.expect("known").next else { panic!("there is work") };
    assert_eq!(run.job, second);
    bench.check().await;
}
