//! `sdfarm reorder`: moves a job in the queue.

use clap::Args;
use proto::job::JobMove;

use crate::arguments::ServerArguments;
use crate::follow;
use crate::job_name::JobName;
use crate::terminal::print_line;

/// Arguments of `reorder`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job: its id, the first or last characters of it, its name, or latest.
    #[arg(value_name = "JOB")]
    id: JobName,
    #[command(flatten)]
    place: Target,
    #[command(flatten)]
    server: ServerArguments,
}

#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
struct Target {
    /// Right before this job, with its priority.
    #[arg(long, value_name = "JOB", env = "SDFARM_BEFORE")]
    before: Option<JobName>,
    /// Right after this job, with its priority.
    #[arg(long, value_name = "JOB", env = "SDFARM_AFTER")]
    after: Option<JobName>,
    /// Before all others, with the highest priority among them.
    #[arg(long, env = "SDFARM_FIRST", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    first: bool,
}

/// Moves the job.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    let Target { before, after, first } = arguments.place;
    let mut place = JobMove { first, ..JobMove::default() };
    if let Some(before) = before {
        place.before = Some(before.find(&client).await?);
    }
    if let Some(after) = after {
        place.after = Some(after.find(&client).await?);
    }
    let job = client.reorder_job(arguments.id.find(&client).await?, &place).await?;
    print_line(&follow::line(&job))
}
