//! Backup of a running farm: the database as of one instant, then the pictures it names.
//!
//! Pictures never change, so only new ones are copied. Tile blobs are left out: unfinished frames are rendered
//! again. Pictures in a bucket stay there: a backup lists them, and says which are missing.

use std::collections::HashSet;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::Path;

use super::database::PictureRef;
use super::manifest::{self, Manifest};
use super::{DataFolderError, bucket, database, hashed_files};
use crate::blobs::BlobStore;
use crate::clock::{Clock, rfc3339};
use crate::db::{self, Database};
use crate::private_files;

/// Maximum number of repeats if pictures in the database's copy were deleted in the meantime.
const MAX_ATTEMPTS: u32 = 4;
/// Files of a data folder larger than this are not copied, because sdfarm has no such files.
const MAX_FILE_BYTES: u64 = 1 << 20;
/// File with the hash and the size of each picture in the bucket, a line each.
const LIST_FILE: &str = "pictures.txt";

/// Result of a backup.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Backup {
    /// Number of pictures in the backup.
    pub pictures: u64,
    /// Number of pictures copied by this run.
    pub copied: u64,
    /// Bytes copied by this run.
    pub copied_bytes: u64,
    /// Number of pictures from earlier backups that were deleted because no job uses them any more.
    pub removed: u64,
    /// Pictures in the database that are missing from the store.
    pub missing: Vec<String>,
    /// Bucket in which the pictures stay; `None` if they are in the backup.
    pub store: Option<String>,
}

/// Copies the farm in `data` to `folder`, which is empty or holds an earlier backup.
pub async fn back_up(data: &Path, folder: &Path) -> Result<Backup, DataFolderError> {
    let mut live = database::open(data).await?;
    let bucket = bucket::open(data)?;
    let earlier = prepare(data, folder)?;
    let part = folder.join("farm.sqlite.part");
    for round in 1.. {
        // The copy is written to an empty file, so that it has that file's mode.
        private_files::create_file(&part).map_err(DataFolderError::file("write", &part))?;
        let into = db::query("VACUUM INTO ?").bind(part.to_string_lossy().into_owned());
        into.execute(&mut live).await.map_err(DataFolderError::database(&Database::file(data)))?;
        let names = picture_refs(&part).await?;
        let backup = match &bucket {
            None => copy_pictures(data, folder, &names)?,
            Some(bucket) => list_pictures(bucket, folder, &names).await?,
        };
        if !backup.missing.is_empty()
            && round < MAX_ATTEMPTS
            && !missing_in_farm(&mut live, &backup.missing, data).await?
        {
            continue;
        }
        return finish(data, folder, earlier.as_ref(), &names, backup);
    }
    unreachable!("the last round returns")
}

fn prepare(data: &Path, folder: &Path) -> Result<Option<Manifest>, DataFolderError> {
    private_files::create_folder(folder).map_err(DataFolderError::file("make", folder))?;
    let real = |path: &Path| fs::canonicalize(path).map_err(DataFolderError::file("find", path));
    if real(folder)?.starts_with(real(data)?) {
        return Err(DataFolderError::BackupInsideData(folder.to_owned()));
    }
    let earlier = Manifest::read(folder)?;
    let is_ours = |name: &str| name == "pictures" || name == "farm.sqlite.part" || name == manifest::PARTIAL_FILE;
    let entries = fs::read_dir(folder).map_err(DataFolderError::file("read", folder))?;
    let is_other = entries.flatten().any(|entry| !is_ours(&entry.file_name().to_string_lossy()));
    // The marker file comes first, so that an interrupted backup is recognized as one.
    let begun = folder.join(manifest::PARTIAL_FILE);
    if earlier.is_none() && is_other && !begun.exists() {
        return Err(DataFolderError::NotABackup(folder.to_owned()));
    }
    File::create(&begun).map_err(DataFolderError::file("write", &begun))?;
    let pictures = folder.join("pictures");
    private_files::create_folder(&pictures).map_err(DataFolderError::file("make", &pictures))?;
    private_files::restrict(folder)?;
    Ok(earlier)
}

async fn picture_refs(copy: &Path) -> Result<Vec<PictureRef>, DataFolderError> {
    let mut connection = database::open_file(copy).await?;
    let faults = connection.integrity_errors().await.map_err(DataFolderError::database(copy))?;
    if let Some(reason) = faults.into_iter().next() {
        return Err(DataFolderError::Damaged { path: copy.to_owned(), reason });
    }
    let names = database::pictures(&mut connection).await.map_err(DataFolderError::database(copy))?;
    connection.close().await.map_err(DataFolderError::database(copy))?;
    Ok(names)
}

/// Links or copies the missing pictures, each verified by its hash.
fn copy_pictures(data: &Path, folder: &Path, names: &[PictureRef]) -> Result<Backup, DataFolderError> {
    let mut backup = Backup { pictures: names.len() as u64, ..Backup::default() };
    for named in names {
        let (from, to) = (data.join("pictures").join(&named.hash), folder.join("pictures").join(&named.hash));
        if fs::metadata(&to).is_ok_and(|there| there.len() == named.size_bytes) {
            continue;
        }
        match hashed_files::link(&from, &to, &named.hash) {
            Ok(true) => {
                backup.copied += 1;
                backup.copied_bytes += named.size_bytes;
            }
            Ok(false) => backup.missing.push(named.hash.clone()),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => backup.missing.push(named.hash.clone()),
            Err(error) => return Err(DataFolderError::file("copy", &from)(error)),
        }
    }
    Ok(backup)
}

/// Writes the list of the pictures that the database names, and compares it with the bucket.
async fn list_pictures(bucket: &BlobStore, folder: &Path, names: &[PictureRef]) -> Result<Backup, DataFolderError> {
    let (pictures, missing) = bucket::find_pictures(bucket, names).await?;
    let file = folder.join(LIST_FILE);
    let listed = File::create(&file).and_then(|list| {
        let mut list = BufWriter::new(list);
        names.iter().try_for_each(|named| writeln!(list, "{} {}", named.hash, named.size_bytes))?;
        list.flush()
    });
    listed.map_err(DataFolderError::file("write", &file))?;
    Ok(Backup { pictures, missing, store: Some(bucket.location().to_string()), ..Backup::default() })
}

/// Whether the farm itself lacks some of these pictures; if not, they were deleted with their jobs in the
/// meantime.
async fn missing_in_farm(live: &mut db::Connection, missing: &[String], data: &Path) -> Result<bool, DataFolderError> {
    let missing = serde_json::json!(missing).to_string();
    let query = "SELECT EXISTS (SELECT 1 FROM @texts(?1) WHERE EXISTS (
                     SELECT 1 FROM frame WHERE frame.picture IS NOT NULL AND frame.picture = value)
                 OR EXISTS (SELECT 1 FROM picture WHERE picture.hash = value))";
    let named = db::query_scalar::<bool>(query).bind(missing).fetch_one(live).await;
    named.map_err(DataFolderError::database(&Database::file(data)))
}

/// Moves the copies to their final names, the manifest last, and deletes files that are in no manifest any
/// more.
fn finish(
    data: &Path,
    folder: &Path,
    earlier: Option<&Manifest>,
    names: &[PictureRef],
    mut backup: Backup,
) -> Result<Backup, DataFolderError> {
    let part = folder.join("farm.sqlite.part");
    let (database, _) = hashed_files::hash(&part).map_err(DataFolderError::file("read", &part))?;
    let manifest = Manifest {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        made_at: rfc3339(Clock::system().wall_ms()),
        database,
        pictures: names.len() as u64,
        files: copy_files(data, folder)?,
        store: backup.store.clone(),
    };
    let file = manifest.database_file(folder);
    let placed = File::open(&part).and_then(|copy| copy.sync_all()).and_then(|()| fs::rename(&part, &file));
    placed.map_err(DataFolderError::file("write", &file))?;
    let pictures = folder.join("pictures");
    hashed_files::sync_folder(&pictures).map_err(DataFolderError::file("write", &pictures))?;
    manifest.write(folder)?;
    if let Some(old) = earlier.filter(|old| old.database != manifest.database) {
        let old = old.database_file(folder);
        fs::remove_file(&old).map_err(DataFolderError::file("remove", &old))?;
    }
    let kept: HashSet<&str> = names.iter().map(|named| named.hash.as_str()).collect();
    for entry in fs::read_dir(&pictures).map_err(DataFolderError::file("read", &pictures))?.flatten() {
        if !kept.contains(&*entry.file_name().to_string_lossy()) {
            fs::remove_file(entry.path()).map_err(DataFolderError::file("remove", &entry.path()))?;
            backup.removed += 1;
        }
    }
    Ok(backup)
}

/// Copies the small files of a data folder: secrets, with their permissions.
fn copy_files(data: &Path, folder: &Path) -> Result<Vec<String>, DataFolderError> {
    let mut names = Vec::new();
    for entry in fs::read_dir(data).map_err(DataFolderError::file("read", data))?.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let is_small = entry.metadata().is_ok_and(|file| file.is_file() && file.len() <= MAX_FILE_BYTES);
        if !is_small
            || name == "lock"
            || name == "reserve"
            || name.starts_with("farm.sqlite")
            || name.starts_with("backup")
        {
            continue;
        }
        fs::copy(entry.path(), folder.join(&name)).map_err(DataFolderError::file("copy", &entry.path()))?;
        names.push(name);
    }
    names.sort();
    Ok(names)
}
