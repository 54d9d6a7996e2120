//! `sdfarm watch`: follows a job until it is finished.

use clap::Args;

use crate::arguments::ServerArguments;
use crate::follow;
use crate::job_name::JobName;
use crate::terminal::say;

/// Arguments of `watch`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job: its id, the first or last characters of it, its name, or latest.
    #[arg(value_name = "JOB")]
    id: JobName,
    #[command(flatten)]
    server: ServerArguments,
}

/// Follows it; a job that failed or was cancelled is a failure.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    let job = follow::until_done(&client, arguments.id.find(&client).await?).await?;
    say(&follow::line(&job))
}
