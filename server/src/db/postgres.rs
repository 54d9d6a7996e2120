//! A farm's database on a PostgreSQL server, version 15 or newer: opened, migrated, and connected to again after the
//! server, or the network, has failed.
//!
//! The farm's advisory locks are (1396983361, 1), which each transaction that writes holds, and (1396983361, 2), which
//! the farm's server holds as long as it is connected. The first number is `SDFA` in ASCII.

#[cfg(test)]
pub(crate) mod tests;

use std::time::Duration;

use sqlx::ConnectOptions;
use sqlx::postgres::{PgConnectOptions, PgConnection, PgPool, PgPoolOptions};

use super::{DatabaseError, OpenError, PostgresAddress};
use crate::clock::monotonic_now;

/// Begins a transaction of an occasional writer, which waits for the farm's other writers.
///
/// READ COMMITTED lets every statement see what was committed before the lock was granted.
pub(super) const BEGIN: &str = "BEGIN ISOLATION LEVEL READ COMMITTED; SELECT pg_advisory_xact_lock(1396983361, 1)";
/// Begins a transaction that only reads, and sees one state.
pub(super) const BEGIN_SNAPSHOT: &str = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY";
/// Begins a transaction of the farm's server, with the number that tells later whether it was committed, and its first
/// operation's savepoint.
pub(super) const BEGIN_GROUP: &str =
    "BEGIN ISOLATION LEVEL READ COMMITTED; SELECT pg_advisory_xact_lock(1396983361, 1);
     SELECT CAST(pg_current_xact_id() AS TEXT); SAVEPOINT operation";
/// The same for operations that need not survive a power cut.
pub(super) const BEGIN_RELAXED_GROUP: &str =
    "BEGIN ISOLATION LEVEL READ COMMITTED; SET LOCAL synchronous_commit = off; SELECT pg_advisory_xact_lock(1396983361, 1);
     SELECT CAST(pg_current_xact_id() AS TEXT); SAVEPOINT operation";

/// Number of reading connections.
const READER_CONNECTIONS: u32 = 8;
/// Statements that a connection keeps prepared: all of the program's.
const PREPARED_STATEMENTS: usize = 512;
/// Oldest version, as `server_version_num` gives it.
const OLDEST_VERSION: i32 = 150_000;
/// A server that has failed is asked again for this long; then operations fail.
const PATIENCE: Duration = Duration::from_secs(30);
/// Time for the database's server to notice that the farm's last server is gone.
const LOCK_PATIENCE: Duration = Duration::from_secs(2);
/// A read waits for this long; a client that is told to retry waits better than a request.
const READ_PATIENCE: Duration = Duration::from_secs(3);
const PAUSE: Duration = Duration::from_millis(100);
/// Time for a connection to be made.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// Ends a connection within half a minute of its client's machine, or of the network, and so frees its locks.
const KEEP_ALIVE: [(&str, &str); 4] = [
    ("tcp_keepalives_idle", "10"),
    ("tcp_keepalives_interval", "5"),
    ("tcp_keepalives_count", "3"),
    ("tcp_user_timeout", "30000"),
];

pub(super) static MIGRATIONS: sqlx::migrate::Migrator = sqlx::migrate!("../migrations/postgres");

/// The connection of the farm's server that writes. It holds the farm's lock, so that a database has one server.
#[derive(Debug)]
pub(super) struct Session {
    options: PgConnectOptions,
    /// Number of the current transaction.
    transaction: Option<String>,
}

/// Opens a database and applies pending migrations.
pub(super) async fn open(address: &PostgresAddress) -> Result<(PgConnection, Session, PgPool), OpenError> {
    let options = address.options().clone().statement_cache_capacity(PREPARED_STATEMENTS).options(KEEP_ALIVE);
    let mut connection = connect(&options).await?;
    let version: i32 = sqlx::query_scalar("SELECT CAST(current_setting('server_version_num') AS INTEGER)")
        .fetch_one(&mut connection)
        .await?;
    if version < OLDEST_VERSION {
        return Err(OpenError::OldServer(version / 10_000));
    }
    if sqlx::query_scalar("SELECT pg_is_in_recovery()").fetch_one(&mut connection).await? {
        return Err(OpenError::Replica);
    }
    // The process of a server that was killed may not have noticed yet that its client is gone.
    let deadline = monotonic_now() + LOCK_PATIENCE;
    while !lock_farm(&mut connection).await? {
        if monotonic_now() > deadline {
            return Err(OpenError::InUse);
        }
        tokio::time::sleep(PAUSE).await;
    }
    MIGRATIONS.run(&mut connection).await?;
    let readers = PgPoolOptions::new()
        .max_connections(READER_CONNECTIONS)
        .acquire_timeout(READ_PATIENCE)
        .connect_lazy_with(options.clone());
    Ok((connection, Session { options, transaction: None }, readers))
}

/// Connects for an occasional write beside the farm's server; changes no tables.
pub(super) async fn connect_external(address: &PostgresAddress) -> Result<PgConnection, DatabaseError> {
    Ok(connect(address.options()).await?)
}

async fn connect(options: &PgConnectOptions) -> Result<PgConnection, sqlx::Error> {
    let connecting = tokio::time::timeout(CONNECT_TIMEOUT, options.connect());
    connecting.await.unwrap_or_else(|_| Err(sqlx::Error::Io(std::io::ErrorKind::TimedOut.into())))
}

/// Takes the lock of the farm's server for as long as the connection lives; false if another one has it.
async fn lock_farm(connection: &mut PgConnection) -> Result<bool, sqlx::Error> {
    sqlx::query_scalar("SELECT pg_try_advisory_lock(1396983361, 2)").fetch_one(connection).await
}

impl Session {
    /// Begins a transaction, on a new connection if the old one has ended.
    pub(super) async fn begin(
        &mut self,
        connection: &mut PgConnection,
        text: &'static str,
    ) -> Result<(), DatabaseError> {
        self.transaction = None;
        let begun = match sqlx::raw_sql(text).fetch_all(&mut *connection).await {
            Err(error) if is_lost(&error) => {
                self.reconnect(connection).await?;
                sqlx::raw_sql(text).fetch_all(connection).await
            }
            begun => begun,
        };
        let rows = begun?;
        let number = rows.last().ok_or(sqlx::Error::RowNotFound)?;
        self.transaction = Some(sqlx::Row::try_get(number, 0)?);
        Ok(())
    }

    /// Commits. If the connection ends meanwhile, the database is asked whether it has committed.
    pub(super) async fn commit(&mut self, connection: &mut PgConnection) -> Result<(), DatabaseError> {
        // In a transaction that has failed, COMMIT alone would roll back and report success.
        match sqlx::raw_sql("RELEASE operation; COMMIT").execute(&mut *connection).await {
            Err(error) if is_lost(&error) => {
                self.reconnect(connection).await?;
                if self.has_committed(connection).await? { Ok(()) } else { Err(error.into()) }
            }
            committed => Ok(committed.map(drop)?),
        }
    }

    /// Whether the transaction whose commit was not answered is committed.
    async fn has_committed(&self, connection: &mut PgConnection) -> Result<bool, DatabaseError> {
        let deadline = monotonic_now() + PATIENCE;
        loop {
            let status: Option<String> = sqlx::query_scalar("SELECT pg_xact_status(CAST($1 AS xid8))")
                .bind(&self.transaction)
                .fetch_one(&mut *connection)
                .await?;
            // The old connection's process may not have noticed yet that its client is gone.
            if status.as_deref() != Some("in progress") || monotonic_now() > deadline {
                return Ok(status.as_deref() == Some("committed"));
            }
            tokio::time::sleep(PAUSE).await;
        }
    }

    /// Replaces a connection that has ended, and takes the farm's lock again.
    async fn reconnect(&self, connection: &mut PgConnection) -> Result<(), DatabaseError> {
        tracing::warn!("the connection to the database has ended: connecting again");
        let deadline = monotonic_now() + PATIENCE;
        loop {
            let attempt = async {
                let mut new = connect(&self.options).await?;
                Ok(lock_farm(&mut new).await?.then_some(new))
            };
            let last: Result<Option<PgConnection>, sqlx::Error> = attempt.await;
            match last {
                Ok(Some(new)) => {
                    *connection = new;
                    return Ok(());
                }
                Ok(None) if monotonic_now() > deadline => return Err(DatabaseError::Taken),
                Err(error) if monotonic_now() > deadline => return Err(error.into()),
                Ok(None) | Err(_) => tokio::time::sleep(PAUSE).await,
            }
        }
    }
}

/// Whether an error means that the connection has ended, or that none could be made.
pub(super) fn is_lost(error: &sqlx::Error) -> bool {
    match error {
        sqlx::Error::Io(_) | sqlx::Error::Tls(_) | sqlx::Error::Protocol(_) | sqlx::Error::PoolTimedOut => true,
        // Connection exceptions, shutdowns, a server that starts, too many connections.
        sqlx::Error::Database(error) => error.code().is_some_and(|code| {
            code.starts_with("08") || ["57P01", "57P02", "57P03", "57P05", "53300"].contains(&&*code)
        }),
        _ => false,
    }
}
