//! `sdfarm fetch`: saves a stored picture, or all of a job's.

use std::path::Path;

use clap::Args;
use proto::JobId;

use crate::arguments::ServerArguments;
use crate::{follow, sequence};

/// Arguments of `fetch`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job's id.
    id: JobId,
    #[command(flatten)]
    server: ServerArguments,
    /// File for the picture or, if it ends in .zip, for all pictures as one archive; - for standard
    /// output. With --all a folder.
    #[arg(long, short, value_name = "FILE", env = "SDFARM_OUTPUT")]
    output: String,
    /// Which frame, from 0.
    #[arg(long, value_name = "N", env = "SDFARM_FRAME", default_value_t = 0)]
    frame: u32,
    /// Save every picture, each in a file of its own.
    #[arg(long, env = "SDFARM_ALL", conflicts_with = "frame", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    all: bool,
    /// Save the stored pictures although the job has not finished.
    #[arg(long, env = "SDFARM_PARTIAL", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    partial: bool,
}

/// Saves it.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    if arguments.all {
        return sequence::save(&client, arguments.id, &arguments.output, arguments.partial).await;
    }
    if Path::new(&arguments.output).extension().is_some_and(|end| end.eq_ignore_ascii_case("zip")) {
        return sequence::archive(&client, arguments.id, &arguments.output, arguments.partial).await;
    }
    follow::fetch(&client, arguments.id, arguments.frame, &arguments.output).await
}
