//! File modes: only the server's own user may read a data folder, its database and its secrets.

use std::fs::{self, DirBuilder, File, OpenOptions, Permissions};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// File of the secret that signs links.
pub(crate) const LINK_SECRET_FILE: &str = "links.secret";
/// File of the secret that signs webhooks.
pub(crate) const WEBHOOK_SECRET_FILE: &str = "webhook-secret";
/// File of the space set aside for a full disk.
pub(crate) const RESERVE_FILE: &str = "reserve";
/// File with the name that tells this server from others of its database.
pub(crate) const SERVER_NAME_FILE: &str = "server-name";
/// Mode of files: their owner can read and write them.
pub(crate) const FILE_MODE: u32 = 0o600;
/// Mode of folders: their owner can use them.
const FOLDER_MODE: u32 = 0o700;
/// Mode bits of users other than the owner.
const OTHERS: u32 = 0o077;
/// Folders in a data folder.
const FOLDERS: [&str; 3] = ["pictures", "tiles", "previews"];

/// Error returned when others may read a file and that cannot be changed.
#[derive(Debug, thiserror::Error)]
#[error("other users may read {path} (mode {mode:o}), and that cannot be changed: {source}; run `chmod go= {path}`")]
pub struct ExposedFile {
    /// The file or folder.
    path: PathBuf,
    /// Its mode.
    mode: u32,
    /// Error of the system.
    source: io::Error,
}

/// Creates a folder for its owner only, with its parents, unless it exists.
pub(crate) fn create_folder(folder: &Path) -> io::Result<()> {
    DirBuilder::new().recursive(true).mode(FOLDER_MODE).create(folder)
}

/// Creates an empty file for its owner only, or empties it.
pub(crate) fn create_file(file: &Path) -> io::Result<File> {
    let file = OpenOptions::new().create(true).truncate(true).write(true).mode(FILE_MODE).open(file)?;
    file.set_permissions(Permissions::from_mode(FILE_MODE))?;
    Ok(file)
}

/// Creates an empty file for its owner only, unless it exists.
pub(crate) fn create_if_missing(file: &Path) -> io::Result<()> {
    OpenOptions::new().create(true).append(true).mode(FILE_MODE).open(file).map(drop)
}

/// Takes the rights of others from the files and folders of a data folder.
///
/// The folder itself is restricted if it has a farm or nothing else: another folder, such as a home, may be shared on
/// purpose. A folder of another user, such as a mounted volume, stays as it is, because the files in it are restricted.
pub(crate) fn restrict(data: &Path) -> Result<(), ExposedFile> {
    let entries: Vec<_> = fs::read_dir(data).into_iter().flatten().flatten().map(|entry| entry.file_name()).collect();
    let names: Vec<_> = entries.iter().filter_map(|name| name.to_str()).collect();
    for name in names.iter().filter(|name| is_private(name)) {
        restrict_one(&data.join(name), FILE_MODE)?;
    }
    for name in FOLDERS.iter().filter(|name| names.contains(name)) {
        restrict_one(&data.join(name), FOLDER_MODE)?;
    }
    let is_farm = names.iter().any(|name| name.starts_with("farm.sqlite"));
    let is_own = fs::metadata(data).is_ok_and(|folder| folder.uid() == rustix::process::geteuid().as_raw());
    if is_own && (is_farm || names.iter().all(|name| is_private(name))) {
        restrict_one(data, FOLDER_MODE)?;
    }
    Ok(())
}

/// Whether a data folder's file is one that others must not read.
fn is_private(name: &str) -> bool {
    name.starts_with("farm.sqlite")
        || name.starts_with("farm-")
        || ["lock", LINK_SECRET_FILE, WEBHOOK_SECRET_FILE, RESERVE_FILE, SERVER_NAME_FILE].contains(&name)
}

fn restrict_one(path: &Path, wanted: u32) -> Result<(), ExposedFile> {
    // Without metadata, the file was removed in the meantime, or is a broken link.
    let Ok(metadata) = fs::metadata(path) else { return Ok(()) };
    let mode = metadata.permissions().mode() & 0o7777;
    if mode & OTHERS == 0 {
        return Ok(());
    }
    tracing::warn!(path = %path.display(), mode = format!("{mode:o}"), "other users could read it; its mode is now {wanted:o}");
    fs::set_permissions(path, Permissions::from_mode(wanted)).map_err(|source| ExposedFile {
        path: path.to_owned(),
        mode,
        source,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mode(path: &Path) -> u32 {
        fs::metadata(path).expect("it is there").permissions().mode() & 0o777
    }

    fn write(path: &Path) {
        fs::write(path, "x").expect("writes");
        fs::set_permissions(path, Permissions::from_mode(0o644)).expect("its mode is changed");
    }

    #[test]
    fn the_files_of_a_farm_are_restricted_and_no_others() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let data = folder.path().join("data");
        create_folder(&data).expect("creates");
        assert_eq!(mode(&data), 0o700);
        fs::set_permissions(&data, Permissions::from_mode(0o755)).expect("its mode is changed");
        let private = ["farm.sqlite", "farm.sqlite-wal", "farm.sqlite-shm", "links.secret", "webhook-secret", "lock"];
        for name in private {
            write(&data.join(name));
        }
        write(&data.join("notes.txt"));
        fs::create_dir(data.join("pictures")).expect("creates");
        restrict(&data).expect("restricts");
        assert!(private.iter().all(|name| mode(&data.join(name)) == 0o600));
        assert_eq!((mode(&data), mode(&data.join("pictures"))), (0o700, 0o700));
        assert_eq!(mode(&data.join("notes.txt")), 0o644);
    }

    #[test]
    fn a_folder_with_other_files_and_no_farm_stays_as_it_is() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        fs::set_permissions(folder.path(), Permissions::from_mode(0o755)).expect("its mode is changed");
        write(&folder.path().join("notes.txt"));
        restrict(folder.path()).expect("restricts");
        assert_eq!(mode(folder.path()), 0o755);
    }
}
