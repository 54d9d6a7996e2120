//! Database connection for other processes than the server, which may be running: it changes no tables.

use std::path::Path;
use std::time::Duration;

use sqlx::ConnectOptions;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqliteSynchronous};

use super::{Connection, Database, DatabaseError, DatabaseLocation, postgres, query, query_scalar};

impl Connection {
    /// Connects to an existing database for an occasional write; in a file, it waits at most `timeout` for another
    /// process's write.
    pub(crate) async fn beside_server(location: &DatabaseLocation, timeout: Duration) -> Result<Self, DatabaseError> {
        if let Some(address) = &location.postgres {
            return Ok(Self::Postgres(postgres::connect_external(address).await?));
        }
        let connection = SqliteConnectOptions::new()
            .filename(Database::file(&location.data))
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            .foreign_keys(true)
            .busy_timeout(timeout)
            .disable_statement_logging()
            .connect()
            .await?;
        Ok(Self::Sqlite(connection))
    }

    /// Connects to an existing database, and begins a transaction that reads one state of it.
    pub(crate) async fn reading(location: &DatabaseLocation) -> Result<Self, DatabaseError> {
        let (mut connection, begin) = match &location.postgres {
            Some(address) => (Self::Postgres(postgres::connect_external(address).await?), postgres::BEGIN_SNAPSHOT),
            None => (Self::read_file(&Database::file(&location.data)).await?, "BEGIN"),
        };
        connection.command(begin).await?;
        Ok(connection)
    }

    /// Opens any database file for reading.
    pub(crate) async fn read_file(file: &Path) -> Result<Self, DatabaseError> {
        let options = SqliteConnectOptions::new().filename(file).read_only(true).disable_statement_logging();
        Ok(Self::Sqlite(options.connect().await?))
    }

    /// Errors that the engine finds in a file, and rows that refer to missing ones. PostgreSQL checks both itself.
    pub(crate) async fn integrity_errors(&mut self) -> Result<Vec<String>, DatabaseError> {
        if let Self::Postgres(_) = self {
            return Ok(Vec::new());
        }
        let mut errors: Vec<String> = query_scalar("PRAGMA integrity_check(20)").fetch_all(&mut *self).await?;
        errors.retain(|line| line != "ok");
        for row in query("PRAGMA foreign_key_check").fetch_all(self).await?.iter().take(20) {
            let (table, parent): (String, String) = (row.get("table")?, row.get("parent")?);
            errors.push(format!("a row of {table} refers to a missing row of {parent}"));
        }
        Ok(errors)
    }
}
