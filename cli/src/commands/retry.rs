//! `sdfarm retry`: has the dead tiles of a failed job rendered again.

use clap::Args;
use proto::JobId;

use crate::arguments::ServerArguments;
use crate::follow;
use crate::terminal::say;

/// Arguments of `retry`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job's id.
    id: JobId,
    #[command(flatten)]
    server: ServerArguments,
}

/// Has them rendered.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let job = arguments.server.client()?.retry(arguments.id).await?;
    say(&follow::line(&job))
}
