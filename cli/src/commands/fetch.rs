//! `sdfarm fetch`: saves a stored picture, or all of a job's.

use std::path::Path;

use clap::Args;

use crate::arguments::ServerArguments;
use crate::job_name::JobName;
use crate::{follow, sequence};

/// Arguments of `fetch`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job: its id, the first or last characters of it, its name, or latest.
    #[arg(value_name = "JOB")]
    id: JobName,
    #[command(flatten)]
    server: ServerArguments,
    /// Where to save the picture, or, where it ends in .zip, all pictures as one archive; - for standard output.
    /// With --all a folder.
    #[arg(long, short, value_name = "FILE", env = "SDFARM_OUTPUT")]
    output: String,
    /// Which frame, from 0.
    #[arg(long, value_name = "N", env = "SDFARM_FRAME", default_value_t = 0)]
    frame: u32,
    /// Save every picture, each in a file of its own.
    #[arg(long, env = "SDFARM_ALL", conflicts_with = "frame", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    all: bool,
    /// Take what is stored although the job has not ended.
    #[arg(long, env = "SDFARM_PARTIAL", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    partial: bool,
}

/// Saves it.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    let id = arguments.id.find(&client).await?;
    if arguments.all {
        return sequence::save(&client, id, &arguments.output, arguments.partial).await;
    }
    if Path::new(&arguments.output).extension().is_some_and(|end| end.eq_ignore_ascii_case("zip")) {
        return sequence::archive(&client, id, &arguments.output, arguments.partial).await;
    }
    follow::fetch(&client, id, arguments.frame, &arguments.output).await
}
