//! `sdfarm preview`: saves the finished part of a frame.

use anyhow::Context;
use clap::Args;

use crate::arguments::ServerArguments;
use crate::job_name::JobName;
use crate::output_file::OutputFile;
use crate::terminal::print_note;

/// Arguments of `preview`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job: its id, the first or last characters of it, its name, or latest.
    #[arg(value_name = "JOB")]
    id: JobName,
    #[command(flatten)]
    server: ServerArguments,
    /// File for the preview, a PNG; - for standard output.
    #[arg(long, short, value_name = "FILE", env = "SDFARM_OUTPUT")]
    output: String,
    /// Frame number, from 0.
    #[arg(long, value_name = "N", env = "SDFARM_FRAME", default_value_t = 0)]
    frame: u32,
    /// Maximum width, in pixels [default: 960].
    #[arg(long, value_name = "PIXELS", env = "SDFARM_WIDTH", value_parser = clap::value_parser!(u32).range(1..))]
    width: Option<u32>,
}

/// Saves the preview.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let Arguments { id, server, output: path, frame, width } = arguments;
    let client = server.client()?;
    let id = id.find(&client).await?;
    let mut output = OutputFile::create(&path)?;
    let size_bytes = client
        .preview(id, frame, width, output.file())
        .await
        .with_context(|| format!("could not fetch a preview of frame {frame} of job {id}"))?;
    output.commit()?;
    if path != "-" {
        print_note(&format!("wrote {path}: {size_bytes} bytes"));
    }
    Ok(())
}
