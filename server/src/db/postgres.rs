//! A farm's database on a PostgreSQL server, version 15 or newer: opened, migrated, and connected to again after the
//! server, or the network, has failed.
//!
//! The farm's advisory locks are (1396983361, 1), which each transaction that writes holds, and (1396983361, 2), which
//! each of the farm's servers holds as long as it is connected. The first number is `SDFA` in ASCII.

#[cfg(test)]
pub(crate) mod tests;

use std::sync::Arc;
use std::time::Duration;

use prometheus_client::metrics::counter::Counter;
use sqlx::postgres::{PgConnectOptions, PgConnection, PgPool, PgPoolOptions, PgRow};
use sqlx::{ConnectOptions, Row as _};

use super::{DatabaseError, OpenError, PostgresAddress, migrations};
use crate::clock::{FarmTime, TimeReading, monotonic_now};

/// Columns of a [`TimeReading`], as texts.
macro_rules! time_columns {
    () => {
        "CAST(floor(extract(epoch FROM clock_timestamp()) * 1000) AS TEXT),
         (SELECT CAST(value AS TEXT) FROM meta WHERE name = 'clock_offset_ms')"
    };
}

macro_rules! group_start {
    () => {
        concat!(
            "SELECT pg_advisory_xact_lock(1396983361, 1); SELECT CAST(pg_current_xact_id() AS TEXT), ",
            time_columns!(),
            "; SAVEPOINT operation"
        )
    };
}

/// Begins a transaction of an occasional writer, which waits for the farm's other writers.
///
/// READ COMMITTED lets every statement see what was committed before the lock was granted.
pub(super) const BEGIN: &str = "BEGIN ISOLATION LEVEL READ COMMITTED; SELECT pg_advisory_xact_lock(1396983361, 1)";
/// Begins a transaction that only reads, and sees one state.
pub(super) const BEGIN_SNAPSHOT: &str = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY";
/// Begins a transaction of a farm's server, and its first operation's savepoint. It reads the number that tells later
/// whether it was committed, and the time after the lock was granted.
pub(super) const BEGIN_GROUP: &str = concat!("BEGIN ISOLATION LEVEL READ COMMITTED; ", group_start!());
/// The same for operations that need not survive a power cut.
pub(super) const BEGIN_RELAXED_GROUP: &str =
    concat!("BEGIN ISOLATION LEVEL READ COMMITTED; SET LOCAL synchronous_commit = off; ", group_start!());

/// Number of reading connections.
const READER_CONNECTIONS: u32 = 8;
/// Statements that a connection keeps prepared: all of the program's.
const PREPARED_STATEMENTS: usize = 512;
/// Oldest version, as `server_version_num` gives it.
const OLDEST_VERSION: i32 = 150_000;
/// A server that has failed is asked again for this long; then operations fail.
const RECONNECT_TIMEOUT: Duration = Duration::from_secs(30);
/// Time for the database's server to notice that the farm's last server is gone.
const LOCK_TIMEOUT: Duration = Duration::from_secs(2);
/// A read waits for this long; a client that retries waits better than a request.
const READ_TIMEOUT: Duration = Duration::from_secs(3);
const PAUSE: Duration = Duration::from_millis(100);
/// An answer that takes longer does not come: the server's machine, or the network, is gone.
pub(super) const ANSWER_TIMEOUT: Duration = Duration::from_secs(30);
/// Time for a connection to be made.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// Settings of a connection. It ends within half a minute of its client's machine, or of the network, and ten seconds after
/// its client has stopped in the middle of a transaction: both free its locks.
const SETTINGS: [(&str, &str); 5] = [
    ("idle_in_transaction_session_timeout", "10000"),
    ("tcp_keepalives_idle", "10"),
    ("tcp_keepalives_interval", "5"),
    ("tcp_keepalives_count", "3"),
    ("tcp_user_timeout", "30000"),
];

/// How a server uses a database.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sharing {
    /// It is the only one.
    Alone,
    /// Other servers of the farm may use it at the same time.
    Shared,
}

/// The connection of a farm's server that writes. It holds the farm's lock.
#[derive(Debug)]
pub(super) struct Session {
    options: PgConnectOptions,
    sharing: Sharing,
    time: Arc<FarmTime>,
    connections_lost: Counter,
    /// Number of the current transaction.
    transaction: Option<String>,
}

/// An opened database.
pub(super) struct OpenedDatabase {
    pub(super) connection: PgConnection,
    pub(super) session: Session,
    pub(super) readers: PgPool,
    pub(super) time: Arc<FarmTime>,
}

/// Opens a database and applies pending migrations.
pub(super) async fn open(
    address: &PostgresAddress,
    sharing: Sharing,
    connections_lost: Counter,
) -> Result<OpenedDatabase, OpenError> {
    let options = address.options().clone().statement_cache_capacity(PREPARED_STATEMENTS).options(SETTINGS);
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
    let deadline = monotonic_now() + LOCK_TIMEOUT;
    while !lock_farm(&mut connection, sharing).await? {
        if monotonic_now() > deadline {
            return Err(OpenError::InUse);
        }
        tokio::time::sleep(PAUSE).await;
    }
    migrations::POSTGRES.run(&mut connection).await?;
    let read = sqlx::raw_sql(concat!("SELECT ", time_columns!())).fetch_one(&mut connection).await?;
    let time = Arc::new(FarmTime::new(time_reading(&read, 0)?));
    let readers = PgPoolOptions::new()
        .max_connections(READER_CONNECTIONS)
        .acquire_timeout(READ_TIMEOUT)
        .connect_lazy_with(options.clone());
    let session = Session { options, sharing, time: Arc::clone(&time), connections_lost, transaction: None };
    Ok(OpenedDatabase { connection, session, readers, time })
}

/// Reads the columns of a reading, from this one on.
fn time_reading(row: &PgRow, first: usize) -> Result<TimeReading, sqlx::Error> {
    let number = |column: usize| {
        let text: String = row.try_get(column)?;
        text.parse::<i64>()
            .map_err(|error| sqlx::Error::ColumnDecode { index: column.to_string(), source: error.into() })
    };
    Ok(TimeReading { clock_ms: number(first)?, offset_ms: number(first + 1)? })
}

/// Connects for an occasional write beside the farm's server; changes no tables.
pub(super) async fn connect_external(address: &PostgresAddress) -> Result<PgConnection, DatabaseError> {
    Ok(connect(address.options()).await?)
}

async fn connect(options: &PgConnectOptions) -> Result<PgConnection, sqlx::Error> {
    let connecting = tokio::time::timeout(CONNECT_TIMEOUT, options.connect());
    connecting.await.unwrap_or_else(|_| Err(sqlx::Error::Io(std::io::ErrorKind::TimedOut.into())))
}

/// Takes the lock of the farm's servers for as long as the connection lives; false if another one excludes it.
async fn lock_farm(connection: &mut PgConnection, sharing: Sharing) -> Result<bool, sqlx::Error> {
    let text = match sharing {
        Sharing::Alone => "SELECT pg_try_advisory_lock(1396983361, 2)",
        Sharing::Shared => "SELECT pg_try_advisory_lock_shared(1396983361, 2)",
    };
    sqlx::query_scalar(text).fetch_one(connection).await
}

impl Session {
    /// Begins a transaction, on a new connection if the old one has ended.
    pub(super) async fn begin(
        &mut self,
        connection: &mut PgConnection,
        text: &'static str,
    ) -> Result<(), DatabaseError> {
        self.transaction = None;
        let begun = match answered(sqlx::raw_sql(text).fetch_all(&mut *connection)).await {
            Err(error) if is_lost(&error) => {
                self.reconnect(connection).await?;
                answered(sqlx::raw_sql(text).fetch_all(&mut *connection)).await
            }
            begun => begun,
        };
        let rows = begun?;
        let started = rows.last().ok_or(sqlx::Error::RowNotFound)?;
        self.transaction = Some(started.try_get(0)?);
        if let Some(offset_ms) = self.time.take(time_reading(started, 1)?) {
            sqlx::query("UPDATE meta SET value = $1 WHERE name = 'clock_offset_ms'")
                .bind(offset_ms)
                .execute(connection)
                .await?;
        }
        Ok(())
    }

    /// Commits. If the connection ends meanwhile, the database is asked whether it has committed.
    pub(super) async fn commit(&mut self, connection: &mut PgConnection) -> Result<(), DatabaseError> {
        // In a transaction that has failed, COMMIT alone would roll back and report success.
        match answered(sqlx::raw_sql("RELEASE operation; COMMIT").execute(&mut *connection)).await {
            Err(error) if is_lost(&error) => {
                self.reconnect(connection).await?;
                if self.has_committed(connection).await? { Ok(()) } else { Err(error.into()) }
            }
            committed => Ok(committed.map(drop)?),
        }
    }

    /// Whether the transaction whose commit was not answered is committed.
    async fn has_committed(&self, connection: &mut PgConnection) -> Result<bool, DatabaseError> {
        let deadline = monotonic_now() + RECONNECT_TIMEOUT;
        loop {
            let status = sqlx::query_scalar("SELECT pg_xact_status(CAST($1 AS xid8))").bind(&self.transaction);
            let status: Option<String> = answered(status.fetch_one(&mut *connection)).await?;
            // The old connection's process may not have noticed yet that its client is gone.
            if status.as_deref() != Some("in progress") || monotonic_now() > deadline {
                return Ok(status.as_deref() == Some("committed"));
            }
            tokio::time::sleep(PAUSE).await;
        }
    }

    /// Replaces a connection that has ended, and takes the farm's lock again.
    pub(super) async fn reconnect(&self, connection: &mut PgConnection) -> Result<(), DatabaseError> {
        tracing::warn!("the connection to the database has ended: connecting again");
        self.connections_lost.inc();
        let deadline = monotonic_now() + RECONNECT_TIMEOUT;
        loop {
            let attempt = async {
                let mut new = connect(&self.options).await?;
                Ok(answered(lock_farm(&mut new, self.sharing)).await?.then_some(new))
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

/// Waits for an answer of the server.
async fn answered<T>(answer: impl Future<Output = Result<T, sqlx::Error>>) -> Result<T, sqlx::Error> {
    let answer = tokio::time::timeout(ANSWER_TIMEOUT, answer).await;
    answer.unwrap_or_else(|_| Err(sqlx::Error::Io(std::io::ErrorKind::TimedOut.into())))
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
