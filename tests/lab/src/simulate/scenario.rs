//! Farms and jobs to simulate. The speeds are round figures of an H100 and of one CPU core's worker, the costs are of
//! shipped scenes in `docs/benchmarks.md`.

use proto::Rect;
use proto::tile::Tiling;

use super::random::Random;

/// Camera rays of a scene of cost 1 that a GPU renders per second, copies included.
const GPU_RAYS_PER_SECOND: f64 = 2.7e9;
/// Camera rays of a scene of cost 1 that a CPU worker renders per second.
const CPU_RAYS_PER_SECOND: f64 = 1.4e7;
/// Cost of a ray of `fjord`: a GPU renders 66 million of them in 2.4 s.
const HEAVY: f64 = 99.0;
/// Slowest and fastest worker of the scenario with many workers, as parts of a GPU.
const MIXED_SPEEDS: [f64; 2] = [0.01, 1.0];
/// Bytes of finished data per pixel of a PNG.
const PIXEL_BYTES: u32 = 16;

/// Worker of a scenario.
#[derive(Clone, Copy, Debug)]
pub(super) struct WorkerPlan {
    /// Kind of its device, as it registers.
    pub(super) device: &'static str,
    /// Camera rays of a scene of cost 1 that it renders per second.
    pub(super) rays_per_second: f64,
    /// Whether it has rendered a scene of cost 1 lately, so that it reports that speed.
    pub(super) is_warm: bool,
}

/// Job of a scenario.
#[derive(Clone, Debug)]
pub(super) struct JobPlan {
    /// Its submitter.
    pub(super) submitter: &'static str,
    /// The tiles of each frame.
    pub(super) tiling: Tiling,
    /// Number of frames.
    pub(super) frames: u32,
    /// Mean cost of its rays.
    pub(super) cost: f64,
}

impl JobPlan {
    /// Camera rays of a rectangle.
    pub(super) fn rays(&self, rect: Rect) -> u64 {
        rect.pixels() * u64::from(self.tiling.samples)
    }
}

/// Farm with jobs, all submitted at the start.
#[derive(Clone, Debug)]
pub(super) struct Scenario {
    /// Its name.
    pub(super) name: &'static str,
    /// Its workers.
    pub(super) workers: Vec<WorkerPlan>,
    /// Its jobs.
    pub(super) jobs: Vec<JobPlan>,
}

impl Scenario {
    /// All scenarios; the last one has this many workers of mixed speeds.
    pub(super) fn all(many_workers: u32, seed: u64) -> Vec<Self> {
        let animation = |cost, samples, frames| vec![job("artist", cost, samples, frames)];
        let scenario = |name, workers, jobs| Self { name, workers, jobs };
        vec![
            scenario("light-animation-8-gpus", gpus(8), animation(1.0, 4, 2400)),
            scenario("heavy-animation-8-gpus", gpus(8), animation(HEAVY, 32, 60)),
            scenario("light-animation-1-gpu", gpus(1), animation(1.0, 4, 600)),
            scenario("heavy-frame-1-gpu", gpus(1), animation(HEAVY, 32, 1)),
            scenario("heavy-frame-2-gpus", gpus(2), animation(HEAVY, 32, 1)),
            scenario("heavy-frame-8-gpus", gpus(8), animation(HEAVY, 32, 1)),
            scenario("heavy-frame-2-new-gpus", fresh(gpus(2)), animation(HEAVY, 32, 1)),
            scenario("light-frame-2-gpus", gpus(2), animation(1.0, 4, 1)),
            scenario("heavy-frame-2-gpus-8-cpus", mixed(2, 8), animation(HEAVY, 32, 1)),
            scenario("heavy-animation-2-gpus-8-cpus", mixed(2, 8), animation(HEAVY, 32, 20)),
            scenario("three-submitters", mixed(4, 4), three_submitters()),
            scenario("many-jobs", many(many_workers, seed), many_jobs()),
        ]
    }

    /// Its name.
    pub(super) fn name(&self) -> &'static str {
        self.name
    }
}

/// Job at 1920×1080.
fn job(submitter: &'static str, cost: f64, samples: u32, frames: u32) -> JobPlan {
    let tiling = Tiling { width: 1920, height: 1080, samples, pixel_bytes: PIXEL_BYTES, tile_edge: None };
    JobPlan { submitter, tiling, frames, cost }
}

fn gpus(count: u32) -> Vec<WorkerPlan> {
    (0..count).map(|_| WorkerPlan { device: "cuda:0", rays_per_second: GPU_RAYS_PER_SECOND, is_warm: true }).collect()
}

fn mixed(gpu_count: u32, cpu_count: u32) -> Vec<WorkerPlan> {
    let cpus =
        (0..cpu_count).map(|_| WorkerPlan { device: "cpu", rays_per_second: CPU_RAYS_PER_SECOND, is_warm: true });
    gpus(gpu_count).into_iter().chain(cpus).collect()
}

fn fresh(workers: Vec<WorkerPlan>) -> Vec<WorkerPlan> {
    workers.into_iter().map(|worker| WorkerPlan { is_warm: false, ..worker }).collect()
}

/// Workers whose speeds are spread evenly by their logarithms.
fn many(count: u32, seed: u64) -> Vec<WorkerPlan> {
    let (mut random, [least, most]) = (Random::new(seed), MIXED_SPEEDS);
    let speeds = (0..count).map(|_| GPU_RAYS_PER_SECOND * least * (most / least).powf(random.unit()));
    speeds.map(|rays_per_second| WorkerPlan { device: "cuda:0", rays_per_second, is_warm: true }).collect()
}

/// One submitter with a long animation, one with stills, and one with many light animations.
fn three_submitters() -> Vec<JobPlan> {
    let single_frames = (0..20).map(|_| job("stills", HEAVY, 32, 1));
    let lights = (0..20).map(|_| job("lights", 3.0, 16, 60));
    std::iter::once(job("film", 30.0, 16, 120)).chain(single_frames).chain(lights).collect()
}

/// Jobs of four submitters: four thousand frames, a sixth of them heavy.
fn many_jobs() -> Vec<JobPlan> {
    let submitters = ["first", "second", "third", "fourth"];
    let kinds = [(HEAVY, 32, 20), (10.0, 16, 40), (30.0, 4, 60)];
    (0..100)
        .map(|index| {
            let (cost, samples, frames) = kinds[index % kinds.len()];
            job(submitters[index % submitters.len()], cost, samples, frames)
        })
        .collect()
}
