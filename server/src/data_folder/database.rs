//! Read-only view of a farm's database for backup and checks.

use std::path::Path;

use super::DataFolderError;
use crate::db::{self, Connection, Database, DatabaseError, DatabaseLocation, FarmId, Target};

/// Picture in the database.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct PictureRef {
    /// BLAKE3 of its bytes, in hex.
    pub(super) hash: String,
    /// Its size in bytes.
    pub(super) size_bytes: u64,
}

/// Opens the database of a data folder for reading, also next to a running server.
pub(super) async fn open(data: &Path) -> Result<Connection, DataFolderError> {
    let location = DatabaseLocation::of_folder(data).map_err(DataFolderError::file("read", data))?;
    if let Some(address) = location.postgres {
        return Err(DataFolderError::InPostgres { folder: data.to_owned(), address });
    }
    let file = Database::file(data);
    if !file.is_file() {
        return Err(DataFolderError::NoDatabase(data.to_owned()));
    }
    open_file(&file).await
}

/// Opens any database file for reading.
pub(super) async fn open_file(file: &Path) -> Result<Connection, DataFolderError> {
    Connection::read_file(file).await.map_err(DataFolderError::database(file))
}

/// Every picture in the database.
pub(super) async fn pictures(database: impl Into<Target<'_>>) -> Result<Vec<PictureRef>, DatabaseError> {
    let rows = db::query(
        "SELECT picture AS hash, size_bytes FROM frame WHERE picture IS NOT NULL
         UNION SELECT hash, size_bytes FROM picture ORDER BY 1",
    )
    .fetch_all(database)
    .await?;
    rows.iter().map(|row| Ok(PictureRef { hash: row.get("hash")?, size_bytes: row.get("size_bytes")? })).collect()
}

/// Every blob of an unfinished frame, or of a recorded job, and the records.
pub(super) async fn blobs(database: impl Into<Target<'_>>) -> Result<Vec<String>, DatabaseError> {
    db::query_scalar(
        "SELECT DISTINCT tile.blob FROM tile JOIN frame ON frame.job = tile.job AND frame.number = tile.frame
         WHERE tile.blob IS NOT NULL AND (frame.state IN ('open', 'stitching') OR tile.record IS NOT NULL)
         UNION SELECT record FROM tile WHERE record IS NOT NULL",
    )
    .fetch_all(database)
    .await
}

/// The farm of the database; `None` if no server of this release has used it.
pub(super) async fn farm_id(connection: &mut Connection) -> Result<Option<FarmId>, DatabaseError> {
    let id = db::query_scalar("SELECT value FROM meta WHERE name = 'farm_id'").fetch_optional(connection).await?;
    Ok(id.map(FarmId::new))
}

/// Submission time of the newest job, by the wall clock.
pub(super) async fn newest_ms(connection: &mut Connection) -> Result<Option<i64>, DatabaseError> {
    db::query_scalar("SELECT created_at_ms FROM job ORDER BY number DESC LIMIT 1").fetch_optional(connection).await
}

/// Differences between the database's migrations and this release's, a line each, and whether the next start
/// fixes it.
pub(super) async fn migrations(connection: &mut Connection) -> Result<Vec<(String, bool)>, DatabaseError> {
    let rows =
        db::query("SELECT version, checksum, success FROM _sqlx_migrations ORDER BY version").fetch_all(connection);
    let mut odd = Vec::new();
    let mut done = Vec::new();
    for row in rows.await? {
        let (version, checksum): (i64, Vec<u8>) = (row.get("version")?, row.get("checksum")?);
        match db::migrations().find(|(known, _)| *known == version) {
            None => odd.push((format!("migration {version} is from a newer release"), false)),
            Some((_, known)) if known != checksum => {
                odd.push((format!("migration {version} differs from this release's"), false));
            }
            Some(_) if !row.get::<bool>("success")? => {
                odd.push((format!("migration {version} was interrupted"), false));
            }
            Some(_) => {}
        }
        done.push(version);
    }
    let missing = db::migrations().filter(|(version, _)| !done.contains(version)).count();
    if missing > 0 {
        odd.push((format!("{missing} migrations are pending"), true));
    }
    Ok(odd)
}
