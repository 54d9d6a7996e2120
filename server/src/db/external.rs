//! Database connection for other processes than the server, which may be running: it changes no tables.

use std::path::Path;
use std::time::Duration;

use sqlx::ConnectOptions;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqliteSynchronous};

use super::{Connection, Database, DatabaseError};

impl Database {
    /// Connects to an existing database; waits at most `patience` for another process's write.
    pub(crate) async fn connect_external(data: &Path, patience: Duration) -> Result<Connection, DatabaseError> {
        let connection = SqliteConnectOptions::new()
            .filename(Self::file(data))
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            .foreign_keys(true)
            .busy_timeout(patience)
            .disable_statement_logging()
            .connect()
            .await?;
        Ok(Connection(connection))
    }
}

impl Connection {
    /// Opens any database file for reading.
    pub(crate) async fn read_file(file: &Path) -> Result<Self, DatabaseError> {
        let options = SqliteConnectOptions::new().filename(file).read_only(true).disable_statement_logging();
        Ok(Self(options.connect().await?))
    }
}
