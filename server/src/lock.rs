//! One server per data folder: an advisory lock on the folder itself, held while the server runs and released by the
//! system when it exits.
//!
//! The lock is the open folder, not a name in it: removing the file `lock`, which has the holder's process id, lets no
//! second server in.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Seek, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use crate::private_files::FILE_MODE;

/// Lock on a data folder; dropping it releases the lock.
#[derive(Debug)]
pub(crate) struct FolderLock {
    _folder: Option<File>,
    // Releases before this one lock only the file.
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
        let open_folder = lock_folder(folder, &path)?;
        let mut file =
            OpenOptions::new().create(true).truncate(false).read(true).write(true).mode(FILE_MODE).open(&path)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(LockError::InUse(holder(&path))),
            Err(TryLockError::Error(error)) => return Err(error.into()),
        }
        file.set_len(0)?;
        file.rewind()?;
        writeln!(file, "{}", std::process::id())?;
        Ok(Self { _folder: open_folder, _file: file })
    }
}

/// Locks the open folder; `None` if its file system locks files only, as some network file systems do.
fn lock_folder(folder: &Path, path: &Path) -> Result<Option<File>, LockError> {
    let open = File::open(folder)?;
    match open.try_lock() {
        Ok(()) => Ok(Some(open)),
        Err(TryLockError::WouldBlock) => Err(LockError::InUse(holder(path))),
        Err(TryLockError::Error(error)) => {
            tracing::warn!(%error, folder = %folder.display(), "cannot lock the folder itself: do not remove its file `lock`");
            Ok(None)
        }
    }
}

/// Process id in the lock's file.
fn holder(path: &Path) -> String {
    match std::fs::read_to_string(path) {
        Ok(process) if !process.trim().is_empty() => process.trim().to_owned(),
        Ok(_) | Err(_) => "unknown".to_owned(),
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

    #[test]
    fn removing_the_file_does_not_release_the_lock() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let held = FolderLock::acquire(folder.path()).expect("the first lock succeeds");
        std::fs::remove_file(folder.path().join("lock")).expect("removes");
        let refused = FolderLock::acquire(folder.path()).expect_err("the second lock fails").to_string();
        assert!(refused.contains("unknown"), "{refused}");
        // A renamed folder is still the same one.
        let renamed = folder.path().join("renamed");
        std::fs::create_dir(&renamed).expect("creates");
        let inner = FolderLock::acquire(&renamed).expect("another folder");
        let elsewhere = folder.path().join("elsewhere");
        std::fs::rename(&renamed, &elsewhere).expect("renames");
        std::fs::remove_file(elsewhere.join("lock")).expect("removes");
        assert!(FolderLock::acquire(&elsewhere).is_err());
        drop((held, inner));
        FolderLock::acquire(&elsewhere).expect("free again");
    }
}
