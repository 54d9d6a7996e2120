//! `sdfarm cancel`: stops a job.

use clap::Args;
use proto::JobId;

use crate::arguments::ServerArguments;
use crate::follow;
use crate::terminal::say;

/// Arguments of `cancel`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job's id.
    id: JobId,
    #[command(flatten)]
    server: ServerArguments,
}

/// Stops it.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let job = arguments.server.client()?.cancel(arguments.id).await?;
    say(&follow::line(&job))
}
