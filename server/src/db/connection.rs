//! Connections, and what a statement can run on. They hide the engine: the rest of the server has only statements.

use sqlx::sqlite::{SqliteConnection, SqlitePool};
use sqlx::{Connection as _, Sqlite, Transaction};

use super::{DatabaseError, query};

/// One connection.
#[derive(Debug)]
pub(crate) struct Connection(pub(super) SqliteConnection);

impl Connection {
    /// Does `work` in a transaction that no other writer interrupts; nothing of it stays if it fails.
    pub(crate) async fn in_transaction<T>(
        &mut self,
        work: impl AsyncFnOnce(&mut Self) -> Result<T, DatabaseError>,
    ) -> Result<T, DatabaseError> {
        query("BEGIN IMMEDIATE").execute(&mut *self).await?;
        let done = work(&mut *self).await;
        let end = if done.is_ok() { "COMMIT" } else { "ROLLBACK" };
        query(end).execute(self).await?;
        done
    }

    /// Closes it.
    pub(crate) async fn close(self) -> Result<(), DatabaseError> {
        Ok(self.0.close().await?)
    }
}

/// Connections for reading.
#[derive(Clone, Debug)]
pub(crate) struct Readers(pub(super) SqlitePool);

impl Readers {
    /// Begins a transaction whose statements all see the state at its first one.
    pub(crate) async fn snapshot(&self) -> Result<Snapshot, DatabaseError> {
        Ok(Snapshot(self.0.begin().await?))
    }

    /// Closes all of them.
    pub(super) async fn close(&self) {
        self.0.close().await;
    }
}

/// A transaction that only reads; it ends when it is dropped.
#[derive(Debug)]
pub(crate) struct Snapshot(Transaction<'static, Sqlite>);

/// Connection that a statement runs on.
#[derive(Debug)]
pub(crate) enum Target<'c> {
    /// This one.
    Connection(&'c mut SqliteConnection),
    /// Any of these.
    Readers(&'c SqlitePool),
}

impl<'c> From<&'c mut Connection> for Target<'c> {
    fn from(connection: &'c mut Connection) -> Self {
        Self::Connection(&mut connection.0)
    }
}

impl<'c> From<&'c Readers> for Target<'c> {
    fn from(readers: &'c Readers) -> Self {
        Self::Readers(&readers.0)
    }
}

impl<'c> From<&'c mut Snapshot> for Target<'c> {
    fn from(snapshot: &'c mut Snapshot) -> Self {
        Self::Connection(&mut snapshot.0)
    }
}
