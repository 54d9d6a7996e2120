//! The write-ahead log (WAL), kept small even if the database is never idle.
//!
//! The engine checkpoints the WAL every few thousand pages, but restarts it only when no reader needs it any
//! more; under constant reading it would grow without limit. This module must not delay writes for long.

use std::path::{Path, PathBuf};

use super::{Connection, query};
use crate::host::disk;

/// A WAL of this size is checkpointed between two commits, and restarted.
pub(super) const LIMIT_BYTES: u64 = 64 << 20;
/// So is one that is larger than this part of the free disk: on a full disk a checkpoint fails, since it may make the
/// database larger before it frees the WAL.
const FREE_PART: u64 = 4;
/// If a reader prevents that, the next attempt follows after this many commits.
const RETRY_AFTER_COMMITS: u32 = 64;
/// Timeouts of writes for readers during a restart, and otherwise.
const WAIT_FOR_READERS: &str = "PRAGMA busy_timeout = 50";
const WAIT_FOR_LOCKS: &str = "PRAGMA busy_timeout = 5000";

/// Write-ahead log of a database.
#[derive(Debug)]
pub(super) struct Wal {
    file: PathBuf,
    limit_bytes: u64,
    /// Commits before the next attempt.
    commits_until_retry: u32,
}

impl Wal {
    /// WAL next to a database's file.
    pub(super) fn new(database: &Path, limit_bytes: u64) -> Self {
        Self { file: database.with_extension("sqlite-wal"), limit_bytes, commits_until_retry: 0 }
    }

    /// Size of the WAL.
    pub(super) fn size_bytes(&self) -> u64 {
        std::fs::metadata(&self.file).map_or(0, |metadata| metadata.len())
    }

    /// Size above which the WAL is large.
    fn limit_bytes(&self) -> u64 {
        let disk = self.file.parent().map(disk).unwrap_or_default();
        // A disk of unknown size has none.
        if disk.total_bytes == 0 { self.limit_bytes } else { self.limit_bytes.min(disk.free_bytes / FREE_PART).max(1) }
    }

    /// Checkpoints the WAL if it is large; must be called outside a transaction.
    pub(super) async fn checkpoint_if_large(&mut self, connection: &mut Connection) {
        if self.size_bytes() < self.limit_bytes() {
            return;
        }
        if self.commits_until_retry > 0 {
            self.commits_until_retry -= 1;
            return;
        }
        for statement in [WAIT_FOR_READERS, "PRAGMA wal_checkpoint(TRUNCATE)", WAIT_FOR_LOCKS] {
            if let Err(error) = query(statement).execute(&mut *connection).await {
                tracing::warn!(%error, "could not checkpoint the database's WAL");
            }
        }
        let size_bytes = self.size_bytes();
        if size_bytes >= self.limit_bytes() {
            self.commits_until_retry = RETRY_AFTER_COMMITS;
            tracing::warn!(size_bytes, "the database's WAL stays large: a reader uses an old state");
        }
    }
}

#[cfg(test)]
mod tests {
    use sqlx::ConnectOptions;
    use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode};

    use super::*;

    const LIMIT: u64 = 1 << 20;

    async fn connect(file: &Path) -> Connection {
        let options = SqliteConnectOptions::new().filename(file).create_if_missing(true);
        let options = options.journal_mode(SqliteJournalMode::Wal);
        Connection::Sqlite(options.connect().await.expect("connects"))
    }

    async fn write(connection: &mut Connection, log: &mut Wal) {
        let text = "x".repeat(32 << 10);
        query("INSERT INTO t VALUES (?)").bind(text).execute(&mut *connection).await.expect("writes");
        log.checkpoint_if_large(connection).await;
    }

    #[tokio::test]
    async fn the_wal_stays_small_under_constant_reading() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("farm.sqlite");
        let (mut writer, mut log) = (connect(&file).await, Wal::new(&file, LIMIT));
        // Disables the engine's automatic checkpoints.
        query("PRAGMA wal_autocheckpoint = 0").execute(&mut writer).await.expect("sets");
        query("CREATE TABLE t (text TEXT)").execute(&mut writer).await.expect("creates");
        let mut readers = [connect(&file).await, connect(&file).await];
        for round in 0..100 {
            for reader in &mut readers {
                query("SELECT count(*) FROM t").fetch_one(reader).await.expect("reads");
            }
            write(&mut writer, &mut log).await;
            assert!(log.size_bytes() <= 2 * LIMIT, "{} bytes in round {round}", log.size_bytes());
        }
        let rows: i64 =
            crate::db::query_scalar("SELECT count(*) FROM t").fetch_one(&mut readers[0]).await.expect("reads");
        assert_eq!(rows, 100);
    }

    #[tokio::test]
    async fn a_reader_of_an_old_state_does_not_delay_writes() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("farm.sqlite");
        let (mut writer, mut log) = (connect(&file).await, Wal::new(&file, LIMIT));
        query("CREATE TABLE t (text TEXT)").execute(&mut writer).await.expect("creates");
        let mut reader = connect(&file).await;
        query("BEGIN").execute(&mut reader).await.expect("begins");
        query("SELECT count(*) FROM t").fetch_one(&mut reader).await.expect("reads");
        for _ in 0..100 {
            write(&mut writer, &mut log).await;
        }
        assert!(log.size_bytes() > 3 * LIMIT, "it is needed");
        query("ROLLBACK").execute(&mut reader).await.expect("ends");
        for _ in 0..70 {
            write(&mut writer, &mut log).await;
        }
        assert!(log.size_bytes() <= 2 * LIMIT, "{} bytes", log.size_bytes());
    }
}
