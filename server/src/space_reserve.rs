//! Space on the data folder's disk that is set aside in a file, so that a full disk never keeps jobs from being
//! cancelled and deleted, nor the server from starting.
//!
//! The file is deleted when the disk is full and room must be made. Until there is room for it again, nothing is
//! accepted and no work is granted, so that only deletions use the space.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use rustix::fs::FallocateFlags;

use crate::db::DatabaseError;
use crate::host::disk;
use crate::private_files::{self, RESERVE_FILE};

/// Size of the file.
const MAX_BYTES: u64 = 16 << 20;
/// On a small disk the file takes at most this part of it.
const DISK_PART: u64 = 8;

/// Space set aside on the data folder's disk.
#[derive(Debug)]
pub(crate) struct SpaceReserve {
    file: PathBuf,
    is_released: AtomicBool,
}

impl SpaceReserve {
    /// Sets space aside, or releases what was set aside if the disk is full: then the server needs it to start.
    pub(crate) fn open(data: &Path) -> Self {
        let reserve = Self { file: data.join(RESERVE_FILE), is_released: AtomicBool::new(true) };
        let disk = disk(data);
        if reserve.file.exists() && disk.free_bytes >= size_bytes(disk.total_bytes) {
            reserve.is_released.store(false, Ordering::Relaxed);
        } else {
            drop(fs::remove_file(&reserve.file));
            reserve.restore();
        }
        reserve
    }

    /// Whether the space was released, because the disk is full.
    pub(crate) fn is_released(&self) -> bool {
        self.is_released.load(Ordering::Relaxed)
    }

    /// Releases the space, unless it was released before.
    pub(crate) fn release(&self) {
        if self.is_released.swap(true, Ordering::Relaxed) {
            return;
        }
        tracing::error!(
            code = "disk_full",
            "the disk is full: its reserve is released so that jobs can be cancelled and deleted; nothing is \
             rendered until there is room again"
        );
        if let Err(error) = fs::remove_file(&self.file) {
            tracing::error!(%error, "could not release the reserve");
        }
    }

    /// Whether an operation that makes room should run again: the disk was too full even for that, but the database's
    /// WAL is shorter now, and the space is released.
    pub(crate) fn has_made_room(&self, error: &DatabaseError) -> bool {
        if error.is_full() {
            self.release();
        }
        error.is_full()
    }

    /// Sets the space aside again if there is room for it and as much again. Returns whether it was and is no longer
    /// released.
    pub(crate) fn restore(&self) -> bool {
        let disk = disk(self.file.parent().unwrap_or(Path::new(".")));
        let size_bytes = size_bytes(disk.total_bytes);
        if !self.is_released() || disk.free_bytes < 2 * size_bytes {
            return false;
        }
        match allocate(&self.file, size_bytes) {
            Ok(()) => self.is_released.store(false, Ordering::Relaxed),
            Err(error) => {
                tracing::warn!(%error, "could not set space aside for a full disk");
                drop(fs::remove_file(&self.file));
                return false;
            }
        }
        true
    }
}

fn size_bytes(disk_bytes: u64) -> u64 {
    MAX_BYTES.min(disk_bytes / DISK_PART)
}

/// Creates a file whose blocks are allocated.
fn allocate(path: &Path, size_bytes: u64) -> io::Result<()> {
    let mut file = private_files::create_file(path)?;
    match rustix::fs::fallocate(&file, FallocateFlags::empty(), 0, size_bytes) {
        Ok(()) => Ok(()),
        Err(rustix::io::Errno::OPNOTSUPP) => {
            io::copy(&mut io::Read::take(io::repeat(0), size_bytes), &mut file)?;
            file.sync_all()
        }
        Err(error) => Err(error.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn space_is_set_aside_and_released_once() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let reserve = SpaceReserve::open(folder.path());
        let file = folder.path().join(RESERVE_FILE);
        assert!(file.metadata().expect("set aside").len() > 0 && !reserve.is_released());
        for _ in 0..2 {
            reserve.release();
            assert!(reserve.is_released() && !file.exists());
        }
        assert!(reserve.restore() && file.exists() && !reserve.is_released());
        assert!(!reserve.restore());
        drop(reserve);
        assert!(!SpaceReserve::open(folder.path()).is_released(), "it is there already");
    }
}
