//! `sdfarm priority`: moves a job before or behind others.

use clap::Args;
use proto::JobId;
use proto::change::JobPatch;

use crate::arguments::ServerArguments;
use crate::follow;
use crate::terminal::say;

/// Arguments of `priority`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job's id.
    id: JobId,
    /// Priority, from -100 to 100: jobs of higher priority are leased first.
    #[arg(value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(i32).range(-100..=100))]
    priority: i32,
    #[command(flatten)]
    server: ServerArguments,
}

/// Moves it.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let patch = JobPatch { priority: Some(arguments.priority) };
    let job = arguments.server.client()?.patch(arguments.id, &patch).await?;
    say(&follow::line(&job))
}
