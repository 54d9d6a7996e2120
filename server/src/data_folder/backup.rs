//! Backup of a running farm: the database as of one instant, then the pictures it names.
//!
//! Pictures never change, so only new ones are taken. Tile blobs are left out: what lacks them is rendered again.

use std::collections::HashSet;
use std::fs::{self, File};
use std::path::Path;

use sqlx::{AssertSqlSafe, Connection};

use super::database::Named;
use super::manifest::{self, Manifest};
use super::{KeepError, database, hashed_files};
use crate::clock::{Clock, rfc3339};

/// How many times the database is copied again, if pictures that it names were deleted in the meantime.
const ROUNDS: u32 = 4;
/// Larger files of a data folder are none of ours.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// Result of a backup.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Backup {
    /// Pictures in it.
    pub pictures: u64,
    /// Of those, copied by this backup.
    pub taken: u64,
    /// Bytes taken now.
    pub taken_bytes: u64,
    /// Pictures of earlier backups that no job has any more, which were dropped.
    pub dropped: u64,
    /// Pictures that the database names and the store has lost.
    pub missing: Vec<String>,
}

/// Copies the farm in `data` to `folder`, which is empty or holds an earlier backup.
pub async fn back_up(data: &Path, folder: &Path) -> Result<Backup, KeepError> {
    let mut live = database::open(data).await?;
    let earlier = prepare(data, folder)?;
    let part = folder.join("farm.sqlite.part");
    for round in 1.. {
        if part.exists() {
            fs::remove_file(&part).map_err(KeepError::file("remove", &part))?;
        }
        let into = sqlx::query("VACUUM INTO ?").bind(part.to_string_lossy().into_owned());
        into.execute(&mut live).await.map_err(KeepError::database(&crate::database::Store::file(data)))?;
        let names = names_of(&part).await?;
        let backup = take(data, folder, &names)?;
        if !backup.missing.is_empty() && round < ROUNDS && !still_named(&mut live, &backup.missing, data).await? {
            continue;
        }
        return finish(data, folder, earlier.as_ref(), &names, backup);
    }
    unreachable!("the rounds end")
}

fn prepare(data: &Path, folder: &Path) -> Result<Option<Manifest>, KeepError> {
    fs::create_dir_all(folder).map_err(KeepError::file("make", folder))?;
    let real = |path: &Path| fs::canonicalize(path).map_err(KeepError::file("find", path));
    if real(folder)?.starts_with(real(data)?) {
        return Err(KeepError::Inside(folder.to_owned()));
    }
    let earlier = Manifest::read(folder)?;
    let is_ours = |name: &str| name == "pictures" || name == "farm.sqlite.part" || name == manifest::BEGUN;
    let entries = fs::read_dir(folder).map_err(KeepError::file("read", folder))?;
    let is_other = entries.flatten().any(|entry| !is_ours(&entry.file_name().to_string_lossy()));
    // The marker file comes first, so that an interrupted backup is recognized as one.
    let begun = folder.join(manifest::BEGUN);
    if earlier.is_none() && is_other && !begun.exists() {
        return Err(KeepError::NotABackup(folder.to_owned()));
    }
    File::create(&begun).map_err(KeepError::file("write", &begun))?;
    let pictures = folder.join("pictures");
    fs::create_dir_all(&pictures).map_err(KeepError::file("make", &pictures))?;
    Ok(earlier)
}

async fn names_of(copy: &Path) -> Result<Vec<Named>, KeepError> {
    let mut connection = database::open_file(copy).await?;
    let faults = database::faults(&mut connection).await.map_err(KeepError::database(copy))?;
    if let Some(reason) = faults.into_iter().next() {
        return Err(KeepError::Damaged { path: copy.to_owned(), reason });
    }
    let names = database::pictures(&mut connection).await.map_err(KeepError::database(copy))?;
    connection.close().await.map_err(KeepError::database(copy))?;
    Ok(names)
}

/// Links or copies the pictures that are not there yet, each checked by its hash.
fn take(data: &Path, folder: &Path, names: &[Named]) -> Result<Backup, KeepError> {
    let mut backup = Backup { pictures: names.len() as u64, ..Backup::default() };
    for named in names {
        let (from, to) = (data.join("pictures").join(&named.hash), folder.join("pictures").join(&named.hash));
        if fs::metadata(&to).is_ok_and(|there| there.len() == named.size_bytes) {
            continue;
        }
        match hashed_files::link(&from, &to, &named.hash) {
            Ok(true) => {
                backup.taken += 1;
                backup.taken_bytes += named.size_bytes;
            }
            Ok(false) => backup.missing.push(named.hash.clone()),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => backup.missing.push(named.hash.clone()),
            Err(error) => return Err(KeepError::file("copy", &from)(error)),
        }
    }
    Ok(backup)
}

/// Whether the farm itself misses some of these pictures; else they were deleted with their jobs just now.
async fn still_named(
    live: &mut sqlx::sqlite::SqliteConnection,
    missing: &[String],
    data: &Path,
) -> Result<bool, KeepError> {
    let missing = serde_json::json!(missing).to_string();
    let query = "SELECT EXISTS (SELECT 1 FROM json_each(?1) WHERE EXISTS (
                     SELECT 1 FROM frame WHERE frame.picture IS NOT NULL AND frame.picture = value)
                 OR EXISTS (SELECT 1 FROM picture WHERE picture.hash = value))";
    let named = sqlx::query_scalar::<_, bool>(AssertSqlSafe(query)).bind(missing).fetch_one(live).await;
    named.map_err(KeepError::database(&crate::database::Store::file(data)))
}

/// Puts the copies in place, the list last of all, and drops what is in no list any more.
fn finish(
    data: &Path,
    folder: &Path,
    earlier: Option<&Manifest>,
    names: &[Named],
    mut backup: Backup,
) -> Result<Backup, KeepError> {
    let part = folder.join("farm.sqlite.part");
    let (database, _) = hashed_files::hash(&part).map_err(KeepError::file("read", &part))?;
    let manifest = Manifest {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        made_at: rfc3339(Clock::system().wall_ms()),
        database,
        pictures: names.len() as u64,
        files: copy_files(data, folder)?,
    };
    let file = manifest.database_file(folder);
    let placed = File::open(&part).and_then(|copy| copy.sync_all()).and_then(|()| fs::rename(&part, &file));
    placed.map_err(KeepError::file("write", &file))?;
    let pictures = folder.join("pictures");
    hashed_files::sync_folder(&pictures).map_err(KeepError::file("write", &pictures))?;
    manifest.write(folder)?;
    if let Some(old) = earlier.filter(|old| old.database != manifest.database) {
        let old = old.database_file(folder);
        fs::remove_file(&old).map_err(KeepError::file("remove", &old))?;
    }
    let kept: HashSet<&str> = names.iter().map(|named| named.hash.as_str()).collect();
    for entry in fs::read_dir(&pictures).map_err(KeepError::file("read", &pictures))?.flatten() {
        if !kept.contains(&*entry.file_name().to_string_lossy()) {
            fs::remove_file(entry.path()).map_err(KeepError::file("remove", &entry.path()))?;
            backup.dropped += 1;
        }
    }
    Ok(backup)
}

/// Copies the small files of a data folder: secrets, with their permissions.
fn copy_files(data: &Path, folder: &Path) -> Result<Vec<String>, KeepError> {
    let mut names = Vec::new();
    for entry in fs::read_dir(data).map_err(KeepError::file("read", data))?.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let is_small = entry.metadata().is_ok_and(|file| file.is_file() && file.len() <= MAX_FILE_BYTES);
        if !is_small || name == "lock" || name.starts_with("farm.sqlite") || name.starts_with("backup") {
            continue;
        }
        fs::copy(entry.path(), folder.join(&name)).map_err(KeepError::file("copy", &entry.path()))?;
        names.push(name);
    }
    names.sort();
    Ok(names)
}
