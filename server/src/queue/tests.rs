//! What can't be seen through the door: that the statements of a claim use indexes, and that a
//! job's counters are those of its tiles whatever happens.

mod fair;

use proto::work::{Hello, Outcome, Report, Work};
use proto::{JobId, WorkerId};
use sqlx::Row;

use super::{NewJob, NewWorker, Next, Opening, Queue, Turn};
use crate::clock::{Clock, Hand};
use crate::plan::Plan;
use crate::store::Store;

const LEASE_MS: i64 = 1000;

struct Bench {
    queue: Queue,
    hand: Hand,
    _folder: tempfile::TempDir,
}

impl Bench {
    async fn new() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let store = Store::open(folder.path()).await.expect("opens");
        let (clock, hand) = Clock::by_hand();
        let (queue, _) = Queue::open(store.into(), clock, LEASE_MS).await.expect("opens");
        Self { queue, hand, _folder: folder }
    }

    async fn submit(&self, frames: u32, nodes: u32) -> JobId {
        let new = NewJob { nodes, ..new_job(frames) };
        let id = new.id;
        self.queue.submit(new).await.expect("accepted");
        id
    }

    async fn worker(&self, max_nodes: Option<u32>) -> WorkerId {
        let hello = Hello { name: String::new(), device: "cpu".to_owned(), picture_version: 1, max_nodes, process: 1 };
        let new = NewWorker { hello, pool: false, name: "test".to_owned() };
        self.queue.register(new).await.expect("registered").worker
    }

    /// A worker's turn, with frames opened as they are needed.
    async fn turn(&self, mut turn: Turn) -> Option<super::Turned> {
        loop {
            let turned = self.queue.turn(turn.clone()).await.expect("a turn")?;
            let Next::Frame { job, frame, plan } = turned.next else { return Some(turned) };
            let picture_key = format!("key {job} {frame}");
            turn.results.clear();
            turn.opening = Some(Opening { job, frame, picture_key, tiles: plan.tiles(), samples: plan.samples });
        }
    }

    /// Asserts that every job's and frame's counters are those of their tiles.
    async fn check(&self) {
        for query in [
            "SELECT count(*) FROM job WHERE tiles_done + 0 <> (
                 SELECT count(*) FROM tile WHERE tile.job = job.number AND kind = 'render' AND state = 'done')",
            "SELECT count(*) FROM job WHERE rays_done <> (
                 SELECT coalesce(sum(rays), 0) FROM tile WHERE tile.job = job.number AND kind = 'render' AND state = 'done')",
            "SELECT count(*) FROM job WHERE tiles_dead <> (
                 SELECT count(*) FROM tile WHERE tile.job = job.number AND state = 'dead')",
            "SELECT count(*) FROM job WHERE frames_stored <> (
                 SELECT count(*) FROM frame WHERE frame.job = job.number AND state = 'stored')",
            "SELECT count(*) FROM frame WHERE tiles_done <> (
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
            "SELECT count(*) FROM job WHERE finished_at_ms IS NOT NULL AND EXISTS (
                 SELECT 1 FROM tile WHERE tile.job = job.number AND state IN ('ready', 'leased'))",
        ] {
            let wrong: i64 = sqlx::query_scalar(query).fetch_one(self.queue.readers()).await.expect("counts");
            assert_eq!(wrong, 0, "{query}");
        }
    }
}

fn new_job(frames: u32) -> NewJob {
    NewJob {
        id: JobId::new(),
        name: String::new(),
        submitter: "local".to_owned(),
        priority: 0,
        nodes: 1,
        plan: Plan { width_px: 128, height_px: 96, samples: 1, pixel_bytes: 16, edge_px: Some(32), frames },
        media_type: "image/png",
        warnings: Vec::new(),
        fresh: true,
        keep: None,
        text: "{}".to_owned(),
    }
}

fn turn(worker: WorkerId) -> Turn {
    Turn {
        worker,
        rays_per_second: None,
        holding: Vec::new(),
        results: Vec::new(),
        wants_work: false,
        leaving: false,
        opening: None,
    }
}

#[tokio::test]
async fn a_claim_reads_no_table_from_end_to_end() {
    let bench = Bench::new().await;
    // Of what is left to do, and of stitches that are ready: both are short, or ordered as they are read.
    let indexed = ["USING INDEX share_by_turn", "USING INDEX worker_present", "USING INDEX tile_stitch"];
    for statement in [
        concat!("EXPLAIN QUERY PLAN ", include_str!("next_job.sql")),
        concat!("EXPLAIN QUERY PLAN ", include_str!("next_tile.sql")),
    ] {
        let rows = sqlx::query(statement).fetch_all(bench.queue.readers()).await.expect("explains");
        let plan: Vec<String> = rows.iter().map(|row| row.get::<String, _>("detail")).collect();
        for step in &plan {
            let orderly = step.starts_with("SEARCH")
                || indexed.iter().any(|index| step.ends_with(index))
                || ["SUBQUERY", "BLOOM FILTER"].iter().any(|word| step.contains(word));
            assert!(orderly, "{step} in {plan:?}");
        }
        assert!(plan.iter().any(|step| step.contains("tile_ready")), "{plan:?}");
    }
}

/// A small generator of operations; the seed is in the failure's name.
struct Dice(u64);

impl Dice {
    fn roll(&mut self, sides: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % sides
    }
}

/// What a worker of the random sequence reports for a run it holds.
fn outcome(dice: &mut Dice, stitch: bool, whole: bool) -> Outcome {
    let hash = blake3::hash(&dice.0.to_le_bytes()).to_hex().to_string();
    match dice.roll(8) {
        0 => Outcome::HandedBack,
        1 => Outcome::Failed { message: "no".to_owned() },
        2 if stitch => Outcome::BadBlobs { tiles: vec![dice.roll(12) as u32, 3] },
        _ if stitch || whole => Outcome::Picture { hash, size_bytes: 1 },
        _ => Outcome::Blob { hash, size_bytes: 1 },
    }
}

async fn random_sequence(seed: u64) {
    let bench = Bench::new().await;
    let mut dice = Dice(seed);
    let workers = [bench.worker(None).await, bench.worker(Some(500)).await];
    let mut held: Vec<(WorkerId, proto::work::Run)> = Vec::new();
    let (mut jobs, mut too_large) = (Vec::new(), Vec::new());
    for _ in 0..60 {
        let worker = workers[dice.roll(2) as usize];
        match dice.roll(10) {
            0 => {
                let (frames, large) = (1 + dice.roll(2) as u32, dice.roll(2) == 0);
                let job = bench.submit(frames, if large { 501 } else { 500 }).await;
                jobs.push(job);
                if large {
                    too_large.push(job);
                }
            }
            1 if !jobs.is_empty() => {
                let job = jobs[dice.roll(jobs.len() as u64) as usize];
                bench.queue.cancel(job).await.expect("an answer");
            }
            2 => {
                bench.hand.advance(std::time::Duration::from_millis(300));
                bench.queue.rescue().await.expect("rescues");
            }
            3..6 => {
                // A slow worker takes tiles, a fast one the frame.
                let rays_per_second = Some(if dice.roll(2) == 0 { 3000.0 } else { 1e9 });
                let holding = held.iter().filter(|(who, _)| *who == worker).flat_map(|(_, run)| leases(run)).collect();
                let said = Turn { wants_work: true, rays_per_second, holding, ..turn(worker) };
                if let Some(Next::Run(run)) = bench.turn(said).await.map(|turned| turned.next) {
                    let renders = matches!(run.work, Work::Render { .. });
                    assert!(!(worker == workers[1] && renders && too_large.contains(&run.job)), "{run:?}");
                    held.push((worker, run));
                }
            }
            _ if !held.is_empty() => {
                let (worker, run) = held.swap_remove(dice.roll(held.len() as u64) as usize);
                let (stitch, whole) = match run.work {
                    Work::Stitch { .. } => (true, false),
                    Work::Render { whole_frame, .. } => (false, whole_frame),
                };
                let outcome = outcome(&mut dice, stitch, whole);
                let results = leases(&run).map(|lease| Report { lease, outcome: outcome.clone() }).collect();
                bench.turn(Turn { results, ..turn(worker) }).await;
            }
            _ => {}
        }
        bench.check().await;
    }
}

fn leases(run: &proto::work::Run) -> impl Iterator<Item = proto::LeaseId> {
    let leases: Vec<_> = match &run.work {
        Work::Render { tiles, .. } => tiles.iter().map(|tile| tile.lease).collect(),
        Work::Stitch { lease, .. } => vec![*lease],
    };
    leases.into_iter()
}

#[tokio::test]
async fn counters_are_those_of_the_tiles_whatever_happens() {
    for seed in 0..20 {
        random_sequence(seed).await;
    }
}

#[tokio::test]
async fn a_full_disk_refuses_a_job_and_room_on_it_takes_the_next() {
    let bench = Bench::new().await;
    let worker = bench.worker(None).await;
    let limit = async |statement: &'static str| {
        bench
            .queue
            .store
            .write(crate::store::Durability::Relaxed, move |connection| {
                Box::pin(async move {
                    sqlx::query(statement).execute(connection).await?;
                    Ok(())
                })
            })
            .await
            .expect("sets the limit");
    };
    limit("PRAGMA max_page_count = 1").await;
    let mut new = new_job(1);
    new.text = " ".repeat(1 << 20);
    let refused = bench.queue.submit(new.clone()).await.expect_err("there is no room");
    assert!(refused.is_full(), "{refused:?}");
    limit("PRAGMA max_page_count = 1000000").await;
    bench.queue.submit(new).await.expect("there is room");
    let said = Turn { wants_work: true, ..turn(worker) };
    assert!(matches!(bench.turn(said).await.expect("known").next, Next::Run(_)));
    bench.check().await;
}

#[tokio::test]
async fn an_operation_that_fails_takes_no_other_with_it() {
    let bench = Bench::new().await;
    let good = (0..20).map(|_| bench.queue.submit(new_job(1)));
    let taken = new_job(1);
    bench.queue.submit(taken.clone()).await.expect("accepted");
    let bad = (0..20).map(|_| bench.queue.submit(taken.clone()));
    let (good, bad) = tokio::join!(futures_util::future::join_all(good), futures_util::future::join_all(bad));
    assert!(good.iter().all(Result::is_ok), "{good:?}");
    assert!(bad.iter().all(Result::is_err), "an id is taken once");
    assert_eq!(bench.queue.jobs(None, 1000, None).await.expect("lists").jobs.len(), 21);
}

#[tokio::test]
async fn a_job_whose_nodes_are_not_known_is_for_any_worker() {
    let bench = Bench::new().await;
    let worker = bench.worker(Some(1)).await;
    let job = bench.submit(1, 0).await;
    let said = Turn { wants_work: true, ..turn(worker) };
    let Next::Run(run) = bench.turn(said).await.expect("known").next else { panic!("there is work") };
    assert_eq!(run.job, job);
}
