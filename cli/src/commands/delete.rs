//! `sdfarm delete`: deletes a job and its pictures, or lists what would be deleted.

use clap::Args;

use crate::arguments::ServerArguments;
use crate::counted::counted;
use crate::job_name::JobName;
use crate::terminal::{print_line, print_note};

/// Arguments of `delete`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// The job: its id, the first or last characters of it, its name, or latest.
    #[arg(value_name = "JOB")]
    id: JobName,
    #[command(flatten)]
    server: ServerArguments,
    /// Only list what would be deleted.
    #[arg(long, env = "SDFARM_DRY_RUN", value_parser = clap::builder::FalseyValueParser::new(), action = clap::ArgAction::SetTrue)]
    dry_run: bool,
}

/// Deletes the job, or lists what would be deleted.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    let id = arguments.id.find(&client).await?;
    if arguments.dry_run {
        let preview = client.delete_dry_run(id).await?;
        return print_line(&format!(
            "would delete {} and {}, {}, and {} of the database",
            counted(preview.pictures, "picture"),
            counted(preview.blobs, "blob"),
            counted(preview.size_bytes, "byte"),
            counted(preview.rows, "row")
        ));
    }
    client.delete(id).await?;
    print_note(&format!("deleted {id}"));
    Ok(())
}
