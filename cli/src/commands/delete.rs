//! `sdfarm delete`: forgets a job and its pictures, or tells what that would take along.

use clap::Args;

use crate::arguments::ServerArguments;
use crate::job_name::JobName;
use crate::terminal::{note, say};

/// Arguments of `delete`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job: its id, the first or last characters of it, its name, or latest.
    #[arg(value_name = "JOB")]
    id: JobName,
    #[command(flatten)]
    server: ServerArguments,
    /// Only tell what would go.
    #[arg(long, env = "SDFARM_DRY_RUN", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    dry_run: bool,
}

/// Forgets it.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    let id = arguments.id.find(&client).await?;
    if arguments.dry_run {
        let preview = client.delete_preview(id).await?;
        return say(&format!(
            "would remove {} pictures and {} blobs, {} bytes, and {} rows of the database",
            preview.pictures, preview.blobs, preview.size_bytes, preview.rows
        ));
    }
    client.delete(id).await?;
    note(&format!("deleted {id}"));
    Ok(())
}
