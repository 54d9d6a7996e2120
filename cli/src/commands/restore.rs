//! `sdfarm restore`: restores a farm from a backup.

use std::path::PathBuf;

use clap::Args;

use crate::terminal::{print_line, print_note};

/// Arguments of `restore`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Folder of the backup.
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
    /// The farm's new data folder, which must be empty.
    #[arg(long, value_name = "FOLDER", env = "SDFARM_DATA")]
    data: PathBuf,
}

/// Restores the farm, and checks every byte.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let restored = server::restore(&arguments.folder, &arguments.data).await?;
    let (made_at, data) = (&restored.made_at, arguments.data.display());
    print_line(&match &restored.store {
        None => format!(
            "restored the farm of {made_at} to {data}: its database and {} pictures are intact",
            restored.pictures
        ),
        Some(store) => format!(
            "restored the farm of {made_at} to {data}: its database is intact; its pictures are in {store}: check them \
             with `sdfarm doctor --data {data}`, and start the server with --store {store}"
        ),
    })?;
    for hash in &restored.missing {
        print_note(&format!("picture {hash} is missing from the backup, or damaged"));
    }
    if !restored.missing.is_empty() {
        anyhow::bail!(
            "{} pictures are lost: `sdfarm doctor --repair --data {}` requeues their frames",
            restored.missing.len(),
            arguments.data.display()
        );
    }
    Ok(())
}
