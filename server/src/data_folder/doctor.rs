//! Checks a farm: its database, its store, its disk, the machine's clock and limits.
//!
//! Every finding that is not ok has a fix. Only a repair changes anything, and only while no server runs.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use db::Connection;

use super::store_check::{self, Orphan, StoreComparison};
use super::{DataFolderError, bucket, database};
use crate::blobs::{BlobStore, ContentHash, ContentKind};
use crate::clock::Clock;
use crate::db::{self, Database, Durability};
use crate::host::{self, DISK_CURE, Room};
use crate::lock::{FolderLock, LockError};
use crate::queue::{Reopened, absurd_shares, forget_pictures, reset_shares};

/// Number of open files that a busy server needs.
const MIN_OPEN_FILES: u64 = 4096;
/// WAL size above which the WAL is not being checkpointed.
const LARGE_WAL_BYTES: u64 = 1 << 30;
/// Maximum difference between clocks.
const SKEW_MS: i64 = 60_000;
/// Earliest time that a correct clock shows: January 1, 2026.
const MIN_PLAUSIBLE_MS: i64 = 1_767_225_600_000;

/// Severity of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// No problem.
    Ok,
    /// Works, but needs attention.
    Warning,
    /// Does not work, or will stop working soon.
    Error,
}

/// Finding of a check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Severity.
    pub severity: Severity,
    /// Subject of the check: one word.
    pub subject: &'static str,
    /// Message.
    pub message: String,
    /// Fix; `None` if the finding is ok.
    pub cure: Option<String>,
}

impl Finding {
    /// Ok: no problem.
    pub fn ok(subject: &'static str, text: impl Into<String>) -> Self {
        Self { severity: Severity::Ok, subject, message: text.into(), cure: None }
    }

    /// Warning: works, but needs attention.
    pub fn warning(subject: &'static str, text: impl Into<String>, cure: impl Into<String>) -> Self {
        Self { severity: Severity::Warning, subject, message: text.into(), cure: Some(cure.into()) }
    }

    /// Error: does not work.
    pub fn error(subject: &'static str, text: impl Into<String>, cure: impl Into<String>) -> Self {
        Self { severity: Severity::Error, subject, message: text.into(), cure: Some(cure.into()) }
    }
}

/// How thoroughly the store is checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Depth {
    /// Checks names and sizes.
    Names,
    /// Checks every byte.
    Bytes,
}

/// Whether problems are repaired.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Repair {
    /// Changes nothing.
    None,
    /// Deletes orphans; frames whose pictures are missing are rendered again; shares that cannot be right start
    /// again.
    Store,
}

const RESTORE_FIX: &str = "stop the server and restore a backup to a new folder (`sdfarm restore`)";
const REPAIR_FIX: &str = "stop the server and run `sdfarm doctor --repair`";

/// Checks a farm, and repairs it if asked.
pub async fn run_checks(data: &Path, depth: Depth, repair: Repair) -> Result<Vec<Finding>, DataFolderError> {
    let mut findings = Vec::new();
    let mut connection = database::open(data).await?;
    let (lock, serving) = match FolderLock::acquire(data) {
        Ok(lock) => (Some(lock), None),
        Err(LockError::InUse(holder)) => (None, Some(holder)),
        Err(LockError::Io(error)) => {
            let cure = "correct its permissions, or run this command as the server's user";
            findings.push(Finding::error("folder", format!("cannot write to {}: {error}", data.display()), cure));
            (None, None)
        }
    };
    if let (Repair::Store, Some(holder)) = (repair, &serving) {
        return Err(DataFolderError::InUse { folder: data.to_owned(), holder: holder.clone() });
    }
    findings.push(match &serving {
        Some(holder) => Finding::ok("server", format!("a server (pid {holder}) uses {}", data.display())),
        None => Finding::ok("server", format!("no server uses {}", data.display())),
    });
    let is_sound = check_database(data, &mut connection, &mut findings).await;
    if is_sound {
        check_clock(&mut connection, data, &mut findings).await?;
        findings.push(check_books(data, &mut connection, repair == Repair::Store && lock.is_some()).await?);
        let repairs = repair == Repair::Store && lock.is_some();
        findings.extend(check_store(data, &mut connection, depth, serving.is_some(), repairs).await?);
    }
    check_host(data, &mut findings);
    drop(lock);
    Ok(findings)
}

async fn check_database(data: &Path, connection: &mut Connection, findings: &mut Vec<Finding>) -> bool {
    let file = Database::file(data);
    match connection.integrity_errors().await {
        Ok(faults) if faults.is_empty() => {
            let text = format!("{} is intact: {} bytes", file.display(), host::file_bytes(&file));
            findings.push(Finding::ok("database", text));
        }
        Ok(faults) => {
            findings.push(Finding::error("database", format!("it is damaged: {}", faults.join("; ")), RESTORE_FIX));
            return false;
        }
        Err(error) => {
            findings.push(Finding::error("database", format!("it cannot be read: {error}"), RESTORE_FIX));
            return false;
        }
    }
    let log_bytes = host::file_bytes(&file.with_extension("sqlite-wal"));
    if log_bytes > LARGE_WAL_BYTES {
        let cure = "restart the server; if that does not help, find other programs that keep the database open";
        findings.push(Finding::warning("database", format!("its WAL has {log_bytes} bytes"), cure));
    }
    match database::migrations(connection).await {
        Ok(odd) if odd.is_empty() => {
            findings.push(Finding::ok("schema", "its tables match this release"));
            true
        }
        Ok(odd) => {
            for (text, is_mended_at_start) in &odd {
                findings.push(if *is_mended_at_start {
                    Finding::warning("schema", text, "back up, then start this release: it migrates the tables")
                } else {
                    Finding::error("schema", text, "run the release that created the tables, or a newer one")
                });
            }
            false
        }
        Err(error) => {
            findings.push(Finding::error("schema", format!("this is not a farm's database: {error}"), RESTORE_FIX));
            false
        }
    }
}

async fn check_clock(
    connection: &mut Connection,
    data: &Path,
    findings: &mut Vec<Finding>,
) -> Result<(), DataFolderError> {
    let newest_ms = database::newest_ms(connection).await.map_err(DataFolderError::database(&Database::file(data)))?;
    let now_ms = Clock::system().wall_ms();
    let ahead_ms = newest_ms.map_or(0, |newest_ms| newest_ms - now_ms);
    findings.push(if now_ms < MIN_PLAUSIBLE_MS || ahead_ms > SKEW_MS {
        let text =
            format!("the clock is behind: the newest job was submitted {} s in the future", ahead_ms.max(0) / 1000);
        Finding::warning(
            "clock",
            text,
            "synchronize the clock with NTP (`timedatectl set-ntp true`); leases do not depend on it",
        )
    } else {
        Finding::ok("clock", "it is consistent with the newest job")
    });
    Ok(())
}

/// Checks the shares by which the next submitter is chosen, and mends them if asked. Numbers out of their range are
/// found with the database's integrity.
async fn check_books(data: &Path, connection: &mut Connection, mends: bool) -> Result<Finding, DataFolderError> {
    let absurd = absurd_shares(connection).await.map_err(DataFolderError::database(&Database::file(data)))?;
    if absurd == 0 {
        return Ok(Finding::ok("books", "the submitters' shares are plausible"));
    }
    let text = format!("{absurd} submitters' shares cannot be right: their jobs would never be rendered");
    if !mends {
        return Ok(Finding::error("books", text, format!("{REPAIR_FIX}: all shares start again from zero")));
    }
    let store = Database::open_file(data).await?;
    let mended =
        store.write(Durability::Full, |connection| Box::pin(async move { reset_shares(connection).await })).await;
    store.close().await;
    mended?;
    Ok(Finding::ok("books", format!("{text}: repaired, all shares start again from zero")))
}

async fn check_store(
    data: &Path,
    connection: &mut Connection,
    depth: Depth,
    serving: bool,
    repairs: bool,
) -> Result<Vec<Finding>, DataFolderError> {
    let failed = DataFolderError::database(&Database::file(data));
    let pictures = database::pictures(&mut *connection).await.map_err(&failed)?;
    let blobs = database::blobs(&mut *connection).await.map_err(&failed)?;
    let bucket = bucket::open(data)?;
    let is_deep = depth == Depth::Bytes;
    let mut findings = Vec::new();
    let found = match &bucket {
        None => store_check::compare_store(data, &pictures, &blobs, is_deep, serving)?,
        Some(bucket) => {
            if let Err(error) = bucket.check().await {
                return Ok(vec![Finding::error("store", error.problem(), error.cure())]);
            }
            let farm = database::farm_id(connection).await.map_err(&failed)?;
            if let Some(farm) = farm
                && let Err(error) = bucket.check_owner(farm).await
            {
                let cure = "correct the file `store` of the data folder";
                return Ok(vec![Finding::error("store", error.to_string(), cure)]);
            }
            findings.push(Finding::ok("store", format!("{} can be read and written", bucket.location())));
            bucket::compare(bucket, &pictures, &blobs, is_deep).await?
        }
    };
    let repaired = if repairs { Some(repair_store(data, bucket.as_ref(), &found).await?) } else { None };
    findings.extend(store_findings(&found, repaired));
    Ok(findings)
}

/// Deletes orphans and damaged pictures, and requeues the frames of missing pictures.
async fn repair_store(
    data: &Path,
    bucket: Option<&BlobStore>,
    found: &StoreComparison,
) -> Result<Reopened, DataFolderError> {
    for orphan in &found.orphans {
        match (orphan, bucket) {
            (Orphan::Object(kind, name), Some(bucket)) => delete(bucket, *kind, name).await?,
            (Orphan::Object(..), None) => unreachable!("objects are found in a bucket"),
            (Orphan::File(path), _) => fs::remove_file(path).map_err(DataFolderError::file("remove", path))?,
        }
    }
    let lost: Vec<String> = found.missing.iter().chain(&found.damaged).cloned().collect();
    if lost.is_empty() {
        return Ok(Reopened::default());
    }
    let store = Arc::new(Database::open_file(data).await?);
    let hashes = lost.clone();
    let reopened = store
        .write(Durability::Full, move |connection| Box::pin(async move { forget_pictures(connection, &hashes).await }))
        .await;
    store.close().await;
    // The rows first: a picture without a row is only an orphan.
    let reopened = reopened?;
    for hash in &found.damaged {
        match (bucket, ContentHash::parse(hash)) {
            (Some(bucket), Some(name)) => delete(bucket, ContentKind::Picture, &name).await?,
            (Some(_), None) => {}
            (None, _) => {
                let path = data.join("pictures").join(hash);
                fs::remove_file(&path).map_err(DataFolderError::file("remove", &path))?;
            }
        }
    }
    Ok(reopened)
}

async fn delete(bucket: &BlobStore, kind: ContentKind, name: &ContentHash) -> Result<(), DataFolderError> {
    let deleted = bucket.delete(kind, name).await;
    deleted.map(drop).map_err(|error| DataFolderError::Store(error.into()))
}

fn store_findings(found: &StoreComparison, repaired: Option<Reopened>) -> Vec<Finding> {
    let mut findings = vec![Finding::ok("store", format!("{} pictures are intact", found.intact))];
    for (what, hashes) in [("are missing", &found.missing), ("are damaged", &found.damaged)] {
        let Some(first) = hashes.first() else { continue };
        let text = format!("{} pictures {what}, {first} first", hashes.len());
        findings.push(match repaired {
            None => Finding::error("store", text, format!("{REPAIR_FIX}: their frames are rendered again")),
            Some(Reopened { frames, void }) => Finding::ok(
                "store",
                format!("{text}: repaired, {frames} frames will be rendered again, {void} frames of cancelled or failed jobs stay without a picture"),
            ),
        });
    }
    if !found.orphans.is_empty() {
        let text = format!("{} files ({} bytes) are orphans", found.orphans.len(), found.orphan_bytes);
        findings.push(match repaired {
            None => {
                Finding::warning("store", text, format!("a running server deletes them automatically; or {REPAIR_FIX}"))
            }
            Some(_) => Finding::ok("store", format!("{text}: removed")),
        });
    }
    findings
}

fn check_host(data: &Path, findings: &mut Vec<Finding>) {
    let disk = host::disk(data);
    let text = format!("{} MiB of {} MiB are free", disk.free_bytes >> 20, disk.total_bytes >> 20);
    findings.push(match disk.room() {
        Room::None => Finding::error("disk", text, DISK_CURE),
        Room::Low => Finding::warning("disk", text, DISK_CURE),
        Room::Enough => Finding::ok("disk", text),
    });
    let files = host::process().max_files;
    findings.push(if files < MIN_OPEN_FILES {
        let cure = "raise it: `ulimit -n 65536`, or LimitNOFILE=65536 in the unit";
        Finding::warning("limits", format!("a process may open {files} files"), cure)
    } else {
        Finding::ok("limits", format!("a process may open {files} files"))
    });
}
