//! Applies pending migrations without starting a server: before servers are replaced one by one, or to find out what
//! stands in the way.

use std::path::Path;
use std::time::Duration;

use super::DataFolderError;
use crate::db::{self, Connection, Database, DatabaseError, DatabaseLocation, PostgresAddress, Sharing};
use crate::lock::FolderLock;
use crate::private_files;

/// Result of a migration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Migrated {
    /// The database.
    pub database: String,
    /// Number of migrations that were applied.
    pub applied: i64,
    /// Number of the newest one.
    pub newest: i64,
}

/// Applies the migrations of this release to the database at an address, beside servers that share it, or to that of a
/// stopped farm.
pub async fn migrate(data: &Path, database: Option<PostgresAddress>) -> Result<Migrated, DataFolderError> {
    let location = match database {
        Some(address) => DatabaseLocation { data: data.to_owned(), postgres: Some(address) },
        None => DatabaseLocation::of_folder(data).map_err(DataFolderError::file("read", data))?,
    };
    let lock = match &location.postgres {
        Some(_) => None,
        None if !Database::file(data).is_file() => return Err(DataFolderError::NoDatabase(data.to_owned())),
        None => Some(FolderLock::acquire(data).map_err(DataFolderError::lock(data))?),
    };
    let failed = |source: Box<dyn std::error::Error + Send + Sync>| DataFolderError::Migrate {
        database: location.to_string(),
        source,
    };
    // A database without tables has none.
    let (before, _) = applied(&location).await.unwrap_or_default();
    let opened = Database::open_at(&location, Sharing::Shared).await.map_err(|error| failed(error.into()))?;
    opened.close().await;
    if lock.is_some() {
        private_files::restrict(data)?;
    }
    let (after, newest) = applied(&location).await.map_err(|error| failed(error.into()))?;
    Ok(Migrated { database: location.to_string(), applied: after - before, newest })
}

/// Number of applied migrations, and that of the newest.
async fn applied(location: &DatabaseLocation) -> Result<(i64, i64), DatabaseError> {
    let mut connection = Connection::beside_server(location, Duration::ZERO).await?;
    let row = db::query("SELECT count(*) AS applied, coalesce(max(version), 0) AS newest FROM _sqlx_migrations")
        .fetch_one(&mut connection)
        .await;
    connection.close().await?;
    let row = row?;
    Ok((row.get("applied")?, row.get("newest")?))
}
