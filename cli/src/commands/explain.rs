//! `sdfarm explain`: shows a job's size, or its GPU program.

use clap::Args;
use worker::cuda::KernelSource;

use crate::commands::render::check_frame;
use crate::counted::{counted, counted_len};
use crate::job_file::JobFile;
use crate::terminal::{escape_line, print_line, print_note};

/// Arguments of `explain`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job file; - for standard input.
    job: String,
    /// Print the GPU program; its array k holds the numbers of the scene.
    #[arg(long, env = "SDFARM_CUDA", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    cuda: bool,
    /// Frame number, from 0: the kernel is the same for all frames.
    #[arg(long, value_name = "N", env = "SDFARM_FRAME", default_value_t = 0)]
    frame: u32,
}

/// Prints the size or the program.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let job = JobFile::read(&arguments.job)?.parse()?;
    check_frame(&job, arguments.frame)?;
    let source = KernelSource::new(&job.at(arguments.frame)?)?;
    if arguments.cuda {
        return print_line(source.text.trim_end());
    }
    let film = job.image.film();
    let (nodes, frames) = (counted(job.nodes(), "node"), counted(job.frames.count, "frame"));
    print_line(&format!("{}: {nodes}, {frames}", escape_line(&job.name)))?;
    let rays = counted(job.rays_per_frame(), "camera ray");
    print_line(&format!("each frame: {}×{} pixels, {rays}", film.width, film.height))?;
    let distance =
        source.distance_operations.map_or_else(|| "with loops".to_owned(), |count| counted(count, "operation"));
    let (statements, numbers) =
        (counted_len(source.statements, "statement"), counted_len(source.parameters.len(), "number"));
    print_line(&format!("each distance: {distance}; the complete program: {statements} on {numbers}"))?;
    print_note("add --cuda to print the program");
    Ok(())
}
