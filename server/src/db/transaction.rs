//! Transactions of the writer, in which each operation has a savepoint.

use std::time::Duration;

use sqlx::postgres::PgConnection;
use sqlx::sqlite::SqliteConnection;

use super::postgres::{self, Session};
use super::wal::Wal;
use super::{Connection, DatabaseError, Durability, query};

/// The connection that writes, and the state of its engine.
#[derive(Debug)]
pub(super) struct WritingConnection {
    connection: Connection,
    engine: Engine,
}

#[derive(Debug)]
enum Engine {
    /// A file.
    Sqlite {
        /// Current setting of the connection.
        synchronous: Durability,
        wal: Wal,
    },
    /// A PostgreSQL server.
    Postgres(Box<Session>),
}

impl WritingConnection {
    /// Writes to a file.
    pub(super) fn sqlite(connection: SqliteConnection, wal: Wal) -> Self {
        let engine = Engine::Sqlite { synchronous: Durability::Full, wal };
        Self { connection: Connection::Sqlite(connection), engine }
    }

    /// Writes to a PostgreSQL server.
    pub(super) fn postgres(connection: PgConnection, session: Session) -> Self {
        Self { connection: Connection::Postgres(connection), engine: Engine::Postgres(Box::new(session)) }
    }

    /// Connection for the statements of an operation.
    pub(super) fn connection(&mut self) -> &mut Connection {
        &mut self.connection
    }

    /// Begins a transaction, and its first operation's savepoint.
    pub(super) async fn begin(&mut self, durability: Durability) -> Result<(), DatabaseError> {
        match (&mut self.engine, &mut self.connection) {
            (Engine::Postgres(session), Connection::Postgres(connection)) => {
                let text = match durability {
                    Durability::Full => postgres::BEGIN_GROUP,
                    Durability::Relaxed => postgres::BEGIN_RELAXED_GROUP,
                };
                #[cfg(test)]
                super::sent::record(text);
                session.begin(connection, text).await
            }
            (Engine::Sqlite { synchronous, .. }, connection) => {
                let text = match durability {
                    _ if durability == *synchronous => "BEGIN IMMEDIATE; SAVEPOINT operation",
                    Durability::Full => "PRAGMA synchronous = FULL; BEGIN IMMEDIATE; SAVEPOINT operation",
                    Durability::Relaxed => "PRAGMA synchronous = NORMAL; BEGIN IMMEDIATE; SAVEPOINT operation",
                };
                // If it fails half-way the setting is unknown: the weaker one is assumed.
                *synchronous = Durability::Relaxed;
                connection.command(text).await?;
                *synchronous = durability;
                Ok(())
            }
            (Engine::Postgres(_), Connection::Sqlite(_)) => Err(DatabaseError::Closed),
        }
    }

    /// Ends an operation and begins the next one. Both are sent to the engine together, because each call of it costs two
    /// context switches, or a round trip.
    pub(super) async fn next_operation(&mut self, was_kept: bool) -> Result<(), DatabaseError> {
        let text = if was_kept {
            "RELEASE SAVEPOINT operation; SAVEPOINT operation"
        } else {
            "ROLLBACK TO SAVEPOINT operation; RELEASE SAVEPOINT operation; SAVEPOINT operation"
        };
        self.connection.command(text).await
    }

    /// Undoes the last operation.
    pub(super) async fn undo_operation(&mut self) -> Result<(), DatabaseError> {
        self.connection.command("ROLLBACK TO SAVEPOINT operation").await
    }

    /// Commits; the last savepoint is released.
    pub(super) async fn commit(&mut self) -> Result<(), DatabaseError> {
        match (&mut self.engine, &mut self.connection) {
            (Engine::Postgres(session), Connection::Postgres(connection)) => {
                #[cfg(test)]
                super::sent::record("COMMIT");
                session.commit(connection).await
            }
            (Engine::Sqlite { .. } | Engine::Postgres(_), connection) => connection.command("COMMIT").await,
        }
    }

    /// Time in which the operations of a transaction must end; a file has no limit.
    pub(super) fn time_limit(&self) -> Option<Duration> {
        match self.engine {
            Engine::Sqlite { .. } => None,
            Engine::Postgres(_) => Some(postgres::ANSWER_TIMEOUT),
        }
    }

    /// Gives up a connection that does not answer; its transaction is rolled back without it.
    pub(super) async fn give_up(&mut self) -> DatabaseError {
        if let (Engine::Postgres(session), Connection::Postgres(connection)) = (&mut self.engine, &mut self.connection)
            && let Err(error) = session.reconnect(connection).await
        {
            return error;
        }
        sqlx::Error::Io(std::io::ErrorKind::TimedOut.into()).into()
    }

    /// Rolls back.
    pub(super) async fn roll_back(&mut self) {
        // An engine ends a transaction automatically after some errors; then there is nothing to roll back.
        drop(self.connection.command("ROLLBACK").await);
    }

    /// Moves the WAL into the file of the database, and shortens it.
    pub(super) async fn checkpoint(&mut self) {
        if let Engine::Sqlite { .. } = self.engine
            && let Err(error) = query("PRAGMA wal_checkpoint(TRUNCATE)").execute(&mut self.connection).await
        {
            tracing::warn!(%error, "could not checkpoint the database's WAL");
        }
    }

    /// The same if the WAL is large; must be called outside a transaction.
    pub(super) async fn checkpoint_if_large(&mut self) {
        if let Engine::Sqlite { wal, .. } = &mut self.engine {
            wal.checkpoint_if_large(&mut self.connection).await;
        }
    }

    /// Closes it.
    pub(super) async fn close(self) -> Result<(), DatabaseError> {
        self.connection.close().await
    }
}
