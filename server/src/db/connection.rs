//! Connections to either engine, and what a statement can run on.

use sqlx::postgres::{PgConnection, PgPool};
use sqlx::sqlite::{SqliteConnection, SqlitePool};
use sqlx::{Connection as _, Postgres, Sqlite, Transaction};

use super::{DatabaseError, query};

/// One connection.
#[derive(Debug)]
pub(crate) enum Connection {
    /// To a file.
    Sqlite(SqliteConnection),
    /// To a server.
    Postgres(PgConnection),
}

impl Connection {
    /// Does `work` in a transaction that no other writer interrupts; nothing of it stays if it fails.
    pub(crate) async fn in_transaction<T>(
        &mut self,
        work: impl AsyncFnOnce(&mut Self) -> Result<T, DatabaseError>,
    ) -> Result<T, DatabaseError> {
        query(self.begin()).execute(&mut *self).await?;
        let done = work(&mut *self).await;
        let end = if done.is_ok() { "COMMIT" } else { "ROLLBACK" };
        query(end).execute(self).await?;
        done
    }

    /// Statement that begins a transaction that writes.
    fn begin(&self) -> &'static str {
        match self {
            Self::Sqlite(_) => "BEGIN IMMEDIATE",
            Self::Postgres(_) => "BEGIN",
        }
    }

    /// Closes it.
    pub(crate) async fn close(self) -> Result<(), DatabaseError> {
        match self {
            Self::Sqlite(connection) => Ok(connection.close().await?),
            Self::Postgres(connection) => Ok(connection.close().await?),
        }
    }
}

/// Connections for reading.
#[derive(Clone, Debug)]
pub(crate) enum Readers {
    /// To a file.
    Sqlite(SqlitePool),
    /// To a server.
    Postgres(PgPool),
}

impl Readers {
    /// Begins a transaction whose statements all see the state at its first one.
    pub(crate) async fn snapshot(&self) -> Result<Snapshot, DatabaseError> {
        match self {
            Self::Sqlite(pool) => Ok(Snapshot::Sqlite(pool.begin().await?)),
            Self::Postgres(pool) => {
                let begin = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY";
                Ok(Snapshot::Postgres(pool.begin_with(begin).await?))
            }
        }
    }

    /// Closes all of them.
    pub(super) async fn close(&self) {
        match self {
            Self::Sqlite(pool) => pool.close().await,
            Self::Postgres(pool) => pool.close().await,
        }
    }
}

/// A transaction that only reads; it ends when it is dropped.
#[derive(Debug)]
pub(crate) enum Snapshot {
    /// Of a file.
    Sqlite(Transaction<'static, Sqlite>),
    /// Of a server.
    Postgres(Transaction<'static, Postgres>),
}

/// What a statement runs on.
#[derive(Debug)]
pub(crate) enum Target<'c> {
    /// A connection to a file.
    Sqlite(&'c mut SqliteConnection),
    /// Any of several connections to a file.
    SqliteReaders(&'c SqlitePool),
    /// A connection to a server.
    Postgres(&'c mut PgConnection),
    /// Any of several connections to a server.
    PostgresReaders(&'c PgPool),
}

impl<'c> From<&'c mut Connection> for Target<'c> {
    fn from(connection: &'c mut Connection) -> Self {
        match connection {
            Connection::Sqlite(connection) => Self::Sqlite(connection),
            Connection::Postgres(connection) => Self::Postgres(connection),
        }
    }
}

impl<'c> From<&'c Readers> for Target<'c> {
    fn from(readers: &'c Readers) -> Self {
        match readers {
            Readers::Sqlite(pool) => Self::SqliteReaders(pool),
            Readers::Postgres(pool) => Self::PostgresReaders(pool),
        }
    }
}

impl<'c> From<&'c mut Snapshot> for Target<'c> {
    fn from(snapshot: &'c mut Snapshot) -> Self {
        match snapshot {
            Snapshot::Sqlite(transaction) => Self::Sqlite(transaction),
            Snapshot::Postgres(transaction) => Self::Postgres(transaction),
        }
    }
}
