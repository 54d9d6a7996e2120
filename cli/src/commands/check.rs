//! `sdfarm check`: every fault of a job file, and what its author should know.

use clap::Args;

use crate::job_file::JobFile;
use crate::terminal::{note, say};

/// Arguments of `check`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job file; - for standard input.
    job: String,
}

/// Checks it.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let file = JobFile::read(&arguments.job)?;
    let job = file.parse()?;
    for warning in job.warnings() {
        note(&format!("{}: warning: {warning}", file.name));
    }
    let image = &job.image;
    let (name, frames) = (&file.name, job.frames.count);
    say(&format!("{name}: sound: {}×{}, {} samples, {frames} frames", image.width, image.height, image.samples))
}
