//! One server per data folder: an advisory lock on a file in it, held while the server runs and released by the
//! system when it exits.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::path::Path;

/// Lock on a data folder; dropping it releases the lock.
#[derive(Debug)]
pub(crate) struct FolderLock {
    _file: File,
}

/// Error when acquiring the lock.
#[derive(Debug, thiserror::Error)]
pub(crate) enum LockError {
    /// Another server has the lock.
    #[error("another server has locked it (pid {0})")]
    InUse(String),
    /// The file could not be opened, read or written.
    #[error(transparent)]
    Io(#[from] io::Error),
}

impl FolderLock {
    /// Locks `folder` and writes this process's id to its `lock` file.
    pub(crate) fn acquire(folder: &Path) -> Result<Self, LockError> {
        let path = folder.join("lock");
        let mut file = OpenOptions::new().create(true).truncate(false).read(true).write(true).open(path)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let mut holder = String::new();
                file.read_to_string(&mut holder)?;
                return Err(LockError::InUse(holder.trim().to_owned()));
            }
            Err(TryLockError::Error(error)) => return Err(error.into()),
        }
        file.set_len(0)?;
        file.rewind()?;
        writeln!(file, "{}", std::process::id())?;
        Ok(Self { _file: file })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_lock_fails_with_the_holders_process_id() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let held = FolderLock::acquire(folder.path()).expect("the first lock succeeds");
        let refused = FolderLock::acquire(folder.path()).expect_err("the second lock fails").to_string();
        assert!(refused.contains(&std::process::id().to_string()), "{refused}");
        drop(held);
        FolderLock::acquire(folder.path()).expect("free again");
    }
}
