//! Number of workers that would finish the backlog in a given time, for autoscalers. Arithmetic only; nothing is
//! started or stopped here.
//!
//! GPUs come first, because they are far faster: their number depends on no CPU. Workers on CPUs are wanted for what the
//! ready GPUs cannot finish in time, and for scenes too large for GPUs. So the two numbers never wait for each other.

use proto::rounding;
use proto::scaling::{DeviceScaling, ScalingView};

/// Unfinished jobs that are alike: as many nodes, and the same speeds measured in them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Load {
    /// Nodes of each job's scene that limit its workers; 0 if unknown.
    pub(crate) nodes: i64,
    /// Number of jobs.
    pub(crate) jobs: u64,
    /// Tiles that are not done.
    pub(crate) tiles: u64,
    /// Camera rays that are not rendered.
    pub(crate) rays: u64,
    /// Mean camera rays per second of one worker in these jobs, on a CPU.
    pub(crate) cpu_speed: Option<f64>,
    /// The same on a GPU.
    pub(crate) cuda_speed: Option<f64>,
}

/// Workers of one kind of device.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct DeviceWorkers {
    /// Workers that take work.
    pub(crate) ready: u64,
    /// Mean camera rays per second that one of them reported; of those that are gone, if none is left.
    pub(crate) speed: Option<f64>,
    /// Most nodes of a scene that one of them can render; `None` for any.
    pub(crate) max_nodes: Option<i64>,
}

/// Backlog and workers.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Demand {
    /// Unfinished jobs that are not paused; none if the farm is paused.
    pub(crate) loads: Vec<Load>,
    /// Workers on CPUs.
    pub(crate) cpu: DeviceWorkers,
    /// Workers on GPUs.
    pub(crate) cuda: DeviceWorkers,
}

impl DeviceWorkers {
    fn can_render(&self, load: &Load) -> bool {
        self.max_nodes.is_none_or(|max_nodes| load.nodes <= max_nodes)
    }

    /// Mean camera rays per second of one worker: reported, or else as measured in the jobs.
    fn mean_speed(&self, measured: impl Iterator<Item = f64>) -> Option<f64> {
        let (count, sum) = measured.fold((0_u32, 0.0), |(count, sum), speed| (count + 1, sum + speed));
        self.speed.or((count > 0).then(|| sum / f64::from(count)))
    }
}

/// A kind's part of the backlog.
#[derive(Clone, Copy, Debug, Default)]
struct Part {
    jobs: u64,
    tiles: u64,
    /// Seconds of one worker, as far as a speed is known.
    seconds: f64,
    /// Whether a load has rays, but no speed.
    is_unknown: bool,
}

impl Part {
    /// Adds a fraction of a load.
    fn add(&mut self, load: &Load, fraction: f64, speed: Option<f64>) {
        self.jobs += load.jobs;
        self.tiles += load.tiles;
        match speed {
            _ if load.rays == 0 => {}
            Some(speed) => self.seconds += fraction * load.rays as f64 / speed,
            None => self.is_unknown = true,
        }
    }

    fn work_seconds(&self) -> Option<f64> {
        (!self.is_unknown).then_some(self.seconds)
    }

    /// Workers that would finish it in time. An unfinished job wants one also if all its tiles are done, because
    /// its pictures may remain to be stitched.
    fn wanted(&self, target_seconds: f64) -> u64 {
        if self.jobs == 0 {
            return 0;
        }
        let workers = self.work_seconds().map_or(1.0, |seconds| (seconds / target_seconds).ceil());
        (workers as u64).clamp(1, self.tiles.max(1))
    }
}

impl Demand {
    /// Workers that would finish the backlog in time.
    pub(crate) fn view(&self, target_seconds: u32) -> ScalingView {
        let target = f64::from(target_seconds);
        let cuda_speed = self.cuda.mean_speed(self.loads.iter().filter_map(|load| load.cuda_speed));
        let mut on_cuda = Part::default();
        for load in self.loads.iter().filter(|load| self.cuda.can_render(load)) {
            on_cuda.add(load, 1.0, load.cuda_speed.or(cuda_speed));
        }
        let left = self.fraction_left_by_gpus(&on_cuda, target);
        let cpu_speed = self.cpu.mean_speed(self.loads.iter().filter_map(|load| load.cpu_speed));
        let mut on_cpu = Part::default();
        for load in self.loads.iter().filter(|load| self.cpu.can_render(load)) {
            let fraction = if self.cuda.can_render(load) { left } else { 1.0 };
            if fraction > 0.0 {
                on_cpu.add(load, fraction, load.cpu_speed.or(cpu_speed));
            }
        }
        let device = |workers: &DeviceWorkers, speed: Option<f64>, part: &Part| DeviceScaling {
            wanted_workers: part.wanted(target),
            ready_workers: workers.ready,
            rays_per_second: speed.map(rounding::rate),
            work_seconds: part.work_seconds().map(rounding::seconds),
        };
        ScalingView {
            target_seconds,
            jobs: self.loads.iter().map(|load| load.jobs).sum(),
            tiles: self.loads.iter().map(|load| load.tiles).sum(),
            rays: self.loads.iter().map(|load| load.rays).sum(),
            cpu: device(&self.cpu, cpu_speed, &on_cpu),
            cuda: device(&self.cuda, cuda_speed, &on_cuda),
        }
    }

    /// Fraction of the GPUs' part that the ready ones cannot finish in time.
    fn fraction_left_by_gpus(&self, part: &Part, target_seconds: f64) -> f64 {
        let capacity_seconds = self.cuda.ready as f64 * target_seconds;
        match part.work_seconds() {
            _ if self.cuda.ready == 0 => 1.0,
            Some(seconds) if seconds > capacity_seconds => 1.0 - capacity_seconds / seconds,
            Some(_) => 0.0,
            // Until a GPU is measured, CPUs are wanted as if there were none.
            None => 1.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TARGET_SECONDS: u32 = 100;

    fn workers(ready: u64, each: f64) -> DeviceWorkers {
        DeviceWorkers { ready, speed: Some(each), max_nodes: None }
    }

    fn load(rays: u64, tiles: u64) -> Load {
        Load { nodes: 5, jobs: 1, tiles, rays, ..Load::default() }
    }

    fn wanted(loads: &[Load], cpu: DeviceWorkers, cuda: DeviceWorkers) -> [u64; 2] {
        let view = Demand { loads: loads.to_vec(), cpu, cuda }.view(TARGET_SECONDS);
        [view.cpu.wanted_workers, view.cuda.wanted_workers]
    }

    #[test]
    fn no_work_wants_no_workers() {
        let view = Demand { cpu: workers(3, 10.0), ..Demand::default() }.view(TARGET_SECONDS);
        let ready = DeviceScaling { ready_workers: 3, rays_per_second: Some(10.0), ..DeviceScaling::default() };
        assert_eq!(view.cpu, DeviceScaling { work_seconds: Some(0.0), ..ready });
        assert_eq!((view.cuda.wanted_workers, view.jobs, view.tiles, view.rays), (0, 0, 0, 0));
    }

    #[test]
    fn as_many_workers_are_wanted_as_finish_in_time() {
        let none = DeviceWorkers::default();
        for (rays, expected) in [(1, 1), (1000, 1), (1001, 2), (50_000, 50)] {
            assert_eq!(wanted(&[load(rays, 1000)], workers(2, 10.0), none)[0], expected, "{rays} rays");
        }
        let view = Demand { loads: vec![load(50_000, 1000)], cpu: workers(2, 10.0), cuda: none }.view(500);
        assert_eq!((view.cpu.wanted_workers, view.cpu.work_seconds), (10, Some(5000.0)));
    }

    #[test]
    fn workers_beyond_the_number_of_tiles_are_not_wanted() {
        assert_eq!(wanted(&[load(u64::MAX, 7)], workers(1, 1.0), DeviceWorkers::default())[0], 7);
    }

    #[test]
    fn without_a_speed_one_worker_is_wanted_to_measure_it() {
        let demand = Demand { loads: vec![load(1 << 40, 1000)], ..Demand::default() };
        let view = demand.view(TARGET_SECONDS);
        assert_eq!([view.cpu.wanted_workers, view.cuda.wanted_workers], [1, 1]);
        assert_eq!((view.cpu.rays_per_second, view.cpu.work_seconds), (None, None));
    }

    #[test]
    fn the_speed_measured_in_a_job_counts_in_it() {
        let heavy = Load { cpu_speed: Some(1.0), ..load(1000, 100) };
        let light = load(1000, 100);
        // 1,000 s and 10 s.
        assert_eq!(wanted(&[heavy, light], workers(1, 100.0), DeviceWorkers::default())[0], 11);
        // Where no worker reports a speed, such as after all were stopped, those measured in jobs count for others too.
        assert_eq!(wanted(&[heavy, light], DeviceWorkers::default(), DeviceWorkers::default())[0], 20);
    }

    #[test]
    fn unfinished_jobs_want_a_worker_that_stitches() {
        assert_eq!(wanted(&[load(0, 0)], workers(0, 1.0), DeviceWorkers::default()), [1, 1]);
        assert_eq!(wanted(&[load(0, 0)], workers(0, 1.0), workers(1, 1.0)), [0, 1]);
    }

    #[test]
    fn cpus_are_wanted_for_what_the_ready_gpus_leave() {
        let job = [load(100_000, 10_000)];
        let cpu = workers(1, 10.0);
        // A GPU finishes 20,000 rays in time, a CPU 1,000.
        for (gpus, expected) in [(0, [100, 5]), (1, [80, 5]), (4, [20, 5]), (5, [0, 5]), (9, [0, 5])] {
            assert_eq!(wanted(&job, cpu, workers(gpus, 200.0)), expected, "{gpus} GPUs");
        }
        // The number of GPUs does not depend on CPUs, so the two do not alternate.
        assert_eq!(wanted(&job, workers(100, 10.0), workers(1, 200.0))[1], 5);
    }

    #[test]
    fn scenes_too_large_for_gpus_are_left_to_cpus() {
        let gpus = DeviceWorkers { max_nodes: Some(100), ..workers(4, 200.0) };
        let large = Load { nodes: 101, ..load(5000, 100) };
        assert_eq!(wanted(&[large, load(1000, 100)], workers(1, 10.0), gpus), [5, 1]);
        assert_eq!(wanted(&[large], workers(1, 10.0), gpus), [5, 0]);
    }
}
