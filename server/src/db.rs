//! The database file: opened, migrated, checked; one connection writes (see `writer`),
//! several read.
//!
//! It has no statements about jobs, tiles or leases: those are in `queue`.

mod connection;
mod dialect;
mod external;
mod first_write;
#[cfg(test)]
pub(crate) mod postgres;
mod query;
mod row;
mod value;
mod wal;
mod writer;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use futures_util::future::BoxFuture;
use proto::fail_point::{self, FailPoint};
use sqlx::ConnectOptions;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous};

pub(crate) use connection::{Connection, Readers, Target};
pub(crate) use first_write::{FirstWrite, with_first_write};
#[cfg(test)]
pub(crate) use query::made_query;
pub(crate) use query::{Changed, Statement, query, query_scalar};
pub(crate) use row::Row;
use wal::Wal;
pub(crate) use writer::{CommitTimes, Durability};
use writer::{Urgency, Writer};

/// Number of reading connections.
const READER_CONNECTIONS: u32 = 4;
/// Number of rows that the engine's thread reads ahead of the caller.
const ROW_BUFFER: usize = 1024;
/// Pages of the WAL (of 4 KiB) after which the engine checkpoints it: the commit that reaches this number has
/// to wait for the checkpoint, which must not be long.
const AUTOCHECKPOINT_PAGES: &str = "1000";
/// Databases up to this size are checked page by page at start.
const MAX_START_CHECK_BYTES: u64 = 16 << 20;

static MIGRATIONS: sqlx::migrate::Migrator = sqlx::migrate!("../migrations");

/// Every migration of this release: its version and its checksum.
pub(crate) fn migrations() -> impl Iterator<Item = (i64, &'static [u8])> {
    MIGRATIONS.iter().map(|migration| (migration.version, &*migration.checksum))
}

/// Error when reading or writing the database.
#[derive(Clone, Debug, thiserror::Error)]
pub enum DatabaseError {
    /// The engine failed.
    #[error("a database operation failed")]
    Sql(#[source] Arc<sqlx::Error>),
    /// A statement changed another number of rows than its transition requires.
    #[error("{what} changed {changed} rows instead of {expected}")]
    Rows {
        /// The statement, as table and transition.
        what: &'static str,
        /// Rows it should have changed.
        expected: u64,
        /// Rows it changed.
        changed: u64,
    },
    /// A row has a value that this version does not know.
    #[error("{column} is {value:?}, which this version does not know")]
    Value {
        /// Table and column.
        column: &'static str,
        /// Stored value.
        value: String,
    },
    /// The server is shutting down.
    #[error("the database is closed")]
    Closed,
}

impl From<sqlx::Error> for DatabaseError {
    fn from(error: sqlx::Error) -> Self {
        Self::Sql(Arc::new(error))
    }
}

impl DatabaseError {
    /// Whether the disk, or the quota, is full.
    pub(crate) fn is_full(&self) -> bool {
        self.code() == Some(13)
    }

    /// Whether the file is not, or no longer, an intact database.
    pub(crate) fn is_corruption(&self) -> bool {
        matches!(self.code(), Some(11 | 26))
    }

    /// The engine's primary result code.
    fn code(&self) -> Option<i32> {
        let Self::Sql(error) = self else { return None };
        error.as_database_error()?.code()?.parse::<i32>().ok().map(|code| code & 0xff)
    }
}

/// Error when opening the database.
#[derive(Debug, thiserror::Error)]
pub(crate) enum OpenError {
    /// It could not be opened or read.
    #[error(transparent)]
    Sql(#[from] sqlx::Error),
    /// Migrations could not be applied.
    #[error(transparent)]
    Migrate(#[from] sqlx::migrate::MigrateError),
    /// It is damaged.
    #[error("it is damaged: {0}")]
    Damaged(String),
}

/// Handle to the database.
#[derive(Debug)]
pub(crate) struct Database {
    writer: Writer,
    readers: Readers,
    commits: CommitTimes,
}

impl Database {
    /// The database's file in a data folder.
    pub(crate) fn file(data: &Path) -> PathBuf {
        data.join("farm.sqlite")
    }

    /// Opens or creates the database of a data folder and applies pending migrations.
    pub(crate) async fn open(data: &Path) -> Result<Self, OpenError> {
        Self::open_with(data, SqliteConnectOptions::new().disable_statement_logging()).await
    }

    /// Opens the database and emits an event for every statement, for tests that check them.
    #[cfg(test)]
    pub(crate) async fn open_traced(data: &Path) -> Result<Self, OpenError> {
        Self::open_with(data, SqliteConnectOptions::new()).await
    }

    async fn open_with(data: &Path, options: SqliteConnectOptions) -> Result<Self, OpenError> {
        let file = Self::file(data);
        let size_bytes = std::fs::metadata(&file).map_or(0, |metadata| metadata.len());
        let options = options
            .filename(&file)
            .create_if_missing(true)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            .foreign_keys(true)
            .busy_timeout(Duration::from_secs(5))
            .row_buffer_size(ROW_BUFFER)
            .pragma("wal_autocheckpoint", AUTOCHECKPOINT_PAGES);
        // Its WAL has the same mode.
        crate::private_files::create_if_missing(&file).map_err(sqlx::Error::Io)?;
        let mut connection = options.connect().await?;
        if size_bytes <= MAX_START_CHECK_BYTES {
            let verdict: String = sqlx::query_scalar("PRAGMA quick_check(1)").fetch_one(&mut connection).await?;
            if verdict != "ok" {
                return Err(OpenError::Damaged(verdict));
            }
        }
        fail_point::trigger_infallible(FailPoint::Migrating);
        MIGRATIONS.run(&mut connection).await?;
        fail_point::trigger_infallible(FailPoint::Migrated);
        let readers = SqlitePoolOptions::new()
            .max_connections(READER_CONNECTIONS)
            .test_before_acquire(false)
            .connect_with(options.read_only(true).create_if_missing(false))
            .await?;
        let commits = CommitTimes::default();
        Ok(Self {
            writer: Writer::start(Connection(connection), commits.clone(), Wal::new(&file, wal::LIMIT_BYTES)),
            readers: Readers(readers),
            commits,
        })
    }

    /// Runs `operation` in a transaction of the writer and returns when it is committed. The first one of a task
    /// with a [`FirstWrite`] also writes that.
    pub(crate) async fn write<T, F>(&self, durability: Durability, operation: F) -> Result<T, DatabaseError>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut Connection) -> BoxFuture<'c, Result<T, DatabaseError>> + Send + 'static,
    {
        let Some(entry) = first_write::of_task().filter(|entry| !entry.is_written()) else {
            return self.writer.write(Urgency::Ordinary, durability, operation).await;
        };
        let written = Arc::clone(&entry);
        let recorded = self.writer.write(Urgency::Ordinary, durability, move |connection| {
            Box::pin(async move {
                let result = operation(&mut *connection).await?;
                Ok((result, written.insert(connection).await?))
            })
        });
        let (result, number) = recorded.await?;
        entry.set_number(number);
        Ok(result)
    }

    /// Like [`Database::write`], for an operation that a worker waits for: it does not wait for other operations.
    pub(crate) async fn write_for_worker<T, F>(&self, durability: Durability, operation: F) -> Result<T, DatabaseError>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut Connection) -> BoxFuture<'c, Result<T, DatabaseError>> + Send + 'static,
    {
        self.writer.write(Urgency::Worker, durability, operation).await
    }

    /// Durations of commits.
    pub(crate) fn commits(&self) -> &CommitTimes {
        &self.commits
    }

    /// Signal sent after every commit.
    pub(crate) fn commit_signal(&self) -> tokio::sync::watch::Receiver<()> {
        self.writer.bell()
    }

    /// Connections for reading.
    pub(crate) fn readers(&self) -> &Readers {
        &self.readers
    }

    /// Finishes pending writes, checkpoints the WAL and closes the database.
    pub(crate) async fn close(&self) {
        self.readers.close().await;
        self.writer.close().await;
    }
}
