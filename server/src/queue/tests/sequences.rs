//! Random operations on the real queue and on its model: after each, both must agree, and the rows must be
//! consistent. A failure prints the shortest failing sequence and its seed.

use std::time::Duration;

use proptest::prelude::{Just, Strategy, any, prop_oneof};
use proptest::test_runner::{Config, RngAlgorithm, TestCaseError, TestRng, TestRunner};
use proto::bounded::RaysPerSecond;
use proto::job::JobPatch;
use proto::worker_protocol::{Batch, BatchWork, LeaseOutcome, LeaseReport};
use proto::{JobId, LeaseId, WorkerId};

use super::model::{Model, TILES};
use super::{Fixture, leases, new_job, opening, turn};
use crate::queue::{BacklogLimits, DeleteOutcome, LeaseEnd, NewJob, NewWebhook, NextWork, SubmitOptions, SyncInput};

/// Number of sequences in every run of the tests.
const SEQUENCES: u32 = 100;
/// Number of sequences in the long tests.
const MANY_SEQUENCES: u32 = 500;
/// Maximum number of operations in a sequence.
const OPERATIONS: usize = 40;
/// Rows of a piece of a large change: so few that most changes take several pieces.
const FEW_ROWS: i64 = 4;
/// Scenes with more nodes count as large.
const SMALL_NODES: u32 = 500;

#[derive(Clone, Debug)]
pub(super) enum Operation {
    Submit {
        submitter: u8,
        frames: u32,
        large: bool,
        priority: i32,
    },
    Claim {
        worker: usize,
        fast: bool,
    },
    Report {
        worker: usize,
        run: usize,
        outcome: u8,
    },
    Pass {
        ms: i64,
    },
    Cancel(usize),
    Pause(usize, bool),
    PauseFarm(bool),
    Retry(usize),
    Move(usize, i32),
    Delete(usize),
    /// Index among the pool workers, which are the last two.
    Reap {
        worker: usize,
        crashed: bool,
    },
    Restart,
    Tidy,
    /// Makes one piece of what is left of large changes.
    CleanUp,
}

fn operation() -> impl Strategy<Value = Operation> {
    let (worker, job) = (0..3_usize, 0..8_usize);
    prop_oneof![
        3 => (0..3_u8, 1..3_u32, any::<bool>(), -1..=1_i32).prop_map(|(submitter, frames, large, priority)| {
            Operation::Submit { submitter, frames, large, priority }
        }),
        12 => (worker.clone(), any::<bool>()).prop_map(|(worker, fast)| Operation::Claim { worker, fast }),
        14 => (worker, 0..4_usize, any::<u8>()).prop_map(|(worker, run, outcome)| {
            Operation::Report { worker, run, outcome }
        }),
        4 => (1..700_i64).prop_map(|ms| Operation::Pass { ms }),
        1 => job.clone().prop_map(Operation::Cancel),
        1 => (job.clone(), any::<bool>()).prop_map(|(job, paused)| Operation::Pause(job, paused)),
        1 => any::<bool>().prop_map(Operation::PauseFarm),
        2 => job.clone().prop_map(Operation::Retry),
        1 => (job.clone(), -1..=1_i32).prop_map(|(job, priority)| Operation::Move(job, priority)),
        1 => job.prop_map(Operation::Delete),
        1 => (1..3_usize, any::<bool>()).prop_map(|(worker, crashed)| Operation::Reap { worker, crashed }),
        1 => Just(Operation::Restart),
        1 => Just(Operation::Tidy),
        2 => Just(Operation::CleanUp),
    ]
}

/// Webhooks of some jobs.
fn webhooks() -> Vec<NewWebhook> {
    let webhook = |name: &str, events| NewWebhook {
        url: format!("https://{name}.example/"),
        target: format!("{name}.example:443"),
        events,
    };
    vec![
        webhook("frames", vec!["frame.stored", "job.failed"]),
        webhook("states", vec!["job.queued", "job.running", "job.succeeded", "job.failed", "job.cancelled"]),
    ]
}

/// Worker of a sequence: its registration, and the batches it was granted.
struct Worker {
    id: WorkerId,
    takes_large: bool,
    pool: bool,
    runs: Vec<Batch>,
}

impl Worker {
    fn holding(&self) -> Vec<LeaseId> {
        self.runs.iter().flat_map(leases).collect()
    }
}

/// Queue under test with its model.
pub(super) struct Pair {
    pub(super) bench: Fixture,
    model: Model,
    jobs: Vec<JobId>,
    workers: Vec<Worker>,
    count: u32,
}

impl Pair {
    pub(super) async fn new(mut bench: Fixture) -> Self {
        bench.queue.piece_rows = FEW_ROWS;
        let mut pair = Self { bench, model: Model::default(), jobs: Vec::new(), workers: Vec::new(), count: 0 };
        for (takes_large, pool) in [(true, false), (false, true), (true, true)] {
            let id = pair.register(takes_large, pool).await;
            pair.workers.push(Worker { id, takes_large, pool, runs: Vec::new() });
        }
        pair
    }

    async fn register(&mut self, takes_large: bool, pool: bool) -> WorkerId {
        self.count += 1;
        let max_nodes = (!takes_large).then_some(SMALL_NODES);
        self.bench.register(max_nodes, pool.then_some(self.count)).await
    }

    fn job(&self, index: usize) -> Option<JobId> {
        self.jobs.get(index % self.jobs.len().max(1)).copied()
    }

    /// A worker's sync; an unknown worker registers again. Returns the granted and the revoked leases.
    async fn call(&mut self, index: usize, results: Vec<LeaseReport>, claim: Option<f64>) -> Option<Batch> {
        let worker = &self.workers[index];
        let (id, holding) = (worker.id, worker.holding());
        let mut said = SyncInput {
            reports: results.clone(),
            held_leases: holding.clone(),
            wants_work: claim.is_some(),
            rays_per_second: claim.and_then(RaysPerSecond::new),
            // The second worker takes several frames at a time.
            max_batches: if index == 1 { 3 } else { 1 },
            ..turn(id)
        };
        let mut lost = Vec::new();
        let runs: Vec<Batch> = loop {
            let Some(synced) = self.bench.queue.turn(said.clone()).await.expect("a sync") else {
                let (takes_large, pool) = (worker.takes_large, worker.pool);
                let id = self.register(takes_large, pool).await;
                self.workers[index].id = id;
                return None;
            };
            lost.extend(synced.revoked_leases);
            let NextWork::OpenFrame { job, frame, plan } = synced.next else {
                break if let NextWork::Run(run) = synced.next {
                    std::iter::once(run).chain(synced.more).collect()
                } else {
                    Vec::new()
                };
            };
            said.reports.clear();
            said.opening = Some(opening(job, frame, plan));
            said.next_openings = (frame + 1..plan.frames).map(|frame| opening(job, frame, plan)).collect();
        };
        let mut expected = self.model.report(id, &results, &holding);
        lost.sort();
        lost.dedup();
        expected.sort();
        assert_eq!(lost, expected, "leases revoked from worker {index}");
        let worker = &mut self.workers[index];
        for run in &runs {
            self.model.grant(id, worker.takes_large, run);
            worker.runs.push(run.clone());
        }
        // Half of the workers drop revoked leases; the others report results for them anyway.
        if index == 0 {
            worker.runs.retain(|run| !leases(run).all(|lease| lost.contains(&lease)));
        }
        runs.into_iter().next()
    }

    async fn report(&mut self, index: usize, run: usize, die: u8) {
        let runs = &mut self.workers[index].runs;
        if runs.is_empty() {
            return;
        }
        let run = runs.swap_remove(run % runs.len());
        let (stitch, whole) = match run.work {
            BatchWork::Stitch { .. } => (true, false),
            BatchWork::Render { whole_frame, .. } => (false, whole_frame),
        };
        self.count += 1;
        let hash = blake3::hash(&self.count.to_le_bytes()).to_hex().to_string();
        let outcome = match die % 8 {
            0 => LeaseOutcome::Released,
            1 | 2 => LeaseOutcome::Failed { message: "no".to_owned() },
            3 if stitch => LeaseOutcome::BadBlobs { tiles: vec![u32::from(die) % TILES, 3] },
            4 if whole => LeaseOutcome::Blob { hash, size_bytes: 1 },
            _ if stitch || whole => LeaseOutcome::Picture { hash, size_bytes: 1 },
            _ => LeaseOutcome::Blob { hash, size_bytes: 1 },
        };
        // Some workers report only part of their results.
        let skipped = usize::from(die >= 200);
        let results = leases(&run).skip(skipped).map(|lease| LeaseReport { lease, outcome: outcome.clone() }).collect();
        self.call(index, results, None).await;
    }

    async fn pass(&mut self, ms: i64) {
        self.bench.hand.advance(Duration::from_millis(ms.unsigned_abs()));
        self.bench.queue.expire_leases().await.expect("rescues");
        self.model.pass(ms);
    }

    async fn reap(&mut self, index: usize, cause: LeaseEnd) {
        let worker = &mut self.workers[index];
        worker.runs.clear();
        let process = self.bench.process(worker.id).await;
        let reaped = self.bench.queue.worker_exited(process, cause, "it ended".to_owned()).await.expect("reaps");
        if reaped.is_some() {
            self.model.reap(worker.id, cause, "it ended");
        }
    }

    async fn restart(&mut self) {
        self.bench.restart().await;
        self.bench.queue.piece_rows = FEW_ROWS;
        let pool: Vec<WorkerId> = self.workers.iter().filter(|worker| worker.pool).map(|worker| worker.id).collect();
        self.model.restart(&pool);
    }

    async fn submit(&mut self, new: NewJob, large: bool) {
        let (id, frames) = (new.id, new.plan.frames);
        let webhooks = if new.submitter == "0" { webhooks() } else { Vec::new() };
        let received = webhooks.iter().map(|webhook| (webhook.url.clone(), webhook.events.clone())).collect();
        let options = SubmitOptions { webhooks, ..SubmitOptions::default() };
        self.bench.queue.submit_with(new, options).await.expect("accepted");
        self.model.submit(id, frames, large, received);
        self.jobs.push(id);
    }

    async fn delete(&mut self, id: JobId) {
        let deleted = self.bench.queue.delete(id).await.expect("a response");
        if let DeleteOutcome::Done(_) = deleted {
            assert_ne!(self.model.jobs.get(&id).expect("known").state, proto::job::JobState::Running);
            self.model.delete(id);
            self.jobs.retain(|job| *job != id);
        }
    }

    pub(super) async fn apply(&mut self, operation: &Operation) {
        let queue = &self.bench.queue;
        match *operation {
            Operation::Submit { submitter, frames, large, priority } => {
                let nodes = if large { SMALL_NODES + 1 } else { SMALL_NODES };
                let new = NewJob { submitter: submitter.to_string(), nodes, priority, ..new_job(frames) };
                self.submit(new, large).await;
            }
            Operation::Claim { worker, fast } => {
                // A slow worker takes tiles, a fast one the complete frame.
                self.call(worker, Vec::new(), Some(if fast { 1e9 } else { 3000.0 })).await;
            }
            Operation::Report { worker, run, outcome } => self.report(worker, run, outcome).await,
            Operation::Pass { ms } => self.pass(ms).await,
            Operation::Reap { worker, crashed } => {
                self.reap(worker, if crashed { LeaseEnd::Crashed } else { LeaseEnd::Lost }).await;
            }
            Operation::Restart => self.restart().await,
            Operation::Tidy => queue.prune().await.expect("tidies"),
            Operation::CleanUp => drop(queue.clean_up_piece().await.expect("a piece")),
            Operation::PauseFarm(paused) => {
                queue.pause_all(paused).await.expect("a response");
                self.model.farm_paused = paused;
            }
            Operation::Cancel(job)
            | Operation::Pause(job, _)
            | Operation::Retry(job)
            | Operation::Move(job, _)
            | Operation::Delete(job) => {
                let Some(id) = self.job(job) else { return };
                match *operation {
                    Operation::Cancel(_) => {
                        queue.cancel(id).await.expect("a response");
                        self.model.cancel(id);
                    }
                    Operation::Pause(_, paused) => self.pause(id, paused).await,
                    Operation::Retry(_) => {
                        queue.retry(id, BacklogLimits::default()).await.expect("a response");
                        self.model.retry(id);
                    }
                    Operation::Move(_, priority) => {
                        queue.patch(id, JobPatch { priority: Some(priority) }).await.expect("a response");
                    }
                    _ => self.delete(id).await,
                }
            }
        }
    }

    async fn pause(&mut self, id: JobId, paused: bool) {
        self.bench.queue.pause(id, paused, None).await.expect("a response");
        let job = self.model.jobs.get_mut(&id).expect("known");
        if !job.state.is_final() {
            job.paused = paused;
        }
    }

    async fn check(&self) {
        self.bench.check().await;
        self.model.compare_outbox(self.bench.queue.readers()).await;
        for id in &self.jobs {
            self.model.compare(*id, self.bench.queue.job(*id).await.expect("reads").as_ref());
        }
    }

    /// A healthy worker finishes the rest: no job is lost.
    pub(super) async fn work_off(&mut self) {
        self.apply(&Operation::PauseFarm(false)).await;
        for id in self.jobs.clone() {
            self.pause(id, false).await;
        }
        // The pool workers exit, so that no work waits for them.
        for index in 1..self.workers.len() {
            self.reap(index, LeaseEnd::Lost).await;
        }
        self.workers[0].runs.clear();
        for _ in 0..400 {
            if self.model.jobs.values().all(|job| job.state.is_final()) {
                return;
            }
            self.apply(&Operation::CleanUp).await;
            // A worker that was away for a long time registers first.
            let mut run = self.call(0, Vec::new(), Some(1e9)).await;
            if run.is_none() {
                run = self.call(0, Vec::new(), Some(1e9)).await;
            }
            if run.is_some() {
                self.report(0, self.workers[0].runs.len() - 1, 5).await;
            } else {
                self.pass(6000).await;
            }
        }
        let open = self.model.jobs.values().filter(|job| !job.state.is_final()).count();
        panic!("{open} jobs do not finish");
    }
}

async fn run(operations: &[Operation]) {
    let mut pair = Pair::new(Fixture::in_memory().await).await;
    for operation in operations {
        pair.apply(operation).await;
        pair.check().await;
    }
    pair.work_off().await;
    while pair.bench.queue.clean_up_piece().await.expect("a piece").is_some() {}
    pair.check().await;
}

/// Sequences of operations.
pub(super) fn sequence() -> impl Strategy<Value = Vec<Operation>> {
    proptest::collection::vec(operation(), 1..OPERATIONS)
}

#[test]
fn the_queue_matches_its_model() {
    assert_as_its_model(SEQUENCES);
}

#[test]
#[ignore = "long: five times as many random sequences of operations; 30 s"]
fn the_queue_matches_its_model_over_many_sequences() {
    assert_as_its_model(MANY_SEQUENCES);
}

/// A worker that still lived, but did not list leases that it had renewed before, once disagreed with its model.
#[tokio::test]
async fn forgotten_leases_are_released_before_they_expire() {
    let claim = || Operation::Claim { worker: 0, fast: false };
    let submit = Operation::Submit { submitter: 0, frames: 2, large: false, priority: 0 };
    let [first, second, third] = [706, 648, 646].map(|ms| Operation::Pass { ms });
    run(&[submit, claim(), claim(), first, claim(), second, claim(), third]).await;
}

fn assert_as_its_model(cases: u32) {
    let config = Config { cases, failure_persistence: None, max_shrink_time: 60_000, ..Config::default() };
    let seed = std::env::var("SDFARM_SEED").ok().and_then(|seed| seed.parse().ok());
    let seed: u64 = seed.unwrap_or_else(|| uuid::Uuid::new_v4().as_u64_pair().0);
    eprintln!("SDFARM_SEED={seed} repeats these sequences");
    let bytes: Vec<u8> = seed.to_le_bytes().repeat(4);
    let mut runner = TestRunner::new_with_rng(config, TestRng::from_seed(RngAlgorithm::ChaCha, &bytes));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    let outcome = runner.run(&sequence(), |operations| {
        let sound = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| runtime.block_on(run(&operations))));
        sound.map_err(|panic| {
            let text = panic.downcast_ref::<String>().cloned();
            TestCaseError::fail(text.unwrap_or_else(|| "it panicked".to_owned()))
        })
    });
    if let Err(error) = outcome {
        panic!("{error}");
    }
}
