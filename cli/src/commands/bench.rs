//! `sdfarm bench`: measures how fast this machine evaluates distances, renders frames and compiles scenes.

mod farm;
mod tables;

use std::num::NonZero;
use std::path::Path;
use std::time::Duration;

use anyhow::Context;
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use scene::Job;
use serde::Serialize;
use worker::bench::{CompileReport, GpuReport, PointsReport, RenderReport, compile, frames, points, render_on_gpu};
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
#[expect(clippy::struct_excessive_bools, reason = "each is a flag of the command line")]
pub(crate) struct Arguments {
    /// Job files, or names of shipped scenes [default: csg five-spheres mandelbulb; all shipped scenes with --compile].
    #[arg(value_name = "JOB")]
    jobs: Vec<String>,
    /// Vector instructions to measure.
    #[arg(long, env = "SDFARM_SIMD", default_value = "auto", value_parser = levels_parser())]
    simd: SimdLevels,
    /// Measure only distances per second, and render nothing.
    #[arg(long, env = "SDFARM_POINTS", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    points: bool,
    /// Measure how long scenes take to compile, and render nothing.
    #[arg(long, env = "SDFARM_COMPILE", conflicts_with = "points", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    compile: bool,
    /// Device to measure: cpu, or cuda or cuda:N for a GPU.
    #[arg(long, env = "SDFARM_DEVICE", default_value = "cpu")]
    device: DeviceChoice,
    #[command(flatten)]
    cuda: CudaArguments,
    /// Threads that render [default: 1, 2 and all cores, one after the other].
    #[arg(long, value_name = "N", env = "SDFARM_THREADS", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_THREADS)))]
    threads: Option<u32>,
    /// Number of times to render each frame, or to compile each scene.
    #[arg(long, value_name = "N", env = "SDFARM_RUNS", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=1000))]
    runs: u32,
    /// Seconds to measure distances at each level.
    #[arg(long, value_name = "SECONDS", env = "SDFARM_SECONDS", default_value_t = 2, value_parser = clap::value_parser!(u64).range(1..=60))]
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

/// SIMD levels to measure.
#[derive(Clone, Debug)]
struct SimdLevels(Vec<Simd>);

/// All results.
#[derive(Debug, Default, Serialize)]
struct Reports {
    points: Vec<PointsReport>,
    compile_times: Vec<CompileReport>,
    renders: Vec<RenderReport>,
    gpu_renders: Vec<GpuReport>,
    farms: Vec<FarmReport>,
}

/// Prints one kind of results.
type Table = fn(&Reports) -> anyhow::Result<()>;

/// Runs the measurements and prints them.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let names = match arguments.jobs.as_slice() {
        [] if arguments.compile => shipped::names(),
        [] => DEFAULT_JOBS.map(str::to_owned).to_vec(),
        named => named.to_vec(),
    };
    let jobs = names.iter().map(|name| read(name)).collect::<anyhow::Result<Vec<Job>>>()?;
    let mut reports = Reports::default();
    let tables: &[Table] = if arguments.farm {
        measure_farms(&names, &jobs, arguments, &mut reports)?;
        &[tables::farms]
    } else if let DeviceChoice::Cuda(ordinal) = arguments.device {
        let (gpu, cpu) = (arguments.cuda.renderer(ordinal.unwrap_or(0))?, CpuRenderer::new(None, Simd::Auto)?);
        for job in &jobs {
            reports.gpu_renders.push(render_on_gpu(job, &gpu, &cpu, arguments.runs as usize)?);
        }
        &[tables::gpu_frames]
    } else if arguments.compile {
        for (name, job) in names.iter().zip(&jobs) {
            let report = compile(job, arguments.runs as usize)?;
            reports.compile_times.push(CompileReport { job: name.clone(), ..report });
        }
        &[tables::compile_times]
    } else {
        measure_points(&jobs, arguments, &mut reports)?;
        if arguments.points {
            &[tables::points]
        } else {
            measure_frames(&jobs, arguments, &mut reports)?;
            &[tables::points, tables::frames]
        }
    };
    if arguments.json {
        return print_line(&serde_json::to_string_pretty(&reports)?);
    }
    tables.iter().try_for_each(|table| table(&reports))
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

fn measure_farms(names: &[String], jobs: &[Job], arguments: &Arguments, reports: &mut Reports) -> anyhow::Result<()> {
    for (name, job) in names.iter().zip(jobs) {
        let text = text(name)?;
        let devices = devices(arguments.device)?;
        let measured = farm::measure(&text, devices, arguments.runs as usize, arguments.frames);
        let report = run_async(measured).with_context(|| format!("could not measure a farm with {}", job.name))?;
        reports.farms.push(report);
    }
    Ok(())
}

fn measure_points(jobs: &[Job], arguments: &Arguments, reports: &mut Reports) -> anyhow::Result<()> {
    for job in jobs {
        for &level in &arguments.simd.0 {
            let report = points(job, level, Duration::from_secs(arguments.seconds));
            reports.points.extend(unless_skipped(report, arguments)?);
        }
    }
    Ok(())
}

fn measure_frames(jobs: &[Job], arguments: &Arguments, reports: &mut Reports) -> anyhow::Result<()> {
    let threads = match arguments.threads {
        Some(threads) => vec![threads as usize],
        None => rows_of_threads(std::thread::available_parallelism().map_or(1, NonZero::get)),
    };
    let levels = &arguments.simd.0;
    let ways: Vec<(Simd, Option<usize>)> =
        levels.iter().flat_map(|&level| threads.iter().map(move |&threads| (level, Some(threads)))).collect();
    for job in jobs {
        for report in frames(job, &ways, arguments.runs as usize) {
            reports.renders.extend(unless_skipped(report, arguments)?);
        }
    }
    Ok(())
}

/// One thread, two, and all cores.
fn rows_of_threads(cores: usize) -> Vec<usize> {
    let mut rows = vec![1, 2.min(cores), cores];
    rows.dedup();
    rows
}

/// If several levels are measured, skips those that this machine does not have.
fn unless_skipped<T>(report: Result<T, RenderError>, arguments: &Arguments) -> anyhow::Result<Option<T>> {
    match report {
        Ok(report) => Ok(Some(report)),
        Err(error @ RenderError::Unavailable { .. }) if arguments.simd.0.len() > 1 => {
            print_note(&format!("skipped: {error}"));
            Ok(None)
        }
        Err(error) => Err(error.into()),
    }
}

fn levels_parser() -> impl TypedValueParser<Value = SimdLevels> {
    PossibleValuesParser::new(["all", "auto", "avx512", "avx2", "portable", "sse4.2", "scalar"]).map(|name| match name
        .as_str()
    {
        "all" => SimdLevels(ALL_LEVELS.to_vec()),
        level => SimdLevels(vec![level.parse().expect("the list above holds the levels' names")]),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_threads_are_distinct() {
        assert_eq!(rows_of_threads(1), [1]);
        assert_eq!(rows_of_threads(2), [1, 2]);
        assert_eq!(rows_of_threads(16), [1, 2, 16]);
    }
}
