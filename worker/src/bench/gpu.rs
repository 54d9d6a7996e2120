//! Complete frames on a GPU.

use std::time::{Duration, Instant};

use proto::Rect;
use scene::Job;
use serde::Serialize;

use crate::cuda::{CudaRenderer, KernelSource};
use crate::{CancelFlag, CpuRenderer, RenderError, Renderer, TileRequest};

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
    /// Layout of threads: `16x8`, or `16x8, 4 samples together`.
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
    let run = TileRequest { job, frame: 0, rect: Rect::full(job.image.film().width, job.image.film().height) };
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
        block: match again.threads_of_pixel {
            1 => again.block.to_string(),
            together => format!("{}, {together} samples together", again.block),
        },
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
