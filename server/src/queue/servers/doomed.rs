//! Deletion of stored content by servers that share a database and a bucket: none deletes what another reports.
//!
//! A sweep **marks** names that no row refers to. After a grace, if still no row refers to them, a server **takes** them
//! (`deleting`), deletes their bytes, and records that (`deleted`); the record is kept until no report can depend on bytes
//! that were seen before. Each step is a transaction under the farm's lock. A server that reports a result reads what is
//! known of its name before it looks for its bytes, and again in the transaction that counts the result:
//!
//! - a marked name is saved: its mark is removed;
//! - one that is being deleted does not count: its bytes are rendered again;
//! - one that was deleted counts if its bytes were looked for after that, and were there: they were stored again;
//! - any other name was not deleted since its bytes were seen, because a record would tell.
//!
//! A cached picture that a new job shows needs no such care: its row in `picture` refers to it, so that it is not marked.

use std::collections::{HashMap, HashSet};
use std::time::Duration;

use proto::worker_protocol::LeaseOutcome;
use tokio::time::Instant;

use crate::blobs::{BlobStore, ContentError, ContentHash, ContentKind};
use crate::clock::monotonic_now;
use crate::db;
use crate::db::{Durability, Row, Target};
use crate::delivery_check::FileEnds;
use crate::queue::tiles::reported::RejectedResult;
use crate::queue::{Connection, Queue, Result, SyncInput, json_list, parse_column};

/// Time for which a server relies on having seen the bytes of a result.
const MAX_CHECK_AGE: Duration = Duration::from_mins(5);
/// Time after which another server goes on with what one is deleting; deleting takes a minute at most.
const ABANDONED_MS: i64 = 15 * 60_000;
/// Time for which deletions are recorded, unless the grace is longer: more than that in which a server relies on bytes
/// that it stored itself, and [`MAX_CHECK_AGE`].
const MIN_RECORD_MS: i64 = 15 * 60_000;

/// State of a doomed name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Doom {
    Marked,
    Deleting,
    /// Since this time.
    Deleted(i64),
}

/// Kind and name of content.
type Named = (ContentKind, String);

/// Known states of the names of results before their bytes were looked for.
#[derive(Clone, Debug)]
pub(crate) struct CheckedNames {
    doomed: HashMap<Named, Doom>,
    at: Instant,
}

impl CheckedNames {
    /// Size and ends of a result's bytes; `None` if they are missing, or being deleted.
    pub(crate) async fn find(
        &self,
        content: &BlobStore,
        kind: ContentKind,
        name: &ContentHash,
    ) -> std::result::Result<Option<FileEnds>, ContentError> {
        match self.doomed.get(&(kind, name.as_str().to_owned())) {
            Some(Doom::Deleting) => Ok(None),
            // Only the store knows whether they are there again.
            Some(Doom::Deleted(_)) => content.ends_now(kind, name).await,
            Some(Doom::Marked) | None => content.ends(kind, name).await,
        }
    }

    /// Whether a result whose name has this state now is the one whose bytes were seen.
    fn permits(&self, named: &Named, now: Option<&Doom>) -> bool {
        match now {
            None | Some(Doom::Marked) => true,
            Some(Doom::Deleting) => false,
            Some(Doom::Deleted(_)) => self.doomed.get(named) == now,
        }
    }
}

/// Names of this kind that no row refers to.
async fn orphans_among(target: impl Into<Target<'_>>, kind: ContentKind, names: &[String]) -> Result<Vec<String>> {
    let statement = match kind {
        ContentKind::Blob => db::query_scalar(
            "SELECT value FROM @texts(?) WHERE NOT EXISTS (
                 SELECT 1 FROM tile JOIN frame ON frame.job = tile.job AND frame.number = tile.frame
                 WHERE tile.blob = value AND (frame.state IN ('open', 'stitching')
                     OR (SELECT recorded = 1 FROM job WHERE job.number = tile.job)
                     OR EXISTS (SELECT 1 FROM verification WHERE verification.job = frame.job
                                AND verification.frame = frame.number AND verification.position = -1)))
             AND NOT EXISTS (SELECT 1 FROM tile WHERE tile.record IS NOT NULL AND tile.record = value)",
        ),
        ContentKind::Picture => db::query_scalar(
            "SELECT value FROM @texts(?)
             WHERE NOT EXISTS (SELECT 1 FROM frame WHERE frame.picture IS NOT NULL AND frame.picture = value)
               AND NOT EXISTS (SELECT 1 FROM picture WHERE picture.hash = value)",
        ),
    };
    statement.bind(json_list(names)).fetch_all(target).await
}

impl Queue {
    /// Whether other servers may use the database: then the times of marks hold after a restart.
    pub(crate) fn may_have_others(&self) -> bool {
        self.clock.is_lasting()
    }

    /// The names that no row refers to: no unfinished frame uses the blob, no job the picture.
    pub(crate) async fn orphans(&self, kind: ContentKind, names: &[String]) -> Result<Vec<String>> {
        orphans_among(self.readers(), kind, names).await
    }

    /// Known states of the names of these results; to be read before their bytes are looked for.
    pub(crate) async fn begin_check(&self, names: &[Named]) -> Result<CheckedNames> {
        let at = monotonic_now();
        Ok(CheckedNames { doomed: doomed_among(self.readers(), names).await?, at })
    }

    /// Marks the names that no row refers to.
    pub(crate) async fn mark_doomed(&self, kind: ContentKind, names: Vec<String>) -> Result<()> {
        self.put_doomed(kind, names, "marked").await.map(drop)
    }

    /// Takes a name at once if no row refers to it; the caller must delete its bytes.
    pub(crate) async fn take_unmarked(&self, kind: ContentKind, name: String) -> Result<bool> {
        self.put_doomed(kind, vec![name], "deleting").await.map(|taken| taken > 0)
    }

    async fn put_doomed(&self, kind: ContentKind, names: Vec<String>, state: &'static str) -> Result<u64> {
        let now_ms = self.clock.now_ms();
        self.database
            .write(Durability::Full, move |connection| {
                Box::pin(async move {
                    let orphans = orphans_among(&mut *connection, kind, &names).await?;
                    let put = db::query(
                        "INSERT INTO doomed (kind, name, state, since_ms) SELECT ?1, value, ?2, ?3 FROM @texts(?4) WHERE TRUE
                         ON CONFLICT (kind, name) DO UPDATE SET state = excluded.state, since_ms = excluded.since_ms
                         WHERE excluded.state = 'deleting'",
                    );
                    let put = put.bind(kind.name()).bind(state).bind(now_ms).bind(json_list(orphans));
                    Ok(put.execute(connection).await?.rows_affected())
                })
            })
            .await
    }

    /// Takes up to `limit` names that were marked at least `grace` ago and that still no row refers to; the caller must
    /// delete their bytes within a minute.
    pub(crate) async fn take_doomed(&self, kind: ContentKind, grace: Duration, limit: u32) -> Result<Vec<String>> {
        let (now_ms, grace_ms) = (self.clock.now_ms(), i64::try_from(grace.as_millis()).unwrap_or(i64::MAX / 4));
        self.database
            .write(Durability::Full, move |connection| {
                Box::pin(async move { take(connection, kind, now_ms, grace_ms, limit).await })
            })
            .await
    }

    /// Records that the bytes of names that were taken are deleted.
    pub(crate) async fn record_deleted(&self, kind: ContentKind, names: Vec<String>) -> Result<()> {
        self.end_deleting(kind, names, "deleted").await
    }

    /// Marks names that were taken again, because their bytes were stored again in the meantime.
    pub(crate) async fn mark_again(&self, kind: ContentKind, names: Vec<String>) -> Result<()> {
        self.end_deleting(kind, names, "marked").await
    }

    async fn end_deleting(&self, kind: ContentKind, names: Vec<String>, state: &'static str) -> Result<()> {
        if names.is_empty() {
            return Ok(());
        }
        let now_ms = self.clock.now_ms();
        self.database
            .write(Durability::Full, move |connection| {
                Box::pin(async move {
                    let ended = db::query(
                        "UPDATE doomed SET state = ?1, since_ms = ?2
                         WHERE kind = ?3 AND state = 'deleting' AND name IN (SELECT value FROM @texts(?4))",
                    );
                    ended.bind(state).bind(now_ms).bind(kind.name()).bind(json_list(names)).execute(connection).await?;
                    Ok(())
                })
            })
            .await
    }
}

async fn take(
    connection: &mut Connection,
    kind: ContentKind,
    now_ms: i64,
    grace_ms: i64,
    limit: u32,
) -> Result<Vec<String>> {
    db::query("DELETE FROM doomed WHERE state = 'deleted' AND since_ms <= ?")
        .bind(now_ms - grace_ms.max(MIN_RECORD_MS))
        .execute(&mut *connection)
        .await?;
    let (marked_ms, abandoned_ms) = (now_ms - grace_ms, now_ms - ABANDONED_MS);
    let due = db::query_scalar(
        "SELECT name FROM doomed WHERE kind = ?1 AND since_ms <= ?2
           AND since_ms <= CASE state WHEN 'marked' THEN ?3 WHEN 'deleting' THEN ?4 END
         ORDER BY since_ms LIMIT ?5",
    );
    let due: Vec<String> = due
        .bind(kind.name())
        .bind(marked_ms.max(abandoned_ms))
        .bind(marked_ms)
        .bind(abandoned_ms)
        .bind(limit)
        .fetch_all(&mut *connection)
        .await?;
    let orphans = orphans_among(&mut *connection, kind, &due).await?;
    let used = due.iter().filter(|name| !orphans.contains(name));
    remove(connection, kind, json_list(used)).await?;
    db::query(
        "UPDATE doomed SET state = 'deleting', since_ms = ? WHERE kind = ? AND name IN (SELECT value FROM @texts(?))",
    )
    .bind(now_ms)
    .bind(kind.name())
    .bind(json_list(&orphans))
    .execute(connection)
    .await?;
    Ok(orphans)
}

async fn remove(connection: &mut Connection, kind: ContentKind, names: String) -> Result<()> {
    let remove = db::query("DELETE FROM doomed WHERE kind = ? AND name IN (SELECT value FROM @texts(?))");
    remove.bind(kind.name()).bind(names).execute(connection).await?;
    Ok(())
}

async fn doomed_among(target: impl Into<Target<'_>>, names: &[Named]) -> Result<HashMap<Named, Doom>> {
    let found = db::query(
        "SELECT kind, name, state, since_ms FROM doomed
         WHERE kind IN ('picture', 'blob') AND name IN (SELECT value FROM @texts(?))",
    );
    let found = found.bind(json_list(names.iter().map(|(_, name)| name))).fetch_all(target).await?;
    found.iter().map(read).collect()
}

fn read(row: &Row) -> Result<(Named, Doom)> {
    let (kind, state, since_ms): (String, String, i64) = (row.get("kind")?, row.get("state")?, row.get("since_ms")?);
    let kind =
        parse_column("doomed.kind", &kind, |name| ContentKind::ALL.into_iter().find(|kind| kind.name() == name))?;
    let doom = parse_column("doomed.state", &state, |state| match state {
        "marked" => Some(Doom::Marked),
        "deleting" => Some(Doom::Deleting),
        "deleted" => Some(Doom::Deleted(since_ms)),
        _ => None,
    })?;
    Ok(((kind, row.get("name")?), doom))
}

/// Content of a result.
pub(crate) fn content_of(outcome: &LeaseOutcome) -> Option<Named> {
    match outcome {
        LeaseOutcome::Blob { hash, .. } => Some((ContentKind::Blob, hash.clone())),
        LeaseOutcome::Picture { hash, .. } => Some((ContentKind::Picture, hash.clone())),
        LeaseOutcome::BadBlobs { .. } | LeaseOutcome::Failed { .. } | LeaseOutcome::Released => None,
    }
}

/// Saves the names of a sync's results, and rejects the results whose bytes may have been deleted since they were seen.
pub(in crate::queue) async fn save_results(connection: &mut Connection, turn: &mut SyncInput) -> Result<()> {
    let Some(checked) = turn.checked.take() else { return Ok(()) };
    let names: Vec<Named> = turn.reports.iter().filter_map(|report| content_of(&report.outcome)).collect();
    let mut doomed = doomed_among(&mut *connection, &names).await?;
    let is_late = checked.at.elapsed() > MAX_CHECK_AGE;
    let is_gone = |named: &Named| is_late || !checked.permits(named, doomed.get(named));
    let gone: HashSet<Named> = names.into_iter().filter(is_gone).collect();
    for report in std::mem::take(&mut turn.reports) {
        match content_of(&report.outcome) {
            Some(named) if gone.contains(&named) => {
                let reason = "its bytes were deleted when it was reported".to_owned();
                turn.rejected.push(RejectedResult { lease: report.lease, hash: named.1, reason, is_wrong: false });
            }
            Some(_) | None => turn.reports.push(report),
        }
    }
    doomed.retain(|named, _| !gone.contains(named));
    for kind in ContentKind::ALL {
        let saved: Vec<&String> = doomed.keys().filter(|(of, _)| *of == kind).map(|(_, name)| name).collect();
        if !saved.is_empty() {
            remove(connection, kind, json_list(saved)).await?;
        }
    }
    Ok(())
}
