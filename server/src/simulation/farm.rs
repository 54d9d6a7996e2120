//! Plays a scenario: a loop over events in virtual time. The queue is the real one; only workers and the clock are
//! simulated.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap, HashSet, VecDeque};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use futures_util::FutureExt;
use proto::JobId;
use proto::worker_protocol::{Batch, LeaseReport, RegisterRequest};

use super::SimulationError;
use super::random::Random;
use super::scenario::{JobPlan, Scenario};
use super::worker::{Run, SimulatedWorker};
use crate::clock::{Clock, ManualClock};
use crate::db::Database;
use crate::queue::{FrameOpening, NewJob, NewWorker, NextWork, Queue, SubmitOptions, SubmitOutcome, SyncInput};

/// Length of a lease: no simulated worker vanishes, so none has to renew.
const LEASE_MS: i64 = 24 * 3_600_000;
/// Idle workers ask again after this time, as in the worker's session.
const IDLE_US: u64 = 10_000_000;
/// After this many idle workers in a row got nothing, the others are not woken: they would get nothing either.
const MAX_REFUSED: u32 = 16;
/// Part of the batches in which a tile fails.
const FAILURES: f64 = 0.002;
/// A scenario that takes longer than this cannot end.
const MAX_VIRTUAL_US: u64 = 24 * 3_600_000_000;

/// An event at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Event {
    /// A worker's batch of this generation ends, or its pause, or its wait for work.
    Turn { worker: usize, generation: u64 },
    /// Idle workers ask for work.
    Wake,
}

/// Time for which a worker rendered for a submitter.
#[derive(Clone, Copy, Debug)]
pub(super) struct ServedTime {
    /// Index of the job.
    pub(super) job: usize,
    /// Start and end.
    pub(super) start_us: u64,
    pub(super) end_us: u64,
}

/// Everything that happened.
#[derive(Debug, Default)]
pub(super) struct Ledger {
    /// Batches, including dropped ones.
    pub(super) served: Vec<ServedTime>,
    /// Time of the last result of each job.
    pub(super) ends_us: Vec<u64>,
    /// Requests for work, and batches granted.
    pub(super) turns: u64,
    /// Batches that were whole frames.
    pub(super) whole_frames: u64,
    /// Stitches.
    pub(super) stitches: u64,
    /// Batches that failed, and batches dropped because another worker was first.
    pub(super) failures: u64,
    pub(super) dropped: u64,
}

/// Farm under way.
pub(super) struct SimulatedFarm {
    database: Arc<Database>,
    queue: Queue,
    hand: ManualClock,
    now_us: u64,
    events: BinaryHeap<Reverse<(u64, u64, Event)>>,
    /// Number of events so far: events of one time happen in their order.
    event_count: u64,
    pub(super) workers: Vec<SimulatedWorker>,
    pub(super) jobs: Vec<JobPlan>,
    by_id: HashMap<JobId, usize>,
    /// Workers that got nothing, with the generation in which they asked: they may have asked again since.
    idle: VecDeque<(usize, u64)>,
    /// Workers that hold a tile: job, frame, index; a stitch has no index.
    holders: HashMap<(usize, u32, Option<u32>), Vec<usize>>,
    stored: HashSet<(usize, u32)>,
    frames_left: u64,
    random: Random,
    pub(super) ledger: Ledger,
}

impl SimulatedFarm {
    /// Opens a queue in an empty folder, and registers the workers and submits the jobs of a scenario.
    pub(super) async fn new(folder: &Path, scenario: &Scenario, seed: u64) -> Result<Self, SimulationError> {
        let database = Database::open(folder).await.map_err(|error| SimulationError::Open(Box::new(error)))?;
        let (database, (clock, hand)) = (Arc::new(database), Clock::manual());
        let (queue, _) = Queue::open(Arc::clone(&database), clock, LEASE_MS, "simulated").await?;
        let mut workers = Vec::with_capacity(scenario.workers.len());
        for plan in &scenario.workers {
            let request = RegisterRequest {
                name: String::new(),
                device: plan.device.to_owned(),
                picture_version: scene::PICTURE_VERSION,
                max_nodes: None,
                process: 0,
            };
            let new = NewWorker { request, pool: false, name: "simulated".to_owned(), owner: "local".to_owned() };
            let worker = SimulatedWorker::new(queue.register(new).await?.worker, *plan);
            queue.turn(sync_input(&worker, Vec::new(), false)).await?;
            workers.push(worker);
        }
        let mut by_id = HashMap::new();
        for (index, plan) in scenario.jobs.iter().enumerate() {
            let new = new_job(plan);
            by_id.insert(new.id, index);
            match queue.submit_with(new, SubmitOptions::default()).await? {
                SubmitOutcome::Created(_) => {}
                other @ (SubmitOutcome::Replayed(_) | SubmitOutcome::KeyReused | SubmitOutcome::Rejected(_)) => {
                    return Err(SimulationError::Rejected(format!("{other:?}")));
                }
            }
        }
        let frames_left = scenario.jobs.iter().map(|job| u64::from(job.plan.frames)).sum();
        Ok(Self {
            database,
            queue,
            hand,
            now_us: 0,
            events: BinaryHeap::new(),
            event_count: 0,
            idle: (0..workers.len()).map(|worker| (worker, 0)).collect(),
            workers,
            jobs: scenario.jobs.clone(),
            by_id,
            holders: HashMap::new(),
            stored: HashSet::new(),
            frames_left,
            random: Random::new(seed ^ u64::from(u32::MAX)),
            ledger: Ledger { ends_us: vec![0; scenario.jobs.len()], ..Ledger::default() },
        })
    }

    /// Plays until every frame is stored; returns the time of the last result, in microseconds.
    pub(super) async fn play(&mut self) -> Result<u64, SimulationError> {
        self.schedule(0, Event::Wake);
        while self.frames_left > 0 {
            let Some(Reverse((at_us, _, event))) = self.events.pop().filter(|event| event.0.0 < MAX_VIRTUAL_US) else {
                return Err(SimulationError::Stuck { frames: self.frames_left });
            };
            self.hand.advance(Duration::from_millis(at_us / 1000 - self.now_us / 1000));
            self.now_us = at_us;
            match event {
                Event::Turn { worker, generation } if self.workers[worker].generation == generation => {
                    self.turn(worker).await?;
                }
                Event::Turn { .. } => {}
                Event::Wake => self.wake_idle().await?,
            }
        }
        self.database.close().await;
        Ok(self.ledger.ends_us.iter().copied().max().unwrap_or(0))
    }

    fn schedule(&mut self, at_us: u64, event: Event) {
        self.event_count += 1;
        self.events.push(Reverse((at_us, self.event_count, event)));
    }

    /// Lets idle workers ask, the one that has waited longest first, until several in a row get nothing.
    async fn wake_idle(&mut self) -> Result<(), SimulationError> {
        let mut refused = 0;
        for _ in 0..self.idle.len() {
            let Some((worker, generation)) = self.idle.pop_front() else { break };
            if self.workers[worker].generation != generation {
                continue;
            }
            self.turn(worker).await?;
            refused = if self.workers[worker].run.is_some() { 0 } else { refused + 1 };
            if refused == MAX_REFUSED {
                break;
            }
        }
        Ok(())
    }

    /// Reports a worker's batch, if it has one, and requests the next.
    async fn turn(&mut self, worker: usize) -> Result<(), SimulationError> {
        let run = self.workers[worker].end(self.now_us);
        self.workers[worker].generation += 1;
        let reports = run.as_ref().map(Run::reports).unwrap_or_default();
        let mut input = sync_input(&self.workers[worker], reports, true);
        let queue = self.queue.clone();
        let mut woken = Box::pin(queue.wake_signals().work.notified());
        woken.as_mut().enable();
        let mut revoked = Vec::new();
        let next = loop {
            self.ledger.turns += 1;
            let outcome = queue.turn(input.clone()).await?.ok_or(SimulationError::UnknownWorker)?;
            revoked.extend(outcome.revoked_leases);
            let NextWork::OpenFrame { job, frame, plan } = outcome.next else { break outcome.next };
            let (picture_key, tiles) = (format!("{job} {frame}"), plan.tiles());
            input = input.without_reports();
            input.opening = Some(FrameOpening { job, frame, picture_key, scene: None, tiles, samples: plan.samples });
        };
        if let Some(mut run) = run {
            run.leases.retain(|(lease, _)| !revoked.contains(lease));
            self.settle(worker, &run);
        }
        match next {
            NextWork::Run(batch) => self.start(worker, batch)?,
            NextWork::Nothing(retry_ms) => {
                let generation = self.workers[worker].generation;
                self.idle.push_back((worker, generation));
                let wait_us = retry_ms.map_or(IDLE_US, |ms| (ms.max(1).unsigned_abs() * 1000).min(IDLE_US));
                self.schedule(self.now_us + wait_us, Event::Turn { worker, generation });
            }
            NextWork::OpenFrame { .. } => {}
        }
        if woken.now_or_never().is_some() && !self.idle.is_empty() {
            self.schedule(self.now_us, Event::Wake);
        }
        Ok(())
    }

    fn start(&mut self, worker: usize, batch: Batch) -> Result<(), SimulationError> {
        let job = *self.by_id.get(&batch.job).ok_or(SimulationError::UnknownJob)?;
        let draws = [self.random.unit(), self.random.unit()];
        let simulated = &mut self.workers[worker];
        simulated.start(batch, (job, &self.jobs[job]), draws, FAILURES, self.now_us);
        let generation = simulated.generation;
        let Some(run) = &simulated.run else { return Ok(()) };
        for &(_, tile) in &run.leases {
            self.holders.entry((job, run.frame, tile)).or_default().push(worker);
        }
        let is_stitch = run.leases.iter().all(|(_, tile)| tile.is_none());
        self.ledger.stitches += u64::from(is_stitch);
        self.ledger.whole_frames += u64::from(run.is_picture && !is_stitch);
        self.ledger.failures += u64::from(run.fails());
        let at_us = run.end_us + run.pause_us();
        self.schedule(at_us, Event::Turn { worker, generation });
        Ok(())
    }

    /// Records the results that counted, and drops them at other workers.
    fn settle(&mut self, worker: usize, run: &Run) {
        self.ledger.served.push(ServedTime { job: run.job, start_us: run.start_us, end_us: self.now_us });
        if run.leases.is_empty() {
            return;
        }
        if run.is_picture && !run.fails() && self.stored.insert((run.job, run.frame)) {
            self.frames_left -= 1;
            self.ledger.ends_us[run.job] = self.now_us;
        }
        for &(_, tile) in run.leases.iter().skip(usize::from(run.fails())) {
            let key = (run.job, run.frame, tile);
            for other in self.holders.remove(&key).unwrap_or_default() {
                if other != worker {
                    self.drop_tile(other, key);
                }
            }
        }
        if run.fails() {
            let key = (run.job, run.frame, run.leases[0].1);
            if let Some(holders) = self.holders.get_mut(&key) {
                holders.retain(|&holder| holder != worker);
            }
        }
    }

    /// A worker stops when it holds no tile of its batch any more.
    fn drop_tile(&mut self, worker: usize, (job, frame, tile): (usize, u32, Option<u32>)) {
        let Some(run) = self.workers[worker].run.as_mut().filter(|run| (run.job, run.frame) == (job, frame)) else {
            return;
        };
        run.leases.retain(|&(_, held)| held != tile);
        if run.leases.is_empty() {
            self.ledger.dropped += 1;
            if let Some(run) = self.workers[worker].end(self.now_us) {
                self.ledger.served.push(ServedTime { job, start_us: run.start_us, end_us: self.now_us });
            }
            let generation = self.workers[worker].generation;
            self.schedule(self.now_us + 1000, Event::Turn { worker, generation });
        }
    }
}

fn sync_input(worker: &SimulatedWorker, reports: Vec<LeaseReport>, wants_work: bool) -> SyncInput {
    SyncInput {
        worker: worker.id,
        owner: "local".to_owned(),
        rays_per_second: worker.reported(),
        held_leases: Vec::new(),
        reports,
        records: Vec::new(),
        rejected: Vec::new(),
        checked: None,
        wants_work,
        shutting_down: false,
        opening: None,
        max_batches: 1,
        next_openings: Vec::new(),
    }
}

fn new_job(plan: &JobPlan) -> NewJob {
    NewJob {
        id: JobId::new(),
        name: String::new(),
        submitter: plan.submitter.to_owned(),
        priority: 0,
        nodes: 1,
        plan: plan.plan,
        media_type: "image/png",
        warnings: Vec::new(),
        no_cache: true,
        retention: None,
        tile_seconds: 600,
        recorded: false,
        based_on: None,
        file_text: "{}".to_owned(),
    }
}
