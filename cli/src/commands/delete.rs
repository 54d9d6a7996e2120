//! `sdfarm delete`: deletes a job and its pictures, or lists what would be deleted.

use clap::Args;
use proto::JobId;

use crate::arguments::ServerArguments;
use crate::terminal::{note, say};

/// Arguments of `delete`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job's id.
    id: JobId,
    #[command(flatten)]
    server: ServerArguments,
    /// Only list what would be deleted.
    #[arg(long, env = "SDFARM_DRY_RUN", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    dry_run: bool,
}

/// Forgets it.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    if arguments.dry_run {
        let preview = client.delete_preview(arguments.id).await?;
        return say(&format!(
            "would remove {} pictures and {} blobs, {} bytes, and {} rows of the database",
            preview.pictures, preview.blobs, preview.size_bytes, preview.rows
        ));
    }
    client.delete(arguments.id).await?;
    note(&format!("deleted {}", arguments.id));
    Ok(())
}
