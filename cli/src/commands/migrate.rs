//! `sdfarm migrate`: applies the migrations of this release to a farm's database, without starting a server.

use std::path::PathBuf;

use clap::Args;
use server::PostgresAddress;

use crate::terminal::print_line;

/// Arguments of `migrate`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Data folder of the farm.
    #[arg(long, value_name = "FOLDER", env = "SDFARM_DATA", default_value = "./sdfarm-data")]
    data: PathBuf,
    /// Database on a PostgreSQL server [default: the one that the folder records, or the file in it].
    #[arg(long, value_name = "postgres://USER@HOST/NAME", env = "SDFARM_DATABASE", hide_env_values = true)]
    database: Option<PostgresAddress>,
}

/// Applies the migrations.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let migrated = server::migrate(&arguments.data, arguments.database).await?;
    print_line(&match migrated.applied {
        0 => format!("{} is up to date: its newest migration is {}", migrated.database, migrated.newest),
        applied => format!("{} was migrated by {applied} to {}", migrated.database, migrated.newest),
    })
}
