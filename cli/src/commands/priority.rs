//! `sdfarm priority`: changes a job's priority.

use clap::Args;
use proto::job::JobPatch;

use crate::arguments::ServerArguments;
use crate::follow;
use crate::job_name::JobName;
use crate::terminal::print_line;

/// Arguments of `priority`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job: its id, the first or last characters of it, its name, or latest.
    #[arg(value_name = "JOB")]
    id: JobName,
    /// Priority, from -100 to 100: jobs of higher priority are leased first.
    #[arg(value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(i32).range(-100..=100))]
    priority: i32,
    #[command(flatten)]
    server: ServerArguments,
}

/// Changes the job's priority.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let patch = JobPatch { priority: Some(arguments.priority) };
    let client = arguments.server.client()?;
    let job = client.patch(arguments.id.find(&client).await?, &patch).await?;
    print_line(&follow::line(&job))
}
