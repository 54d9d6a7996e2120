//! Compares the content store with the database: missing and surplus files.

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::database::PictureRef;
use super::{DataFolderError, hashed_files};
use crate::blobs::{ContentHash, ContentKind};

/// Minimum age of an orphan: newer files may not have been reported yet to a running server.
const UNREPORTED_AGE: Duration = Duration::from_mins(10);

/// Content that no row refers to.
#[derive(Clone, Debug)]
pub(super) enum Orphan {
    /// File in a data folder.
    File(PathBuf),
    /// Object in a bucket.
    Object(ContentKind, ContentHash),
}

/// Result of the comparison.
#[derive(Clone, Debug, Default)]
pub(super) struct StoreComparison {
    /// Number of pictures in the database that are in the store.
    pub(super) intact: u64,
    /// Hashes of pictures in the database that are missing from the store.
    pub(super) missing: Vec<String>,
    /// Hashes of pictures with other bytes than their name says.
    pub(super) damaged: Vec<String>,
    /// Content that no row refers to.
    pub(super) orphans: Vec<Orphan>,
    /// Its total size, in bytes.
    pub(super) orphan_bytes: u64,
}

/// Compares the store of a data folder with its database; `deep` reads every byte.
pub(super) fn compare_store(
    data: &Path,
    pictures: &[PictureRef],
    blobs: &[String],
    deep: bool,
    serving: bool,
) -> Result<StoreComparison, DataFolderError> {
    let mut found = StoreComparison::default();
    for named in pictures {
        let path = data.join("pictures").join(&named.hash);
        match fs::metadata(&path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => found.missing.push(named.hash.clone()),
            Err(error) => return Err(DataFolderError::file("read", &path)(error)),
            Ok(metadata) => {
                let same = metadata.len() == named.size_bytes
                    && (!deep
                        || hashed_files::hash(&path).map_err(DataFolderError::file("read", &path))?.0 == named.hash);
                if same {
                    found.intact += 1;
                } else {
                    found.damaged.push(named.hash.clone());
                }
            }
        }
    }
    let pictures: HashSet<&str> = pictures.iter().map(|named| named.hash.as_str()).collect();
    let blobs: HashSet<&str> = blobs.iter().map(String::as_str).collect();
    find_orphans(&data.join("pictures"), &pictures, serving, &mut found)?;
    find_orphans(&data.join("tiles"), &blobs, serving, &mut found)?;
    Ok(found)
}

fn find_orphans(
    folder: &Path,
    named: &HashSet<&str>,
    serving: bool,
    found: &mut StoreComparison,
) -> Result<(), DataFolderError> {
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(DataFolderError::file("read", folder)(error)),
    };
    for entry in entries.flatten() {
        let Ok(metadata) = entry.metadata() else { continue };
        let age = metadata.modified().ok().and_then(|then| then.elapsed().ok()).unwrap_or_default();
        let is_young = serving && age < UNREPORTED_AGE;
        if metadata.is_file() && !named.contains(&*entry.file_name().to_string_lossy()) && !is_young {
            found.orphan_bytes += metadata.len();
            found.orphans.push(Orphan::File(entry.path()));
        }
    }
    Ok(())
}
