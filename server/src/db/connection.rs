//! Connections, and what a statement can run on. They hide the engine: the rest of the server has only statements.

use sqlx::postgres::{PgConnection, PgPool};
use sqlx::sqlite::{SqliteConnection, SqlitePool};
use sqlx::{Connection as _, Postgres, Sqlite, Transaction};

use super::{DatabaseError, postgres};

/// One connection.
#[derive(Debug)]
pub(crate) enum Connection {
    /// To a file.
    Sqlite(SqliteConnection),
    /// To a PostgreSQL server.
    Postgres(PgConnection),
}

impl Connection {
    /// Does `work` in a transaction that no other writer interrupts; nothing of it stays if it fails.
    pub(crate) async fn in_transaction<T>(
        &mut self,
        work: impl AsyncFnOnce(&mut Self) -> Result<T, DatabaseError>,
    ) -> Result<T, DatabaseError> {
        let begin = match self {
            Self::Sqlite(_) => "BEGIN IMMEDIATE",
            Self::Postgres(_) => postgres::BEGIN,
        };
        self.command(begin).await?;
        let done = work(&mut *self).await;
        self.command(if done.is_ok() { "COMMIT" } else { "ROLLBACK" }).await?;
        done
    }

    /// Runs commands, separated by semicolons, that have no parameters and whose rows do not matter.
    pub(crate) async fn command(&mut self, text: &'static str) -> Result<(), DatabaseError> {
        #[cfg(test)]
        super::sent::record(text);
        match self {
            // Kept prepared, which raw SQL is not.
            Self::Sqlite(connection) => sqlx::query(text).execute(connection).await.map(drop)?,
            Self::Postgres(connection) => sqlx::raw_sql(text).execute(connection).await.map(drop)?,
        }
        Ok(())
    }

    /// Closes it.
    pub(crate) async fn close(self) -> Result<(), DatabaseError> {
        match self {
            Self::Sqlite(connection) => connection.close().await?,
            Self::Postgres(connection) => connection.close().await?,
        }
        Ok(())
    }
}

/// Connections for reading.
#[derive(Clone, Debug)]
pub(crate) enum Readers {
    /// To a file.
    Sqlite(SqlitePool),
    /// To a PostgreSQL server.
    Postgres(PgPool),
}

impl Readers {
    /// Begins a transaction whose statements all see the state at its first one.
    pub(crate) async fn snapshot(&self) -> Result<Snapshot, DatabaseError> {
        Ok(match self {
            Self::Sqlite(pool) => Snapshot::Sqlite(pool.begin().await?),
            Self::Postgres(pool) => Snapshot::Postgres(pool.begin_with(postgres::BEGIN_SNAPSHOT).await?),
        })
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
    /// Of a PostgreSQL database.
    Postgres(Transaction<'static, Postgres>),
}

/// Connection that a statement runs on.
#[derive(Debug)]
pub(crate) enum Target<'c> {
    /// This connection to a file.
    Sqlite(&'c mut SqliteConnection),
    /// Any of these connections to a file.
    SqlitePool(&'c SqlitePool),
    /// This connection to a PostgreSQL server.
    Postgres(&'c mut PgConnection),
    /// Any of these connections to a PostgreSQL server.
    PostgresPool(&'c PgPool),
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
            Readers::Sqlite(pool) => Self::SqlitePool(pool),
            Readers::Postgres(pool) => Self::PostgresPool(pool),
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
