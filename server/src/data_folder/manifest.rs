//! Manifest of a backup: its contents. It is replaced atomically, and last, so that an interrupted backup
//! leaves the previous one intact.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{DataFolderError, hashed_files};

/// Name of the manifest.
const FILE: &str = "backup.json";
/// Name of the manifest while it is written.
pub(super) const PARTIAL_FILE: &str = "backup.json.part";

/// Contents of a backup.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Manifest {
    /// Release that wrote it.
    pub(super) version: String,
    /// Time of the backup: RFC 3339, UTC.
    pub(super) made_at: String,
    /// BLAKE3 of the database's copy, which is its file name.
    pub(super) database: String,
    /// Pictures in the database's copy.
    pub(super) pictures: u64,
    /// Other files of the data folder: secrets.
    pub(super) files: Vec<String>,
    /// Bucket in which the pictures are; `None` if they are in the backup.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) store: Option<String>,
}

impl Manifest {
    /// Reads a backup's manifest; `None` if there is none.
    pub(super) fn read(folder: &Path) -> Result<Option<Self>, DataFolderError> {
        let path = folder.join(FILE);
        let text = match fs::read(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(DataFolderError::file("read", &path)(error)),
        };
        let list: Self = serde_json::from_slice(&text)
            .map_err(|error| DataFolderError::Manifest { path: path.clone(), reason: error.to_string() })?;
        let is_hash = crate::blobs::ContentHash::parse(&list.database).is_some();
        let is_plain = list.files.iter().all(|name| Path::new(name).file_name().is_some_and(|file| file == &name[..]));
        if is_hash && is_plain {
            Ok(Some(list))
        } else {
            Err(DataFolderError::Manifest { path, reason: "it names a file that no backup has".to_owned() })
        }
    }

    /// Path of the database's copy.
    pub(super) fn database_file(&self, folder: &Path) -> PathBuf {
        folder.join(format!("farm-{}.sqlite", self.database))
    }

    /// Writes this manifest.
    pub(super) fn write(&self, folder: &Path) -> Result<(), DataFolderError> {
        let (path, part) = (folder.join(FILE), folder.join(PARTIAL_FILE));
        let text = serde_json::to_vec_pretty(self).expect("a list of text");
        let written = File::create(&part)
            .and_then(|mut file| file.write_all(&text).and_then(|()| file.sync_all()))
            .and_then(|()| fs::rename(&part, &path))
            .and_then(|()| hashed_files::sync_folder(folder));
        written.map_err(DataFolderError::file("write", &path))
    }
}
