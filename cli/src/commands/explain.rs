//! `sdfarm explain`: what becomes of a job.

use clap::Args;
use worker::cuda::Source;

use crate::commands::render::check_frame;
use crate::job_file::JobFile;
use crate::terminal::{note, say};

/// Arguments of `explain`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job file; - for standard input.
    job: String,
    /// Print the program that a GPU is given; the numbers of the scene are its array k.
    #[arg(long, env = "SDFARM_CUDA", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    cuda: bool,
    /// Frame number, from 0: the kernel is the same for all frames.
    #[arg(long, value_name = "N", env = "SDFARM_FRAME", default_value_t = 0)]
    frame: u32,
}

/// Prints it.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let job = JobFile::read(&arguments.job)?.parse()?;
    check_frame(&job, arguments.frame)?;
    let source = Source::new(&job.at(arguments.frame)?);
    if arguments.cuda {
        return say(source.text.trim_end());
    }
    let image = &job.image;
    say(&format!("{}: {} nodes, {} frames", job.name, job.nodes(), job.frames.count))?;
    say(&format!("a frame: {}×{} pixels, {} camera rays", image.width, image.height, job.rays_per_frame()))?;
    let distance =
        source.distance_operations.map_or_else(|| "with loops".to_owned(), |count| format!("{count} operations"));
    let (statements, numbers) = (source.statements, source.parameters.len());
    say(&format!("a distance: {distance}; the whole program: {statements} statements on {numbers} numbers"))?;
    note("the program itself: add --cuda");
    Ok(())
}
