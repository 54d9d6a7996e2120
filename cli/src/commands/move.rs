//! `sdfarm move`: moves the database of a stopped farm to a PostgreSQL server, or back to a file, and its pictures to a
//! bucket, or back to the data folder.

use std::path::PathBuf;

use clap::Args;
use server::{PostgresAddress, StoreLocation};

use crate::terminal::print_line;

/// Arguments of `move`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Data folder of the farm, which must be stopped.
    #[arg(long, value_name = "FOLDER", env = "SDFARM_DATA", default_value = "./sdfarm-data")]
    data: PathBuf,
    /// Empty database for the farm: its address on a PostgreSQL server, or `file` for a file in the data folder.
    #[arg(long, value_name = "postgres://USER@HOST/NAME|file", env = "SDFARM_TO", hide_env_values = true, value_parser = target, required_unless_present = "store_to")]
    to: Option<Target>,
    /// Store for the farm's pictures: a bucket of an S3 store, or `folder` for the data folder. A move that was interrupted goes on.
    #[arg(long, value_name = "s3://BUCKET/PREFIX|folder", env = "SDFARM_STORE_TO", value_parser = store)]
    store_to: Option<StoreLocation>,
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

fn store(text: &str) -> Result<StoreLocation, String> {
    if text == "folder" {
        return Ok(StoreLocation::Folder);
    }
    text.parse().map_err(|error: server::ParseStoreError| format!("{error}: write folder for that"))
}

/// Moves the pictures, then the database.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let mut flags = vec![format!("--data {}", arguments.data.display())];
    if let Some(store) = &arguments.store_to {
        move_pictures(&arguments, store).await?;
        if *store != StoreLocation::Folder {
            flags.push(format!("--store {store}"));
        }
    }
    if let Some(to) = arguments.to {
        let to = match to {
            Target::File => None,
            Target::Postgres(address) => Some(address),
        };
        let is_file = to.is_none();
        let moved = server::move_database(&arguments.data, arguments.database, to).await?;
        print_line(&format!(
            "moved {} rows to {}; {} is kept: delete it when all is well",
            moved.rows, moved.to, moved.from
        ))?;
        if !is_file {
            flags.push(format!("--database {}", moved.to));
        }
    }
    print_line(&format!("start the server with {}", flags.join(" ")))
}

async fn move_pictures(arguments: &Arguments, store: &StoreLocation) -> anyhow::Result<()> {
    let moved = server::move_pictures(&arguments.data, arguments.database.clone(), store).await?;
    print_line(&format!(
        "moved {} pictures and tiles ({} bytes) to {}, where {} were already; those in {} are kept: delete them when all is well",
        moved.copied, moved.copied_bytes, moved.to, moved.there, moved.from
    ))?;
    if let Some(first) = moved.missing.first() {
        print_line(&format!(
            "{} are missing from {} or damaged, {first} first: they are rendered again when they are needed",
            moved.missing.len(),
            moved.from
        ))?;
    }
    Ok(())
}
