//! `sdfarm fetch`: saves a stored picture.

use clap::Args;
use proto::JobId;

use crate::arguments::ServerArguments;
use crate::follow;

/// Arguments of `fetch`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job's id.
    id: JobId,
    #[command(flatten)]
    server: ServerArguments,
    /// Where to save the picture; - for standard output.
    #[arg(long, short, value_name = "FILE", env = "SDFARM_OUTPUT")]
    output: String,
    /// Which frame, from 0.
    #[arg(long, value_name = "N", env = "SDFARM_FRAME", default_value_t = 0)]
    frame: u32,
}

/// Saves it.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    follow::fetch(&client, arguments.id, arguments.frame, &arguments.output).await
}
