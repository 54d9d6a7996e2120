//! Benchmarks this machine: distances of a scene without marching, and complete frames.

use std::time::{Duration, Instant};

use proto::Rect;
use scene::real::vec3;
use scene::{Integrator, Job};
use serde::Serialize;

use crate::cpu::Evaluator;
use crate::cuda::{CudaRenderer, KernelSource};
use crate::picture_tape::{DISTANCE, record_distance};
use crate::{CancelFlag, CpuRenderer, RenderError, Renderer, Simd, TileRequest};

/// Distances per second on one core.
#[derive(Clone, Debug, Serialize)]
pub struct PointsReport {
    /// The job's name.
    pub job: String,
    /// The vector instructions.
    pub simd: &'static str,
    /// Distances of the whole scene a second, on one thread.
    pub points_per_second: f64,
}

/// Time and figures of rendering a frame on CPUs.
#[derive(Clone, Debug, Serialize)]
pub struct RenderReport {
    /// The job's name.
    pub job: String,
    /// The vector instructions.
    pub simd: &'static str,
    /// Threads.
    pub threads: usize,
    /// Camera rays of the frame.
    pub rays: u64,
    /// Distances of the whole scene evaluated for the frame: marches, normals and shadows.
    pub evaluations: u64,
    /// Shortest run, in milliseconds.
    pub least_ms: f64,
    /// Median time of the runs, in milliseconds.
    pub median_ms: f64,
    /// Camera rays a second, at the median.
    pub rays_per_second: f64,
    /// Evaluations a second, at the median.
    pub evaluations_per_second: f64,
}

/// Time and figures of rendering a frame on a GPU.
#[derive(Clone, Debug, Serialize)]
pub struct GpuReport {
    /// The job's name.
    pub job: String,
    /// Product name of the GPU.
    pub gpu: String,
    /// Generating, compiling and loading the scene's kernel, in milliseconds; `None` if it was cached on disk.
    pub compile_ms: Option<f64>,
    /// Generating source and loading the cached kernel, in milliseconds.
    pub load_ms: f64,
    /// Block dimensions: 16x8.
    pub block: String,
    /// Registers per thread.
    pub registers: u32,
    /// Bytes per thread of spilled registers in local memory.
    pub local_bytes: u32,
    /// Occupancy: resident fraction of the GPU's threads.
    pub occupancy: f64,
    /// Median time of the frame's kernels, in milliseconds.
    pub kernel_ms: f64,
    /// Shortest total time of the frame's kernels, in milliseconds.
    pub least_kernel_ms: f64,
    /// Longest launch, in milliseconds; a render can be cancelled after each launch.
    pub longest_launch_ms: f64,
    /// Median time until the pixels are in this process's memory, in milliseconds.
    pub median_ms: f64,
    /// Camera rays a second, in kernels.
    pub rays_per_second: f64,
    /// Distances of the whole scene evaluated for the frame.
    pub evaluations: u64,
    /// Distances a second, in kernels.
    pub evaluations_per_second: f64,
    /// Fraction of the GPU's peak operations per second spent on distances, if their number is fixed.
    pub peak_share: Option<f64>,
}

/// Renders a frame of `job` several times on a GPU; `cpu` counts the evaluations.
pub fn render_on_gpu(job: &Job, gpu: &CudaRenderer, cpu: &CpuRenderer, runs: usize) -> Result<GpuReport, RenderError> {
    let run = TileRequest { job, frame: 0, rect: Rect::full(job.image.width, job.image.height) };
    let source_time = Instant::now();
    let source = KernelSource::new(&job.at(0)?)?;
    let source_time = source_time.elapsed();
    gpu.clear_kernels();
    let first = gpu.compile(&run)?;
    gpu.clear_kernels();
    let again = gpu.compile(&run)?;
    let (mut kernels, mut walls, mut longest_launch_ms) = (Vec::new(), Vec::new(), 0.0_f64);
    // The first run only warms up.
    for round in 0..=runs.max(1) {
        gpu.take_kernel_times();
        let start = Instant::now();
        std::hint::black_box(gpu.render(&run, &CancelFlag::new(), &|_| ())?);
        if round > 0 {
            walls.push(start.elapsed().as_secs_f64());
            let times = gpu.take_kernel_times();
            kernels.push(times.total_ms / 1e3);
            longest_launch_ms = times.longest_ms.max(longest_launch_ms);
        }
    }
    kernels.sort_by(f64::total_cmp);
    walls.sort_by(f64::total_cmp);
    let (kernel, wall) = (kernels[kernels.len() / 2], walls[walls.len() / 2]);
    let evaluations = cpu.evaluations(&run)?;
    let rate = evaluations as f64 / kernel;
    let ms = |time: Duration| (time + source_time).as_secs_f64() * 1e3;
    Ok(GpuReport {
        job: job.name.clone(),
        gpu: gpu.gpu().to_owned(),
        compile_ms: (!first.was_cached).then(|| ms(first.time)),
        load_ms: ms(again.time),
        block: again.shape.to_string(),
        registers: again.resources.registers,
        local_bytes: again.resources.local_bytes,
        occupancy: again.resources.occupancy,
        kernel_ms: kernel * 1e3,
        least_kernel_ms: kernels[0] * 1e3,
        longest_launch_ms,
        median_ms: wall * 1e3,
        rays_per_second: job.rays_per_frame() as f64 / kernel,
        evaluations,
        evaluations_per_second: rate,
        peak_share: source.distance_operations.map(|each| rate * each as f64 / gpu.peak_flops()),
    })
}

/// Number of points that fit into the L1 cache together, a multiple of all lanes.
const POINTS: usize = 1024;

/// Evaluates the scene's distance at points around the camera's target, for about `time`, on one thread.
pub fn points(job: &Job, simd: Simd, time: Duration) -> Result<PointsReport, RenderError> {
    let still = job.at(0)?;
    let middle = job.scene.camera.look_at.get();
    let spread = |index: usize, step: u32| (index as u32).wrapping_mul(step) as f32 / u32::MAX as f32 * 4.0 - 2.0;
    let axis = |middle: f32, step: u32| (0..POINTS).map(move |index| middle + spread(index, step));
    let x = axis(middle.x, 0x9e37_79b9);
    let points: Vec<f32> = x.chain(axis(middle.y, 0xc13f_a9a9)).chain(axis(middle.z, 0x91e1_0da5)).collect();
    let points_per_second = if simd == Simd::Scalar {
        let program = Integrator::new(&still);
        points_per_second(time, |distances| {
            for (index, distance) in distances.iter_mut().enumerate() {
                *distance = program.distance(vec3(points[index], points[POINTS + index], points[2 * POINTS + index]));
            }
        })
    } else {
        let tape = record_distance(&still);
        let evaluator = Evaluator::new(&tape, simd)?;
        let (inputs, cancel, mut frame) = (evaluator.inputs(tape.uniforms()), CancelFlag::new(), evaluator.frame());
        points_per_second(time, |distances| {
            evaluator.run(DISTANCE, &mut frame, &inputs, cancel.flag(), &points, distances);
        })
    };
    Ok(PointsReport { job: job.name.clone(), simd: simd.resolve_auto().name(), points_per_second })
}

/// Calls `evaluate`, which writes [`POINTS`] distances, for about this time.
fn points_per_second(time: Duration, mut evaluate: impl FnMut(&mut [f32])) -> f64 {
    const ROUNDS: usize = 64;
    let mut distances = vec![0.0; POINTS];
    let (mut done, start) = (0, Instant::now());
    while start.elapsed() < time {
        for _ in 0..ROUNDS {
            evaluate(&mut distances);
            std::hint::black_box(&distances);
        }
        done += ROUNDS * POINTS;
    }
    done as f64 / start.elapsed().as_secs_f64()
}

/// Renders a frame of `job` several times.
pub fn render(job: &Job, simd: Simd, threads: Option<usize>, runs: usize) -> Result<RenderReport, RenderError> {
    let renderer = CpuRenderer::new(threads, simd)?;
    let rect = Rect::full(job.image.width, job.image.height);
    let run = TileRequest { job, frame: 0, rect };
    let mut times = Vec::with_capacity(runs);
    for _ in 0..runs.max(1) {
        let start = Instant::now();
        std::hint::black_box(renderer.render(&run, &CancelFlag::new(), &|_| ())?);
        times.push(start.elapsed().as_secs_f64());
    }
    times.sort_by(f64::total_cmp);
    let median = times[times.len() / 2];
    let evaluations = renderer.evaluations(&run)?;
    let rays = job.rays_per_frame();
    Ok(RenderReport {
        job: job.name.clone(),
        simd: simd.resolve_auto().name(),
        threads: renderer.threads(),
        rays,
        evaluations,
        least_ms: times[0] * 1e3,
        median_ms: median * 1e3,
        rays_per_second: rays as f64 / median,
        evaluations_per_second: evaluations as f64 / median,
    })
}
