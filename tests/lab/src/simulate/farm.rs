//! Plays a scenario: a loop over events in virtual time. The queue is the real one; only workers and the clock are
//! simulated.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap, HashSet, VecDeque};
use std::path::Path;
use std::time::Duration;

use anyhow::Context;
use proto::JobId;
use proto::worker_protocol::Batch;
use server::{VirtualQueue, VirtualTurn};

use super::random::Random;
use super::scenario::{JobPlan, Scenario};
use super::worker::{Run, SimulatedWorker};

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
    queue: VirtualQueue,
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
    pub(super) async fn new(folder: &Path, scenario: &Scenario, seed: u64) -> anyhow::Result<Self> {
        let queue = VirtualQueue::open(folder).await?;
        let mut workers = Vec::with_capacity(scenario.workers.len());
        for plan in &scenario.workers {
            let worker = SimulatedWorker::new(queue.register(plan.device).await?, *plan);
            queue.report_speed(worker.id, worker.reported()).await?;
            workers.push(worker);
        }
        let mut by_id = HashMap::new();
        for (index, job) in scenario.jobs.iter().enumerate() {
            by_id.insert(queue.submit(job.submitter, job.tiling, job.frames).await?, index);
        }
        let frames_left = scenario.jobs.iter().map(|job| u64::from(job.frames)).sum();
        Ok(Self {
            queue,
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
    pub(super) async fn play(&mut self) -> anyhow::Result<u64> {
        self.schedule(0, Event::Wake);
        while self.frames_left > 0 {
            let Some(Reverse((at_us, _, event))) = self.events.pop().filter(|event| event.0.0 < MAX_VIRTUAL_US) else {
                anyhow::bail!("{} frames remain, and no worker gets them", self.frames_left);
            };
            self.queue.advance(Duration::from_millis(at_us / 1000 - self.now_us / 1000));
            self.now_us = at_us;
            match event {
                Event::Turn { worker, generation } if self.workers[worker].generation == generation => {
                    self.turn(worker).await?;
                }
                Event::Turn { .. } => {}
                Event::Wake => self.wake_idle().await?,
            }
        }
        self.queue.close().await;
        Ok(self.ledger.ends_us.iter().copied().max().unwrap_or(0))
    }

    fn schedule(&mut self, at_us: u64, event: Event) {
        self.event_count += 1;
        self.events.push(Reverse((at_us, self.event_count, event)));
    }

    /// Lets idle workers ask, the one that has waited longest first, until several in a row get nothing.
    async fn wake_idle(&mut self) -> anyhow::Result<()> {
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
    async fn turn(&mut self, worker: usize) -> anyhow::Result<()> {
        let run = self.workers[worker].end(self.now_us);
        self.workers[worker].generation += 1;
        let reports = run.as_ref().map(Run::reports).unwrap_or_default();
        let asking = &self.workers[worker];
        let turn = self.queue.turn(asking.id, asking.reported(), reports).await?;
        let VirtualTurn { syncs, revoked, batch, retry_ms, is_waking } = turn;
        self.ledger.turns += syncs;
        if let Some(mut run) = run {
            run.leases.retain(|(lease, _)| !revoked.contains(lease));
            self.settle(worker, &run);
        }
        if let Some(batch) = batch {
            self.start(worker, batch)?;
        } else {
            let generation = self.workers[worker].generation;
            self.idle.push_back((worker, generation));
            let wait_us = retry_ms.map_or(IDLE_US, |ms| (ms.max(1).unsigned_abs() * 1000).min(IDLE_US));
            self.schedule(self.now_us + wait_us, Event::Turn { worker, generation });
        }
        if is_waking && !self.idle.is_empty() {
            self.schedule(self.now_us, Event::Wake);
        }
        Ok(())
    }

    fn start(&mut self, worker: usize, batch: Batch) -> anyhow::Result<()> {
        let job = *self.by_id.get(&batch.job).context("the queue granted tiles of a job that was not submitted")?;
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
