//! Restores a farm from a backup into a new folder: every byte is verified, and the database is written last.

use std::fs;
use std::path::Path;
use std::time::Duration;

use super::manifest::Manifest;
use super::{DataFolderError, database, hashed_files};
use crate::db::{Connection, Database, DatabaseError, DatabaseLocation};
use crate::lock::FolderLock;
use crate::private_files;
use crate::queue::mark_restored;

/// Result of a restore.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Restored {
    /// Time of the backup: RFC 3339, UTC.
    pub made_at: String,
    /// Number of restored pictures.
    pub pictures: u64,
    /// Number of pictures that the backup lacks.
    pub missing: Vec<String>,
    /// Bucket in which the pictures are; `None` if they were restored.
    pub store: Option<String>,
}

/// Restores the backup in `folder` into `data`, which must be new or empty.
pub async fn restore(folder: &Path, data: &Path) -> Result<Restored, DataFolderError> {
    let Some(manifest) = Manifest::read(folder)? else { return Err(DataFolderError::NoBackup(folder.to_owned())) };
    if fs::read_dir(data).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(DataFolderError::NotEmpty(data.to_owned()));
    }
    let copy = manifest.database_file(folder);
    let damaged = |reason: String| DataFolderError::Damaged { path: copy.clone(), reason };
    let (actual, _) = hashed_files::hash(&copy).map_err(|error| damaged(error.to_string()))?;
    if actual != manifest.database {
        return Err(damaged(format!("its BLAKE3 is {actual}")));
    }
    let mut connection = database::open_file(&copy).await?;
    if let Some(fault) =
        connection.integrity_errors().await.map_err(DataFolderError::database(&copy))?.into_iter().next()
    {
        return Err(damaged(fault));
    }
    let names = database::pictures(&mut connection).await.map_err(DataFolderError::database(&copy))?;
    connection.close().await.map_err(DataFolderError::database(&copy))?;

    let pictures = data.join("pictures");
    private_files::create_folder(&pictures).map_err(DataFolderError::file("make", &pictures))?;
    let lock = FolderLock::acquire(data).map_err(DataFolderError::lock(data))?;
    let mut restored =
        Restored { made_at: manifest.made_at.clone(), store: manifest.store.clone(), ..Restored::default() };
    for named in names.into_iter().filter(|_| manifest.store.is_none()) {
        let from = folder.join("pictures").join(&named.hash);
        match hashed_files::copy(&from, &pictures.join(&named.hash), &named.hash) {
            Ok(true) => restored.pictures += 1,
            Ok(false) => restored.missing.push(named.hash),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => restored.missing.push(named.hash),
            Err(error) => return Err(DataFolderError::file("copy", &from)(error)),
        }
    }
    for name in &manifest.files {
        fs::copy(folder.join(name), data.join(name)).map_err(DataFolderError::file("copy", &folder.join(name)))?;
    }
    hashed_files::sync_folder(&pictures).map_err(DataFolderError::file("write", &pictures))?;
    let file = Database::file(data);
    match hashed_files::copy(&copy, &file, &manifest.database) {
        Ok(true) => {}
        Ok(false) => return Err(damaged("it changed while it was copied".to_owned())),
        Err(error) => return Err(DataFolderError::file("write", &file)(error)),
    }
    mark(data).await.map_err(DataFolderError::database(&file))?;
    private_files::restrict(data)?;
    hashed_files::sync_folder(data).map_err(DataFolderError::file("write", data))?;
    drop(lock);
    Ok(restored)
}

/// Records in the database of a data folder that it was restored.
async fn mark(data: &Path) -> Result<(), DatabaseError> {
    let location = DatabaseLocation { data: data.to_owned(), postgres: None };
    let mut connection = Connection::beside_server(&location, Duration::ZERO).await?;
    mark_restored(&mut connection).await?;
    connection.close().await
}
