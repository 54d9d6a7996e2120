//! `sdfarm resubmit`: submits the file of a job again, with changes or without.

use clap::Args;

use crate::arguments::ServerArguments;
use crate::job_name::JobName;
use crate::terminal::{print_line, print_note};

/// Arguments of `resubmit`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job: its id, the first or last characters of it, its name, or latest.
    #[arg(value_name = "JOB")]
    id: JobName,
    #[command(flatten)]
    server: ServerArguments,
    /// Changes to its file, as a JSON merge patch: '{"image": {"samples": 64}}'; null removes a key.
    #[arg(long, value_name = "JSON", env = "SDFARM_PATCH")]
    patch: Option<String>,
    /// Render it anew even if its pictures are stored already.
    #[arg(long, env = "SDFARM_NO_CACHE", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    no_cache: bool,
}

/// Submits it, and prints the new job's id.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    let id = arguments.id.find(&client).await?;
    let job = client.resubmit(id, arguments.patch, arguments.no_cache).await?;
    for warning in &job.warnings {
        print_note(&format!("{}: warning: {warning}", job.name));
    }
    print_line(&job.id.to_string())
}
