//! `sdfarm watch`: follows a job until it is finished.

use clap::Args;

use crate::arguments::ServerArguments;
use crate::follow;
use crate::job_name::JobName;
use crate::terminal::print_line;

/// Arguments of `watch`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job: its id, the first or last characters of it, its name, or latest.
    #[arg(value_name = "JOB")]
    id: JobName,
    #[command(flatten)]
    server: ServerArguments,
}

/// Follows the job; a failed or cancelled job is an error.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    let job = follow::wait_for_success(&client, arguments.id.find(&client).await?).await?;
    print_line(&follow::line(&job))
}
