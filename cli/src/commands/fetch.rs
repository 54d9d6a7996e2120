//! `sdfarm fetch`: saves a stored picture, or all pictures of a job.

use std::path::Path;

use clap::Args;

use crate::arguments::ServerArguments;
use crate::job_name::JobName;
use crate::output_file::is_folder;
use crate::{follow, frame_files};

/// Arguments of `fetch`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job: its id, the first or last characters of it, its name, or latest.
    #[arg(value_name = "JOB")]
    id: JobName,
    #[command(flatten)]
    server: ServerArguments,
    /// Output: a file for one picture, a folder (`DIR/`) for all of them, a file that ends in .zip for one archive of
    /// all; - for standard output.
    #[arg(long, short, value_name = "FILE", env = "SDFARM_OUTPUT")]
    output: String,
    /// Frame number, from 0 [default: 0; for a folder, all frames].
    #[arg(long, value_name = "N", env = "SDFARM_FRAME")]
    frame: Option<u32>,
    /// Save every picture in its own file; -o names the folder.
    #[arg(long, env = "SDFARM_ALL", conflicts_with = "frame", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    all: bool,
    /// Save the stored pictures even if the job has not finished.
    #[arg(long, env = "SDFARM_PARTIAL", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    partial: bool,
}

/// Saves the pictures.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    let id = arguments.id.find(&client).await?;
    if arguments.all || (arguments.frame.is_none() && is_folder(&arguments.output)) {
        return frame_files::save(&client, id, &arguments.output, arguments.partial).await;
    }
    if Path::new(&arguments.output).extension().is_some_and(|end| end.eq_ignore_ascii_case("zip")) {
        return frame_files::archive(&client, id, &arguments.output, arguments.partial).await;
    }
    let frame = arguments.frame.unwrap_or(0);
    if is_folder(&arguments.output) {
        return frame_files::save_one(&client, id, frame, &arguments.output).await;
    }
    follow::fetch(&client, id, frame, &arguments.output).await
}
