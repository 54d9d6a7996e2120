//! Measures the paper's Table 1 on this machine, next to the published figures.
//!
//! Robles, Lee, Yin and Dhar, "Procedural Rendering with Ray Marching", USC CSCI 580, 2022.

mod profile;
mod published;
mod table;

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use scene::Job;
use serde::Serialize;
use worker::bench::{GpuReport, RenderReport, render, render_on_gpu};
use worker::cuda::{BlockDim, CudaRenderer};
use worker::{CpuRenderer, RenderError, Simd};

use crate::program::{Program, job_text};
use profile::StepProfile;
use published::{Published, published};

/// The scene of Table 1.
const SCENE: &str = "paper/five-spheres";
/// Camera rays a pixel, as in Table 1.
const SAMPLES: u32 = 8;
/// Blocks of threads, as in Table 1.
const BLOCKS: [BlockDim; 5] = [
    BlockDim { columns: 8, rows: 8 },
    BlockDim { columns: 16, rows: 16 },
    BlockDim { columns: 32, rows: 8 },
    BlockDim { columns: 128, rows: 1 },
    BlockDim { columns: 256, rows: 1 },
];

/// Arguments of `paper`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Measure no GPU.
    #[arg(long)]
    cpu: bool,
    /// Number of the GPU to measure [default: the first, if there is one].
    #[arg(long, value_name = "N", conflicts_with = "cpu")]
    gpu: Option<usize>,
    /// Block dimensions on the GPU, such as 16x8 [default: Table 1's].
    #[arg(long, value_name = "COLUMNSxROWS")]
    block: Option<BlockDim>,
    /// Folder for compiled GPU kernels [default: in the user's cache].
    #[arg(long, value_name = "FOLDER")]
    cache: Option<PathBuf>,
    /// Threads that render on the CPU [default: one for each core].
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Vector instructions of the CPU.
    #[arg(long, value_name = "LEVEL", default_value_t = Simd::Auto)]
    simd: Simd,
    /// Edges of the square pictures, in pixels.
    #[arg(long, value_name = "PIXELS", value_delimiter = ',', default_value = "256,512,1024", value_parser = clap::value_parser!(u32).range(16..=8192))]
    resolutions: Vec<u32>,
    /// Number of times to render each frame, except once on one thread.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    runs: u32,
    /// Print the results as JSON.
    #[arg(long)]
    json: bool,
}

impl Arguments {
    fn renderer(&self, ordinal: usize, block: Option<BlockDim>) -> Result<CudaRenderer, RenderError> {
        let cache = self.cache.clone().or_else(worker::cuda::default_cache_folder);
        CudaRenderer::new(ordinal, cache.as_deref(), block)
    }
}

/// The whole table.
#[derive(Debug, Serialize)]
struct Table {
    scene: &'static str,
    samples: u32,
    /// Product name of the GPU; `None` without one.
    gpu: Option<String>,
    simd: &'static str,
    threads: usize,
    rows: Vec<Row>,
}

/// Row of the table: a resolution and block dimensions.
#[derive(Debug, Serialize)]
struct Row {
    /// Pixels along an edge.
    resolution: u32,
    /// Threads of a block: 16x8.
    block: String,
    /// Time on one thread without vector instructions, in milliseconds.
    serial_ms: f64,
    /// Median time on all threads with vector instructions, in milliseconds.
    simd_ms: f64,
    simd_speed_up: f64,
    gpu: Option<GpuRow>,
    /// The paper's figures, if it has this row.
    published: Option<Published>,
}

/// Result of a GPU.
#[derive(Debug, Serialize)]
struct GpuRow {
    /// Median time of the kernels, in milliseconds.
    kernel_ms: f64,
    /// Speed relative to one thread without vector instructions.
    speed_up: f64,
    /// Speed relative to the paper's program on an H200, if this GPU is one.
    over_the_papers_program: Option<f64>,
    registers: u32,
    theoretical_occupancy_percent: f64,
    #[serde(flatten)]
    profile: StepProfile,
}

/// Measures the table, and returns it as text.
pub(crate) fn run(arguments: &Arguments, program: &Program) -> anyhow::Result<String> {
    let mut gpu = Gpu::find(arguments, program)?;
    let blocks = arguments.block.map_or(BLOCKS.to_vec(), |block| vec![block]);
    let (mut rows, mut cpu) = (Vec::new(), None);
    for &resolution in &arguments.resolutions {
        let (text, job) = job(resolution)?;
        let serial = render(&job, Simd::Scalar, Some(1), 1)?;
        let simd = render(&job, arguments.simd, arguments.threads, arguments.runs as usize)?;
        for &block in &blocks {
            let report = gpu.as_mut().map(|gpu| gpu.measure(&text, &job, block)).transpose()?;
            rows.push(Row::new(resolution, block, &serial, &simd, report));
        }
        cpu = Some(simd);
    }
    let cpu = cpu.context("no resolution was given: give one, such as --resolutions 256")?;
    let gpu = gpu.map(|gpu| gpu.name);
    let table = Table { scene: SCENE, samples: SAMPLES, gpu, simd: cpu.simd, threads: cpu.threads, rows };
    if arguments.json { Ok(serde_json::to_string_pretty(&table)?) } else { Ok(table::text(&table)) }
}

/// Returns the scene at this size, as text and parsed.
fn job(resolution: u32) -> anyhow::Result<(String, Job)> {
    let damaged = || format!("the shipped scene {SCENE} is damaged");
    let mut job: serde_json::Value = serde_json::from_slice(&job_text(SCENE)?).with_context(damaged)?;
    job["image"] = serde_json::json!({ "width": resolution, "height": resolution, "samples": SAMPLES });
    let text = job.to_string();
    let job = scene::parse(text.as_bytes()).with_context(damaged)?;
    Ok((text, job))
}

/// The GPU to measure.
struct Gpu<'a> {
    arguments: &'a Arguments,
    program: &'a Program,
    ordinal: usize,
    name: String,
    /// Counts the operations of a frame.
    counter: CpuRenderer,
    /// Folder of the profiles; `None` once profiling has failed.
    profiled: Option<tempfile::TempDir>,
}

impl<'a> Gpu<'a> {
    /// Returns the requested GPU, or the first; prints a notice if there is none.
    fn find(arguments: &'a Arguments, program: &'a Program) -> anyhow::Result<Option<Self>> {
        if arguments.cpu {
            eprintln!("the GPU is skipped, as --cpu asks for");
            return Ok(None);
        }
        if let (None, Err(error)) = (arguments.gpu, worker::cuda::devices()) {
            eprintln!("the GPU is skipped: {error}");
            return Ok(None);
        }
        let ordinal = arguments.gpu.unwrap_or(0);
        let name = arguments.renderer(ordinal, arguments.block)?.gpu().to_owned();
        let counter = CpuRenderer::new(None, Simd::Auto)?;
        let folder = tempfile::tempdir().context("could not create a folder for profiles: free some space there")?;
        Ok(Some(Self { arguments, program, ordinal, name, counter, profiled: Some(folder) }))
    }

    fn measure(&mut self, text: &str, job: &Job, block: BlockDim) -> anyhow::Result<(GpuReport, StepProfile)> {
        let renderer = self.arguments.renderer(self.ordinal, Some(block))?;
        let report = render_on_gpu(job, &renderer, &self.counter, self.arguments.runs as usize)?;
        drop(renderer);
        Ok((report, self.profile(text, block)?))
    }

    /// Runs `ncu`; returns no counters if it is missing or not permitted.
    fn profile(&mut self, text: &str, block: BlockDim) -> anyhow::Result<StepProfile> {
        let Some(folder) = &self.profiled else { return Ok(StepProfile::default()) };
        let path: PathBuf = folder.path().join("job.json");
        std::fs::write(&path, text).with_context(|| format!("could not write {}", path.display()))?;
        let device = format!("cuda:{}", self.ordinal);
        match profile::profile(self.program, &path, &device, block, self.arguments.cache.as_deref()) {
            Ok(counted) => Ok(counted),
            Err(why) => {
                eprintln!("achieved occupancy, branches and lanes are skipped: {why}");
                self.profiled = None;
                Ok(StepProfile::default())
            }
        }
    }
}

impl Row {
    fn new(
        resolution: u32,
        block: BlockDim,
        serial: &RenderReport,
        simd: &RenderReport,
        gpu: Option<(GpuReport, StepProfile)>,
    ) -> Self {
        let published = published(resolution, block);
        Self {
            resolution,
            block: block.to_string(),
            serial_ms: serial.median_ms,
            simd_ms: simd.median_ms,
            simd_speed_up: serial.median_ms / simd.median_ms,
            gpu: gpu.map(|(report, profile)| GpuRow {
                kernel_ms: report.kernel_ms,
                speed_up: serial.median_ms / report.kernel_ms,
                over_the_papers_program: published
                    .filter(|_| report.gpu.contains("H200"))
                    .map(|published| published.h200_ms / report.kernel_ms),
                registers: report.registers,
                theoretical_occupancy_percent: report.occupancy * 100.0,
                profile,
            }),
            published,
        }
    }
}
