//! `sdfarm check`: reports every error of a job file, and its warnings.

use clap::Args;
use proto::tile::Tiling;
use scene::{Image, Job};

use crate::job_file::JobFile;
use crate::sketch::sample;
use crate::terminal::{note, say};

/// Arguments of `check`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job file; - for standard input.
    job: String,
    /// Render a sixteenth of its pixels, and estimate its time on this machine.
    #[arg(long, env = "SDFARM_ESTIMATE", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    estimate: bool,
}

/// Most time for rendering a sample, in milliseconds.
const RENDER_MS: u64 = 700;

/// Checks it.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let file = JobFile::read(&arguments.job)?;
    let job = file.parse()?;
    for warning in job.warnings() {
        note(&format!("{}: warning: {warning}", file.name));
    }
    let image = &job.image;
    let (name, frames) = (&file.name, job.frames.count);
    say(&format!("{name}: sound: {}×{}, {} samples, {frames} frames", image.width, image.height, image.samples))?;
    if arguments.estimate { estimate(&job) } else { Ok(()) }
}

/// Prints the estimated time of a job on all cores of this machine.
fn estimate(job: &Job) -> anyhow::Result<()> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let sample = sample(job, threads, RENDER_MS)?;
    let Image { width, height, samples, .. } = job.image;
    let tiling = Tiling { width, height, samples, pixel_bytes: job.image.pixel_bytes(), edge: None };
    let frames = u64::from(job.frames.count);
    let rays = job.rays_per_frame() * frames;
    let core_seconds = sample.core_seconds(rays, tiling.tiles().len() as u64 * frames, job.image.pixels() * frames);
    let (seconds, memory_mib) = (core_seconds / threads as f64, sample.memory_bytes >> 20);
    say(&format!(
        "about {seconds:.2} s on this machine's {threads} cores ({core_seconds:.2} s of one), \
         {rays} camera rays, {memory_mib} MiB; judged by {} rays",
        sample.rays
    ))
}
