//! Moves the database of a stopped farm: from the file in its data folder to a PostgreSQL server, and back.

use std::fs;
use std::path::{Path, PathBuf};

use super::DataFolderError;
use crate::db::{Database, DatabaseLocation, PostgresAddress, Sharing};
use crate::lock::FolderLock;

/// Result of a move.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MovedDatabase {
    /// Number of rows.
    pub rows: u64,
    /// The database that the farm had; it is kept.
    pub from: String,
    /// The database that it has now.
    pub to: String,
}

/// Copies the database of the farm in `data` to another one, which must be empty: to `to`, or to the file in the data folder. The
/// farm must be stopped. `from` is the address of its current database with a password, if it needs one.
pub async fn move_database(
    data: &Path,
    from: Option<PostgresAddress>,
    to: Option<PostgresAddress>,
) -> Result<MovedDatabase, DataFolderError> {
    let lock = FolderLock::acquire(data).map_err(DataFolderError::lock(data))?;
    let read = || DataFolderError::file("read", data);
    let mut source = DatabaseLocation::of_folder(data).map_err(read())?;
    let file = Database::file(data);
    if source.postgres.is_none() && !file.is_file() {
        return Err(DataFolderError::NoDatabase(data.to_owned()));
    }
    if source.postgres.is_some() && from.is_some() {
        source.postgres = from;
    }
    let target = DatabaseLocation { data: data.to_owned(), postgres: to };
    if source.postgres.is_some() == target.postgres.is_some() {
        return Err(DataFolderError::SameEngine(source.to_string()));
    }
    let failed = |location: &DatabaseLocation| {
        let database = location.to_string();
        move |source: Box<dyn std::error::Error + Send + Sync>| DataFolderError::Move { database, source }
    };
    let old = Database::open_at(&source, Sharing::Alone).await.map_err(|error| failed(&source)(error.into()))?;
    let new = Database::open_at(&target, Sharing::Alone).await.map_err(|error| failed(&target)(error.into()))?;
    let copied = async {
        if !new.is_empty().await.map_err(|error| failed(&target)(error.into()))? {
            return Err(DataFolderError::DatabaseNotEmpty(target.to_string()));
        }
        old.copy_to(&new).await.map_err(|error| failed(&target)(error.into()))
    };
    let copied = copied.await;
    old.close().await;
    new.close().await;
    let rows = copied?;
    let kept = record(&source, &target).map_err(DataFolderError::file("write", data))?;
    drop(lock);
    let from = kept.map_or_else(|| source.to_string(), |file| file.display().to_string());
    Ok(MovedDatabase { rows, from, to: target.to_string() })
}

/// Records the new database, which from then on is the farm's; returns the old file, if it was one, under its new name.
fn record(source: &DatabaseLocation, target: &DatabaseLocation) -> std::io::Result<Option<PathBuf>> {
    if target.postgres.is_none() {
        source.forget()?;
        return Ok(None);
    }
    target.record()?;
    let file = Database::file(&source.data);
    let kept = file.with_extension("sqlite.moved");
    fs::rename(&file, &kept)?;
    Ok(Some(kept))
}
