//! Maintenance of data folders: backup, restore, and checks.
//!
//! Works with or without a running server: it may read while a server runs, but changes a data folder only
//! while it holds the folder's lock.

mod backup;
mod bucket;
mod database;
mod doctor;
mod hashed_files;
mod manifest;
mod migrate;
mod move_database;
mod move_pictures;
mod restore;
mod store_check;

use std::io;
use std::path::{Path, PathBuf};

pub use backup::{Backup, back_up};
pub use doctor::{Depth, Finding, Repair, Severity, run_checks};
pub use migrate::{Migrated, migrate};
pub use move_database::{MovedDatabase, move_database};
pub use move_pictures::{MovedPictures, move_pictures};
pub use restore::{Restored, restore};

use crate::db::{DatabaseError, OpenError, PostgresAddress};
use crate::lock::LockError;
use crate::private_files::ExposedFile;

/// Error of a backup, a restore or a check, with its fix.
#[derive(Debug, thiserror::Error)]
pub enum DataFolderError {
    /// The folder has no database.
    #[error("there is no farm in {0}: pass a farm's data folder with --data")]
    NoDatabase(PathBuf),
    /// The folder's database is on a PostgreSQL server.
    #[error(
        "the database of the farm in {folder} is {address}: back it up with pg_dump, restore it with pg_restore, and \
         back the pictures up by copying {folder} or the bucket after it"
    )]
    InPostgres {
        /// The data folder.
        folder: PathBuf,
        /// Address of the database.
        address: PostgresAddress,
    },
    /// The farm's database already is where it would be moved to, or on another server of the same kind.
    #[error(
        "the farm's database is {0}, of the same kind: to move it to another PostgreSQL server use pg_dump and pg_restore, \
         and to another folder sdfarm backup and restore"
    )]
    SameEngine(String),
    /// The farm's pictures already are where they would be moved to.
    #[error("the farm's pictures are in {0} already")]
    SameStore(String),
    /// The database to move to has a farm.
    #[error("the database {0} already has a farm: make an empty one with createdb, or move that file away")]
    DatabaseNotEmpty(String),
    /// A database could not be moved.
    #[error("the farm was not moved, and is as before: the database {database} cannot be used")]
    Move {
        /// The database.
        database: String,
        /// Reason.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A database could not be migrated.
    #[error(
        "the database {database} was not migrated: stop a server that does not share it, correct its address, or run the \
         release that made it"
    )]
    Migrate {
        /// The database.
        database: String,
        /// Reason.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A folder or file could not be read or written.
    #[error("could not {action} {path}: free space on its disk, or correct its permissions")]
    File {
        /// Attempted action.
        action: &'static str,
        /// The folder or file.
        path: PathBuf,
        /// Error of the system.
        #[source]
        source: io::Error,
    },
    /// The database could not be read.
    #[error("could not read the database {file}: run `sdfarm doctor` to find out why")]
    Database {
        /// Its file.
        file: PathBuf,
        /// Error of the database.
        #[source]
        source: DatabaseError,
    },
    /// The database could not be changed.
    #[error("could not repair the database: restore it from a backup")]
    Repair(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// The target folder has other files.
    #[error("{0} has files that are not a backup: pass an empty folder, or one with an earlier backup")]
    NotABackup(PathBuf),
    /// The folder has no backup.
    #[error("there is no backup in {0}: pass a folder that `sdfarm backup` wrote")]
    NoBackup(PathBuf),
    /// The target folder has files, which would be overwritten.
    #[error("{0} is not empty: pass a new or empty folder with --data")]
    NotEmpty(PathBuf),
    /// The backup's folder is inside the data folder.
    #[error("{0} is inside the data folder: back up to another folder, best on another disk")]
    BackupInsideData(PathBuf),
    /// The backup's manifest cannot be read.
    #[error("cannot read the backup's manifest {path}: {reason}; use an earlier backup")]
    Manifest {
        /// Path of the manifest.
        path: PathBuf,
        /// Reason.
        reason: String,
    },
    /// The backup's database is not the one that was backed up.
    #[error("the backup's database {path} is damaged ({reason}): use an earlier backup")]
    Damaged {
        /// Its file.
        path: PathBuf,
        /// Reason.
        reason: String,
    },
    /// The bucket of the farm's pictures could not be used.
    #[error(transparent)]
    Store(Box<dyn std::error::Error + Send + Sync>),
    /// Others may read the folder's secrets.
    #[error(transparent)]
    Exposed(#[from] ExposedFile),
    /// A server uses the folder.
    #[error("a server (pid {holder}) uses {folder}: stop it first")]
    InUse {
        /// The data folder.
        folder: PathBuf,
        /// Process id of the server.
        holder: String,
    },
}

impl DataFolderError {
    fn file(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |source| Self::File { action, path, source }
    }

    fn database(file: &Path) -> impl Fn(DatabaseError) -> Self + use<> {
        let file = file.to_owned();
        move |source| Self::Database { file: file.clone(), source }
    }

    fn lock(folder: &Path) -> impl FnOnce(LockError) -> Self + use<> {
        let folder = folder.to_owned();
        move |error| match error {
            LockError::InUse(holder) => Self::InUse { folder, holder },
            LockError::Io(source) => Self::File { action: "lock", path: folder, source },
        }
    }
}

impl From<DatabaseError> for DataFolderError {
    fn from(error: DatabaseError) -> Self {
        Self::Repair(Box::new(error))
    }
}

impl From<OpenError> for DataFolderError {
    fn from(error: OpenError) -> Self {
        Self::Repair(Box::new(error))
    }
}

#[cfg(test)]
mod tests;
