//! `sdfarm watch`: follows a job until it is finished.

use clap::Args;
use proto::JobId;

use crate::arguments::ServerArguments;
use crate::follow;
use crate::terminal::say;

/// Arguments of `watch`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job's id.
    id: JobId,
    #[command(flatten)]
    server: ServerArguments,
}

/// Follows it; a job that failed or was cancelled is a failure.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    let job = follow::until_done(&client, arguments.id).await?;
    say(&follow::line(&job))
}
