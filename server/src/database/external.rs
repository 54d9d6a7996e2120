//! Database connection for other processes than the server, which may be running: it changes no tables.

use std::path::Path;
use std::time::Duration;

use sqlx::ConnectOptions;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection, SqliteJournalMode, SqliteSynchronous};

use super::Database;

impl Database {
    /// Connects to an existing database; waits at most `patience` for another process's write.
    pub(crate) async fn connect_external(data: &Path, patience: Duration) -> Result<SqliteConnection, sqlx::Error> {
        SqliteConnectOptions::new()
            .filename(Self::file(data))
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            .foreign_keys(true)
            .busy_timeout(patience)
            .disable_statement_logging()
            .connect()
            .await
    }
}
