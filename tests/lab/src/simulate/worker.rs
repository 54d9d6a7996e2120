//! Simulated worker: how long its batches take, and the speed that it reports.

use proto::bounded::RaysPerSecond;
use proto::worker_protocol::{Batch, BatchWork, LeaseOutcome, LeaseReport};
use proto::{LeaseId, Rect, WorkerId};

use super::random::hashed_unit;
use super::scenario::{JobPlan, WorkerPlan};

/// Batches longer than this are not requested ahead, as in the worker's session.
const SHORT_BATCH_US: u64 = 50_000;
/// Time of a request for work that a worker waits for.
const REQUEST_US: u64 = 1_500;
/// Fixed time of a batch, and of a stitch, on the device or the encoder.
const BATCH_US: f64 = 300.0;
const STITCH_US: f64 = 10_000.0;
/// Time to stitch and encode a pixel.
const STITCH_PIXEL_US: f64 = 0.005;
/// A batch takes up to this part longer than its cost says.
const NOISE: f64 = 0.1;
/// A warm worker has rendered for this long.
const WARM_SECONDS: f64 = 4.0;

/// Batch under way.
#[derive(Clone, Debug)]
pub(super) struct Run {
    /// Index of its job.
    pub(super) job: usize,
    /// Its frame.
    pub(super) frame: u32,
    /// Leases that the worker still holds, with the indices of their tiles; a stitch has none.
    pub(super) leases: Vec<(LeaseId, Option<u32>)>,
    /// Whether its result is the picture: a whole frame, or a stitch.
    pub(super) is_picture: bool,
    /// Time of its start and of its end.
    pub(super) start_us: u64,
    pub(super) end_us: u64,
    /// Camera rays of its tiles.
    rays: u64,
    /// Whether its first tile fails.
    fails: bool,
}

impl Run {
    /// Time between the end of a batch and the start of the next one.
    pub(super) fn pause_us(&self) -> u64 {
        if self.end_us - self.start_us <= SHORT_BATCH_US { 0 } else { REQUEST_US }
    }

    /// Reports of its leases.
    pub(super) fn reports(&self) -> Vec<LeaseReport> {
        let is_whole = self.is_picture && !self.fails;
        let outcome = |index: usize, tile: Option<u32>| {
            let name = format!("{} {} {tile:?}", self.job, self.frame);
            let hash = |name: &str| blake3::hash(name.as_bytes()).to_hex().to_string();
            match (self.fails && index == 0, is_whole) {
                (true, _) => LeaseOutcome::Failed { message: "simulated failure".to_owned() },
                (false, true) => {
                    LeaseOutcome::Picture { hash: hash(&format!("{} {}", self.job, self.frame)), size_bytes: 1 }
                }
                (false, false) => LeaseOutcome::Blob { hash: hash(&name), size_bytes: 1 },
            }
        };
        let leases = self.leases.iter().enumerate();
        leases.map(|(index, &(lease, tile))| LeaseReport { lease, outcome: outcome(index, tile) }).collect()
    }

    /// Whether it failed.
    pub(super) fn fails(&self) -> bool {
        self.fails
    }
}

/// Registered worker.
#[derive(Clone, Debug)]
pub(super) struct SimulatedWorker {
    /// Its id.
    pub(super) id: WorkerId,
    /// Camera rays of a scene of cost 1 that it renders per second.
    speed: f64,
    /// Rendered rays and their seconds, the latest ones.
    lately: (f64, f64),
    /// Its batch.
    pub(super) run: Option<Run>,
    /// Counts its batches, so that events of dropped ones are recognized.
    pub(super) generation: u64,
    /// Time for which it was busy, and the end of its last batch.
    pub(super) busy_us: u64,
    pub(super) last_us: u64,
}

impl SimulatedWorker {
    /// Worker of a scenario, registered with this id.
    pub(super) fn new(id: WorkerId, plan: WorkerPlan) -> Self {
        let seconds = if plan.is_warm { WARM_SECONDS } else { 0.0 };
        let lately = (plan.rays_per_second * seconds, seconds);
        Self { id, speed: plan.rays_per_second, lately, run: None, generation: 0, busy_us: 0, last_us: 0 }
    }

    /// Speed that it reports: the estimate of the worker's session.
    pub(super) fn reported(&self) -> Option<RaysPerSecond> {
        let (rays, seconds) = self.lately;
        (seconds > 0.0).then(|| RaysPerSecond::new(rays / (seconds + 0.05))).flatten()
    }

    /// Starts a batch. `draws` gives random numbers from 0 to 1: of its noise, and of its failure.
    pub(super) fn start(
        &mut self,
        batch: Batch,
        job: (usize, &JobPlan),
        draws: [f64; 2],
        fails_below: f64,
        now_us: u64,
    ) {
        let (index, plan) = job;
        let (leases, is_picture, us, rays) = match batch.work {
            BatchWork::Render { tiles, whole_frame } => {
                let work: f64 = tiles.iter().map(|tile| tile_work(index, plan, batch.frame, tile.rect)).sum();
                let rays = tiles.iter().map(|tile| plan.rays(tile.rect)).sum();
                let leases = tiles.iter().map(|tile| (tile.lease, Some(tile.index))).collect();
                (leases, whole_frame, work / self.speed * 1e6 * NOISE.mul_add(draws[0], 1.0) + BATCH_US, rays)
            }
            BatchWork::Stitch { lease, .. } => {
                let pixels = f64::from(plan.tiling.width) * f64::from(plan.tiling.height);
                (vec![(lease, None)], true, pixels.mul_add(STITCH_PIXEL_US, STITCH_US), 0)
            }
        };
        let fails = draws[1] < fails_below && rays > 0;
        let end_us = now_us + us.ceil() as u64;
        self.generation += 1;
        self.run =
            Some(Run { job: index, frame: batch.frame, leases, is_picture, start_us: now_us, end_us, rays, fails });
    }

    /// Ends its batch, if it has one, at this time.
    pub(super) fn end(&mut self, now_us: u64) -> Option<Run> {
        let run = self.run.take()?;
        self.generation += 1;
        self.busy_us += now_us - run.start_us;
        self.last_us = now_us;
        if run.rays > 0 && now_us >= run.end_us {
            let seconds = (run.end_us - run.start_us) as f64 / 1e6;
            let fade = (1.0 - seconds / WARM_SECONDS).max(0.0);
            self.lately = (self.lately.0.mul_add(fade, run.rays as f64), self.lately.1.mul_add(fade, seconds));
        }
        Some(run)
    }

    /// Camera rays of a scene of cost 1 that it renders per second.
    pub(super) fn speed(&self) -> f64 {
        self.speed
    }
}

/// Work of a tile, in camera rays of cost 1: the lower half of a picture is dearer than its sky, and neighbors differ.
pub(super) fn tile_work(job: usize, plan: &JobPlan, frame: u32, rect: Rect) -> f64 {
    let height = f64::from(rect.y) + f64::from(rect.height) / 2.0;
    let slope = 1.5f64.mul_add(height / f64::from(plan.tiling.height), 0.25);
    let place = u64::from(rect.y) << 32 | u64::from(rect.x);
    let local = 0.4f64.mul_add(hashed_unit([job as u64, u64::from(frame), place]), 0.8);
    plan.rays(rect) as f64 * plan.cost * slope * local
}
