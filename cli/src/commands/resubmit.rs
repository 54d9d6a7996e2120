//! `sdfarm resubmit`: submits a job's file again, optionally with changes.

use clap::Args;

use crate::arguments::ServerArguments;
use crate::job_name::JobName;
use crate::terminal::{escape_line, print_line, print_note};

/// Arguments of `resubmit`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job: its id, the first or last characters of it, its name, or latest.
    #[arg(value_name = "JOB")]
    id: JobName,
    #[command(flatten)]
    server: ServerArguments,
    /// Changes to its file, as a JSON merge patch: '{"image": {"samples": 64}}'; null removes a member.
    #[arg(long, value_name = "JSON", env = "SDFARM_PATCH")]
    patch: Option<String>,
    /// Render the job again even if its pictures are already stored.
    #[arg(long, env = "SDFARM_NO_CACHE", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    no_cache: bool,
}

/// Submits the file, and prints the new job's id.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    let id = arguments.id.find(&client).await?;
    let job = client.resubmit(id, arguments.patch, arguments.no_cache).await?;
    for warning in &job.warnings {
        print_note(&format!("{}: warning: {}", escape_line(&job.name), escape_line(warning)));
    }
    print_line(&job.id.to_string())
}
