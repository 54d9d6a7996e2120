//! Maintenance of data folders: backup, restore, and checks.
//!
//! It works with or without a running server. It reads next to a running server; it changes a data folder
//! only while it holds the folder's lock.

mod backup;
mod database;
mod doctor;
mod hashed_files;
mod manifest;
mod restore;
mod store_check;

use std::io;
use std::path::{Path, PathBuf};

pub use backup::{Backup, back_up};
pub use doctor::{Depth, Finding, Repair, Severity, run_checks};
pub use restore::{Restored, restore};

use crate::database::{DatabaseError, OpenError};
use crate::lock::LockError;

/// Error of a backup, a restore or a check, with its fix.
#[derive(Debug, thiserror::Error)]
pub enum DataFolderError {
    /// No database is there.
    #[error("there is no farm in {0}: name a data folder with --data")]
    NoDatabase(PathBuf),
    /// A folder or file could not be read or written.
    #[error("could not {action} {path}: make room on its disk, or mend its permissions")]
    File {
        /// Attempted action.
        action: &'static str,
        /// The folder or file.
        path: PathBuf,
        /// Error of the system.
        #[source]
        source: io::Error,
    },
    /// The database did not answer.
    #[error("could not read the database {file}: `sdfarm doctor` says what is wrong with it")]
    Database {
        /// Its file.
        file: PathBuf,
        /// Error of the database.
        #[source]
        source: sqlx::Error,
    },
    /// The database could not be changed.
    #[error("could not put the database right: restore it from a backup")]
    Repair(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// The folder holds something else.
    #[error("{0} holds something that is no backup: name an empty folder, or that of an earlier backup")]
    NotABackup(PathBuf),
    /// There is nothing to restore.
    #[error("there is no backup in {0}: name a folder that `sdfarm backup` wrote")]
    NoBackup(PathBuf),
    /// The folder has files, which would be overwritten.
    #[error("{0} is not empty: a farm is restored to a new folder, so name another with --data")]
    NotEmpty(PathBuf),
    /// A backup inside of what it is of.
    #[error("{0} lies in the data folder: back up to another place, best on another disk")]
    BackupInsideData(PathBuf),
    /// The backup's list can't be read.
    #[error("the backup's list {path} can't be read: {reason}; use an earlier backup")]
    Manifest {
        /// The list.
        path: PathBuf,
        /// Reason.
        reason: String,
    },
    /// The backup's database is not what was backed up.
    #[error("the backup's database {path} is damaged ({reason}): use an earlier backup")]
    Damaged {
        /// Its file.
        path: PathBuf,
        /// Reason.
        reason: String,
    },
    /// A server uses the folder.
    #[error("a server (pid {holder}) uses {folder}: stop it first")]
    InUse {
        /// The data folder.
        folder: PathBuf,
        /// Its process.
        holder: String,
    },
}

impl DataFolderError {
    fn file(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |source| Self::File { action, path, source }
    }

    fn database(file: &Path) -> impl Fn(sqlx::Error) -> Self + use<> {
        let file = file.to_owned();
        move |source| Self::Database { file: file.clone(), source }
    }

    fn lock(folder: &Path) -> impl FnOnce(LockError) -> Self + use<> {
        let folder = folder.to_owned();
        move |error| match error {
            LockError::InUse(holder) => Self::InUse { folder, holder },
            LockError::Io(source) => Self::File { action: "take hold of", path: folder, source },
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
