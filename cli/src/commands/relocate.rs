//! `sdfarm move`: moves the database of a stopped farm to a PostgreSQL server, or back to a file.

use std::path::PathBuf;

use clap::Args;
use server::PostgresAddress;

use crate::terminal::print_line;

/// Arguments of `move`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Data folder of the farm, which must be stopped.
    #[arg(long, value_name = "FOLDER", env = "SDFARM_DATA", default_value = "./sdfarm-data")]
    data: PathBuf,
    /// Empty database for the farm: its address on a PostgreSQL server, or `file` for a file in the data folder.
    #[arg(long, value_name = "postgres://USER@HOST/NAME|file", env = "SDFARM_TO", hide_env_values = true, value_parser = target)]
    to: Target,
    /// Address of the farm's database on a PostgreSQL server, if it needs a password [default: the one that the folder records].
    #[arg(long, value_name = "postgres://USER@HOST/NAME", env = "SDFARM_DATABASE", hide_env_values = true)]
    database: Option<PostgresAddress>,
}

/// Place to move to.
#[derive(Clone, Debug)]
enum Target {
    File,
    Postgres(PostgresAddress),
}

fn target(text: &str) -> Result<Target, String> {
    if text == "file" {
        return Ok(Target::File);
    }
    text.parse().map(Target::Postgres).map_err(|error: server::ParseDatabaseError| error.to_string())
}

/// Moves the database.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let to = match arguments.to {
        Target::File => None,
        Target::Postgres(address) => Some(address),
    };
    let is_file = to.is_none();
    let moved = server::move_database(&arguments.data, arguments.database, to).await?;
    print_line(&format!(
        "moved {} rows to {}; {} is kept: delete it when all is well",
        moved.rows, moved.to, moved.from
    ))?;
    print_line(&format!(
        "start the server with --data {}{}",
        arguments.data.display(),
        if is_file { String::new() } else { format!(" --database {}", moved.to) }
    ))
}
