//! The database file: opened, migrated, checked; one connection writes (see `writer`),
//! several read.
//!
//! It has no statements about jobs, tiles or leases: those are in `queue`.

mod connection;
mod copy;
mod dialect;
mod external;
mod farm_id;
mod first_write;
mod identity;
mod location;
mod migrations;
mod notifications;
pub(crate) mod postgres;
mod query;
mod row;
#[cfg(test)]
pub(crate) mod sent;
mod transaction;
mod value;
mod wal;
mod writer;

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use futures_util::future::BoxFuture;
use proto::fail_point::{self, FailPoint};
use sqlx::ConnectOptions;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous};

pub(crate) use connection::{Connection, Readers, Target};
pub(crate) use farm_id::FarmId;
pub(crate) use first_write::{FirstWrite, with_first_write};
pub(crate) use location::DatabaseLocation;
pub use location::{ParseDatabaseError, PostgresAddress};
pub(crate) use notifications::Notifications;
pub(crate) use postgres::Sharing;
pub(crate) use query::made_query;
pub(crate) use query::{Changed, Statement, query, query_scalar};
pub(crate) use row::Row;
use transaction::WritingConnection;
use wal::Wal;
pub(crate) use writer::{CommitTimes, Durability};
use writer::{Urgency, Writer};

use crate::clock::FarmTime;

/// Statements that a connection keeps prepared: all of the program's.
const PREPARED_STATEMENTS: usize = 512;
/// Number of reading connections.
const READER_CONNECTIONS: u32 = 4;
/// Number of rows that the engine's thread reads ahead of the caller.
const ROW_BUFFER: usize = 1024;
/// Pages of the WAL (of 4 KiB) after which the engine checkpoints it: the commit that reaches this number has
/// to wait for the checkpoint, which must not be long.
const AUTOCHECKPOINT_PAGES: &str = "1000";
/// Databases up to this size are checked page by page at start.
const MAX_START_CHECK_BYTES: u64 = 16 << 20;

/// Every migration of this release: its version and its checksum.
pub(crate) fn migrations() -> impl Iterator<Item = (i64, &'static [u8])> {
    migrations::SQLITE.iter().map(|migration| (migration.version, &*migration.checksum))
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
    /// Another server of this database has begun while this one could not reach it.
    #[error("another server uses the database")]
    Taken,
}

impl From<sqlx::Error> for DatabaseError {
    fn from(error: sqlx::Error) -> Self {
        Self::Sql(Arc::new(error))
    }
}

impl DatabaseError {
    /// Whether the disk, or the quota, is full.
    pub(crate) fn is_full(&self) -> bool {
        self.code().is_some_and(|code| code == "53100" || sqlite_result(&code) == Some(13))
    }

    /// Whether the database cannot be reached now; it may be later.
    pub(crate) fn is_unreachable(&self) -> bool {
        match self {
            Self::Sql(error) => postgres::is_lost(error),
            Self::Taken => true,
            Self::Rows { .. } | Self::Value { .. } | Self::Closed => false,
        }
    }

    /// Whether the file is not, or no longer, an intact database.
    pub(crate) fn is_corruption(&self) -> bool {
        self.code().is_some_and(|code| code.starts_with("XX00") || matches!(sqlite_result(&code), Some(11 | 26)))
    }

    /// Its SQLSTATE, if PostgreSQL sent it.
    pub(crate) fn sqlstate(&self) -> Option<String> {
        self.code().filter(|code| code.len() == 5).map(Cow::into_owned)
    }

    /// Result code of `SQLite`, or the SQLSTATE of PostgreSQL, which has five characters.
    fn code(&self) -> Option<Cow<'_, str>> {
        let Self::Sql(error) = self else { return None };
        error.as_database_error()?.code()
    }
}

/// Primary result code of `SQLite`.
fn sqlite_result(code: &str) -> Option<i32> {
    code.parse::<i32>().ok().filter(|_| code.len() < 5).map(|code| code & 0xff)
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
    /// The PostgreSQL server has this version.
    #[error("its server is PostgreSQL {0}")]
    OldServer(i32),
    /// It is a replica.
    #[error("it is a replica, which cannot be written to")]
    Replica,
    /// Another server of the farm uses it.
    #[error("another server uses it")]
    InUse,
}

impl OpenError {
    /// Whether its server did not answer, or ended the connection.
    pub(crate) fn is_lost(&self) -> bool {
        match self {
            Self::Sql(error) | Self::Migrate(sqlx::migrate::MigrateError::Execute(error)) => postgres::is_lost(error),
            Self::Migrate(_) | Self::Damaged(_) | Self::OldServer(_) | Self::Replica | Self::InUse => false,
        }
    }
}

/// Handle to the database.
#[derive(Debug)]
pub(crate) struct Database {
    writer: Writer,
    readers: Readers,
    commits: CommitTimes,
    time: Option<Arc<FarmTime>>,
}

impl Database {
    /// The database's file in a data folder.
    pub(crate) fn file(data: &Path) -> PathBuf {
        data.join("farm.sqlite")
    }

    /// Opens or creates the database of a data folder and applies pending migrations.
    pub(crate) async fn open(data: &Path) -> Result<Self, OpenError> {
        #[cfg(test)]
        if let Some(address) = crate::postgres_server::database_of(data) {
            return Self::open_postgres(&address.parse().expect("an address"), Sharing::Alone).await;
        }
        Self::open_file(data).await
    }

    /// Opens or creates the file of a data folder, also in tests on PostgreSQL.
    pub(crate) async fn open_file(data: &Path) -> Result<Self, OpenError> {
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
            .statement_cache_capacity(PREPARED_STATEMENTS)
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
        migrations::SQLITE.run(&mut connection).await?;
        fail_point::trigger_infallible(FailPoint::Migrated);
        let readers = SqlitePoolOptions::new()
            .max_connections(READER_CONNECTIONS)
            .test_before_acquire(false)
            .connect_with(options.read_only(true).create_if_missing(false))
            .await?;
        let commits = CommitTimes::default();
        let connection = WritingConnection::sqlite(connection, Wal::new(&file, wal::LIMIT_BYTES));
        let writer = Writer::start(connection, commits.clone());
        Ok(Self { writer, readers: Readers::Sqlite(readers), commits, time: None })
    }

    /// Opens or creates a database and applies pending migrations. A file is never shared.
    pub(crate) async fn open_at(location: &DatabaseLocation, sharing: Sharing) -> Result<Self, OpenError> {
        match &location.postgres {
            Some(address) => Self::open_postgres(address, sharing).await,
            None => Self::open_file(&location.data).await,
        }
    }

    /// Opens a database on a PostgreSQL server and applies pending migrations.
    pub(crate) async fn open_postgres(address: &PostgresAddress, sharing: Sharing) -> Result<Self, OpenError> {
        let commits = CommitTimes::default();
        let opened = postgres::open(address, sharing, commits.connections_lost.clone()).await?;
        let connection = WritingConnection::postgres(opened.connection, opened.session);
        let writer = Writer::start(connection, commits.clone());
        Ok(Self { writer, readers: Readers::Postgres(opened.readers), commits, time: Some(opened.time) })
    }

    /// The time that this server shares with the others of the database; `None` if it is a file.
    pub(crate) fn shared_time(&self) -> Option<Arc<FarmTime>> {
        self.time.clone()
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

    /// Size of the database if it is on a PostgreSQL server.
    pub(crate) async fn remote_bytes(&self) -> Result<Option<u64>, DatabaseError> {
        match self.readers {
            Readers::Sqlite(_) => Ok(None),
            Readers::Postgres(_) => {
                let size = query_scalar("SELECT pg_database_size(current_database())");
                Ok(Some(size.fetch_one(&self.readers).await?))
            }
        }
    }

    /// Durations of commits.
    pub(crate) fn commits(&self) -> &CommitTimes {
        &self.commits
    }

    /// Signal sent after every commit, and after [`Database::announce_commit`].
    pub(crate) fn commit_signal(&self) -> tokio::sync::watch::Receiver<()> {
        self.writer.changes()
    }

    /// Signal sent after every commit of this server.
    pub(crate) fn own_commit_signal(&self) -> tokio::sync::watch::Receiver<()> {
        self.writer.own_changes()
    }

    /// Sends the signal of a commit for one that another server has made.
    pub(crate) fn announce_commit(&self) {
        self.writer.signal();
    }

    /// Messages between the servers of the database; `None` if it is a file.
    pub(crate) fn notifications(&self) -> Option<Notifications> {
        match &self.readers {
            Readers::Sqlite(_) => None,
            Readers::Postgres(pool) => Some(Notifications::new(pool.clone())),
        }
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
