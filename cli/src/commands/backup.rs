//! `sdfarm backup`: backs up a farm while it runs.

use std::path::PathBuf;

use clap::Args;

use crate::terminal::{print_line, print_note};

/// Arguments of `backup`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Folder of the backup: an empty one, or an earlier backup's, which gets only new pictures.
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
    /// The farm's data folder; a server may be using it.
    #[arg(long, value_name = "FOLDER", env = "SDFARM_DATA", default_value = "./sdfarm-data")]
    data: PathBuf,
}

/// Backs up the farm and prints a summary.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let backup = server::back_up(&arguments.data, &arguments.folder).await?;
    let folder = arguments.folder.display();
    print_line(&match &backup.store {
        None => format!(
            "{} pictures are in {folder}: {} copied now ({} bytes), {} dropped",
            backup.pictures, backup.copied, backup.copied_bytes, backup.removed
        ),
        Some(store) => format!(
            "the database is in {folder}; {} pictures stay in {store}, which this backup does not protect: turn on its \
             versioning ({folder}/pictures.txt lists them)",
            backup.pictures
        ),
    })?;
    for hash in &backup.missing {
        print_note(&format!("picture {hash} is missing from the store, or damaged"));
    }
    if !backup.missing.is_empty() {
        anyhow::bail!(
            "{} pictures could not be copied; the others were: see `sdfarm doctor --deep`",
            backup.missing.len()
        );
    }
    Ok(())
}
