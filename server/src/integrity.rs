//! Checks the invariants of a data folder, with or without a running server: everything that must hold after
//! any crash.
//!
//! It only reads; a soak runs it after each kill.

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::Path;

use proto::JobId;

use crate::blobs::StoreLocation;
use crate::db::{self, Connection, DatabaseError, DatabaseLocation};

/// Error that prevents the check.
#[derive(Debug, thiserror::Error)]
pub enum IntegrityError {
    /// The database cannot be read.
    #[error("could not check the database")]
    Database(#[from] DatabaseError),
    /// The data folder cannot be read.
    #[error("could not read the data folder")]
    Folder(#[from] io::Error),
}

/// Finished tile, as read by the check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DoneTile {
    /// Number of leases it ever had.
    pub leases: i64,
}

/// Result of an integrity check.
#[derive(Clone, Debug, Default)]
pub struct IntegrityReport {
    /// Violations, one sentence each; empty in an intact farm.
    pub violations: Vec<String>,
    /// Every finished tile, by its row id.
    pub done: BTreeMap<i64, DoneTile>,
    /// Ids of all jobs.
    pub jobs: BTreeSet<JobId>,
}

/// Each statement counts or names the violations of one invariant, and is run unchanged.
const INVARIANTS: [(&str, &str); 7] = [
    (
        "a tile has two results with effect",
        "SELECT tile FROM lease WHERE ended = 'done' GROUP BY tile HAVING count(*) > 1",
    ),
    (
        "a job's counter of finished tiles is wrong",
        "SELECT number FROM job WHERE cleanup IS DISTINCT FROM 'delete' AND tiles_done <>
         (SELECT coalesce(sum(tiles_done), 0) FROM frame WHERE frame.job = job.number)",
    ),
    (
        "a frame's counter of finished tiles is wrong",
        "SELECT frame.job FROM frame WHERE state IN ('open', 'stitching')
         AND (SELECT cleanup FROM job WHERE job.number = frame.job) IS DISTINCT FROM 'delete' AND tiles_done <>
         (SELECT count(*) FROM tile WHERE tile.job = frame.job AND tile.frame = frame.number
          AND kind = 'render' AND tile.state = 'done')",
    ),
    (
        "a job's counter of stored frames is wrong",
        "SELECT job.number FROM job WHERE cleanup IS DISTINCT FROM 'delete' AND frames_stored <>
         (SELECT count(*) FROM frame WHERE frame.job = job.number AND frame.state = 'stored')",
    ),
    (
        "a tile is leased without a lease",
        "SELECT id FROM tile WHERE state = 'leased'
         AND NOT EXISTS (SELECT 1 FROM lease WHERE lease.tile = tile.id AND ended IS NULL)",
    ),
    (
        "a lease is live on a tile that is not leased",
        "SELECT lease.id FROM lease JOIN tile ON tile.id = lease.tile WHERE ended IS NULL AND state <> 'leased'",
    ),
    (
        "a job does not have exactly one success event",
        // A job whose picture was lost or forgotten runs again, and succeeds once more.
        "SELECT number FROM job WHERE state = 'succeeded' AND cleanup IS DISTINCT FROM 'delete' AND
         (SELECT count(*) FROM outbox WHERE outbox.job = job.number AND outbox.state = 'succeeded') <> 1 +
         (SELECT count(*) FROM outbox WHERE outbox.job = job.number AND outbox.state = 'running' AND outbox.number >
          (SELECT min(number) FROM outbox AS first WHERE first.job = job.number AND first.state = 'succeeded'))",
    ),
];

/// Checks the database and the pictures of a data folder.
pub async fn check_integrity(data: &Path) -> Result<IntegrityReport, IntegrityError> {
    // One transaction for all statements, so that all read the same state of a running server.
    let mut connection = Connection::reading(&DatabaseLocation::of_folder(data)?).await?;
    let violations = connection.integrity_errors().await?;
    let mut audit = IntegrityReport { violations, ..IntegrityReport::default() };
    for (breach, statement) in INVARIANTS {
        let broken = db::query(statement).fetch_all(&mut connection).await?.len();
        if broken > 0 {
            audit.violations.push(format!("{breach} ({broken})"));
        }
    }
    // A job that is being deleted has no id any more, and only some of its rows.
    let ids = db::query_scalar::<String>("SELECT id FROM job WHERE cleanup IS DISTINCT FROM 'delete'");
    for id in ids.fetch_all(&mut connection).await? {
        match id.parse() {
            Ok(id) => drop(audit.jobs.insert(id)),
            Err(_) => audit.violations.push(format!("{id:?} is not a job id")),
        }
    }
    let done = db::query("SELECT id, epoch FROM tile WHERE state = 'done'").fetch_all(&mut connection).await?;
    for row in done {
        audit.done.insert(row.get("id")?, DoneTile { leases: row.get("epoch")? });
    }
    // Names in a bucket are the hash of the bytes.
    if StoreLocation::recorded(data)? == StoreLocation::Folder {
        check_pictures(&mut connection, data, &mut audit).await?;
    }
    connection.close().await?;
    Ok(audit)
}

/// Checks that pictures are intact: a picture's row is written after its file was fsynced.
async fn check_pictures(
    connection: &mut Connection,
    data: &Path,
    audit: &mut IntegrityReport,
) -> Result<(), IntegrityError> {
    let pictures = db::query_scalar::<String>("SELECT DISTINCT picture FROM frame WHERE picture IS NOT NULL");
    for hash in pictures.fetch_all(connection).await? {
        match std::fs::read(data.join("pictures").join(&hash)) {
            Ok(bytes) if blake3::hash(&bytes).to_hex().as_str() == hash => {}
            Ok(_) => audit.violations.push(format!("picture {hash} does not match the hash in its name")),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                audit.violations.push(format!("picture {hash} is used, but missing"));
            }
            Err(error) => audit.violations.push(format!("picture {hash} cannot be read: {error}")),
        }
    }
    Ok(())
}
