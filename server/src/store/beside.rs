//! A connection of another process than the server's, which may be running: it changes no tables.

use std::path::Path;
use std::time::Duration;

use sqlx::ConnectOptions;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection, SqliteJournalMode, SqliteSynchronous};

use super::Store;

impl Store {
    /// Connects to the database of a data folder, which has to be there; a writer is waited for so long.
    pub(crate) async fn connect_beside(data: &Path, patience: Duration) -> Result<SqliteConnection, sqlx::Error> {
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
