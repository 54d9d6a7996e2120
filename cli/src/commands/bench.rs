//! `sdfarm bench`: measures how fast this machine renders at each SIMD level it has.

mod farm;
mod paper;
mod queue;
mod setup;

use std::path::Path;
use std::time::Duration;

use anyhow::Context;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, Subcommand};
use scene::Job;
use serde::Serialize;
use worker::bench::{GpuReport, PointsReport, RenderReport, points, render, render_on_gpu};
use worker::{CpuRenderer, RenderError, Simd};

use crate::arguments::{CudaArguments, DeviceChoice, MAX_THREADS};
use crate::commands::bench::farm::FarmReport;
use crate::commands::run_async;
use crate::commands::serve::devices;
use crate::job_file::JobFile;
use crate::shipped;
use crate::terminal::{print_line, print_note};

const DEFAULT_JOBS: [&str; 3] = ["csg", "five-spheres", "mandelbulb"];
const ALL_LEVELS: [Simd; 4] = [Simd::Scalar, Simd::Portable, Simd::Avx2, Simd::Avx512];

/// Arguments of `bench`.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    table: Option<BenchSuite>,
    /// Job files, or names of shipped scenes [default: csg five-spheres mandelbulb].
    #[arg(value_name = "JOB")]
    jobs: Vec<String>,
    /// Vector instructions to measure.
    #[arg(long, env = "SDFARM_SIMD", default_value = "auto", value_parser = levels_parser())]
    simd: SimdLevels,
    /// Measure only distances per second, and render nothing.
    #[arg(long, env = "SDFARM_POINTS", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    points: bool,
    /// Device to measure: cpu, or cuda or cuda:N for a GPU.
    #[arg(long, env = "SDFARM_DEVICE", default_value = "cpu")]
    device: DeviceChoice,
    #[command(flatten)]
    cuda: CudaArguments,
    /// Threads that render [default: one for each core].
    #[arg(long, value_name = "N", env = "SDFARM_THREADS", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_THREADS)))]
    threads: Option<u32>,
    /// Number of times to render each frame.
    #[arg(long, value_name = "N", env = "SDFARM_RUNS", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    runs: u32,
    /// Seconds to measure distances at each level.
    #[arg(long, value_name = "SECONDS", env = "SDFARM_SECONDS", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=60))]
    seconds: u64,
    /// Measure a whole farm: the time from POST to the stored picture, and frames per second.
    #[arg(long, env = "SDFARM_FARM", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    farm: bool,
    /// Frames of the animation that --farm measures.
    #[arg(long, value_name = "N", env = "SDFARM_FRAMES", default_value_t = 120, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    frames: u32,
    /// Print the results as JSON.
    #[arg(long, env = "SDFARM_JSON", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    json: bool,
}

/// Subcommands that measure one complete table.
#[derive(Debug, Subcommand)]
enum BenchSuite {
    /// Measure the paper's Table 1 on this machine, next to the published figures.
    Paper(paper::Arguments),
    /// Measure a server's queue: jobs and tiles per second, and response times.
    Queue(queue::Arguments),
    /// Measure how long an animated job takes to evaluate at a frame.
    Setup(setup::Arguments),
}

/// SIMD levels to measure.
#[derive(Clone, Debug)]
struct SimdLevels(Vec<Simd>);

/// All results.
#[derive(Debug, Default, Serialize)]
struct Reports {
    points: Vec<PointsReport>,
    renders: Vec<RenderReport>,
    gpu_renders: Vec<GpuReport>,
    farms: Vec<FarmReport>,
}

/// Runs the measurements and prints them.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    match &arguments.table {
        Some(BenchSuite::Paper(arguments)) => return paper::run(arguments),
        Some(BenchSuite::Queue(arguments)) => return run_async(queue::run(arguments)),
        Some(BenchSuite::Setup(arguments)) => return setup::run(arguments),
        None => {}
    }
    let names = DEFAULT_JOBS.map(str::to_owned);
    let names = if arguments.jobs.is_empty() { names.as_slice() } else { &arguments.jobs };
    let jobs = names.iter().map(|name| read(name)).collect::<anyhow::Result<Vec<Job>>>()?;
    let mut reports = Reports::default();
    if arguments.farm {
        for (name, job) in names.iter().zip(&jobs) {
            let text = text(name)?;
            let devices = devices(arguments.device)?;
            let measured = farm::measure(&text, devices, arguments.runs as usize, arguments.frames);
            let report = run_async(measured).with_context(|| format!("could not measure a farm with {}", job.name))?;
            reports.farms.push(report);
        }
        return if arguments.json {
            print_line(&serde_json::to_string_pretty(&reports)?)
        } else {
            farm_table(&reports)
        };
    }
    if let DeviceChoice::Cuda(ordinal) = arguments.device {
        let (gpu, cpu) = (arguments.cuda.renderer(ordinal.unwrap_or(0))?, CpuRenderer::new(None, Simd::Auto)?);
        for job in &jobs {
            reports.gpu_renders.push(render_on_gpu(job, &gpu, &cpu, arguments.runs as usize)?);
        }
        return if arguments.json { print_line(&serde_json::to_string_pretty(&reports)?) } else { gpu_table(&reports) };
    }
    for job in &jobs {
        for &level in &arguments.simd.0 {
            match measure(job, level, arguments, &mut reports) {
                Ok(()) => {}
                Err(error @ RenderError::Unavailable { .. }) if arguments.simd.0.len() > 1 => {
                    print_note(&format!("skipped: {error}"));
                }
                Err(error) => return Err(error.into()),
            }
        }
    }
    if arguments.json {
        return print_line(&serde_json::to_string_pretty(&reports)?);
    }
    table(&reports)
}

/// Reads the file with this name, otherwise the shipped scene.
fn read(name: &str) -> anyhow::Result<Job> {
    if name == "-" || Path::new(name).exists() {
        return JobFile::read(name)?.parse();
    }
    scene::parse(&shipped::job_file(name)?).with_context(|| format!("the shipped scene {name} is damaged"))
}

/// Returns the text of a job file or a shipped scene.
fn text(name: &str) -> anyhow::Result<Vec<u8>> {
    if Path::new(name).exists() {
        return std::fs::read(name).with_context(|| format!("could not read {name}"));
    }
    shipped::job_file(name)
}

fn farm_table(reports: &Reports) -> anyhow::Result<()> {
    for FarmReport { job, devices, jobs, latency_ms: [least, median, greatest], frames, frames_per_second } in
        &reports.farms
    {
        print_line(&format!("{job} on a farm of {}", devices.join(", ")))?;
        print_line(&format!("  POST to stored   median {median:.1} ms ({least:.1} to {greatest:.1}) of {jobs} jobs"))?;
        print_line(&format!("  animation        {frames} frames, {frames_per_second:.1} stored per second"))?;
    }
    Ok(())
}

fn measure(job: &Job, level: Simd, arguments: &Arguments, reports: &mut Reports) -> Result<(), RenderError> {
    reports.points.push(points(job, level, Duration::from_secs(arguments.seconds))?);
    if !arguments.points {
        let threads = arguments.threads.map(|threads| threads as usize);
        reports.renders.push(render(job, level, threads, arguments.runs as usize)?);
    }
    Ok(())
}

fn gpu_table(reports: &Reports) -> anyhow::Result<()> {
    for report in &reports.gpu_renders {
        let GpuReport { job, gpu, block, registers, local_bytes, occupancy, .. } = report;
        let compiled = report.compile_ms.map_or("earlier (cached)".to_owned(), |ms| format!("{ms:.1} ms"));
        let share = report.peak_share.map_or_else(|| "-".to_owned(), |share| format!("{:.1} %", share * 100.0));
        print_line(&format!("{job} on {gpu}"))?;
        print_line(&format!("  program       compiled {compiled}, loaded in {:.1} ms", report.load_ms))?;
        print_line(&format!(
            "  resources     blocks {block}, {registers} registers, {local_bytes} bytes spilled, occupancy {:.0} %",
            occupancy * 100.0
        ))?;
        print_line(&format!(
            "  frame         kernels {:.3} ms (least {:.3}), longest launch {:.2} ms, pixels copied after {:.2} ms",
            report.kernel_ms, report.least_kernel_ms, report.longest_launch_ms, report.median_ms
        ))?;
        print_line(&format!(
            "  rates         {:.2} G rays/s, {:.1} M evaluations, {:.1} G evaluations/s, {share} of the fp32 peak\n",
            report.rays_per_second / 1e9,
            report.evaluations as f64 / 1e6,
            report.evaluations_per_second / 1e9
        ))?;
    }
    Ok(())
}

fn table(reports: &Reports) -> anyhow::Result<()> {
    print_line("distances without marching, one thread")?;
    print_line(&format!("{:<20} {:<8} {:>14}", "job", "simd", "M points/s"))?;
    for PointsReport { job, simd, points_per_second } in &reports.points {
        print_line(&format!("{job:<20} {simd:<8} {:>14.1}", points_per_second / 1e6))?;
    }
    if reports.renders.is_empty() {
        return Ok(());
    }
    print_line("\nframes at their jobs' settings, rendered but not encoded")?;
    let heads = ["median ms", "least ms", "M rays/s", "M evaluations/s"];
    let [median, least, rays, evaluations] = heads;
    print_line(&format!(
        "{:<20} {:<8} {:>7} {median:>10} {least:>10} {rays:>9} {evaluations:>15}",
        "job", "simd", "threads"
    ))?;
    for report in &reports.renders {
        let RenderReport { job, simd, threads, median_ms, least_ms, .. } = report;
        let (rays, evaluations) = (report.rays_per_second / 1e6, report.evaluations_per_second / 1e6);
        print_line(&format!(
            "{job:<20} {simd:<8} {threads:>7} {median_ms:>10.1} {least_ms:>10.1} {rays:>9.2} {evaluations:>15.1}"
        ))?;
    }
    Ok(())
}

fn levels_parser() -> impl TypedValueParser<Value = SimdLevels> {
    PossibleValuesParser::new(["all", "auto", "avx512", "avx2", "portable", "sse4.2", "scalar"]).map(|name| match name
        .as_str()
    {
        "all" => SimdLevels(ALL_LEVELS.to_vec()),
        level => SimdLevels(vec![level.parse().expect("the list above holds the levels' names")]),
    })
}
