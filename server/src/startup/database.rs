//! Opens the farm's database; each problem has an error with its fix.

use std::time::Duration;

use crate::config::Config;
use crate::db::{Database, DatabaseError, DatabaseLocation, OpenError, Sharing};
use crate::startup::StartError;

const RESTORE_FIX: &str = "restore it from a backup, or move it away to start with an empty farm";
const MAKE_ROOM_FIX: &str = "free space on its disk";
const MAKE_WRITABLE_FIX: &str = "make it and its folder writable, or pass another folder with --data";
const UPGRADE_FIX: &str = "it may be from a newer release: run that one";
const REACH_FIX: &str = "start its server, or correct the host and port of --database";

const IN_USE_FIX: &str = "stop that server, or give another database with --database; to run several servers of one \
                          farm, start each with the same SDFARM_CLUSTER_SECRET and the same --store";

/// Attempts to use a database whose server does not answer, or ends the connection.
const ATTEMPTS: u32 = 5;
const PAUSE: Duration = Duration::from_millis(300);

/// Tries again while an error means that the connection is lost.
pub(super) async fn patiently<T, E>(
    is_lost: impl Fn(&E) -> bool,
    attempt: impl AsyncFn() -> Result<T, E>,
) -> Result<T, E> {
    for _ in 1..ATTEMPTS {
        let done = attempt().await;
        if !done.as_ref().is_err_and(&is_lost) {
            return done;
        }
        tracing::warn!("the database cannot be reached: connecting again");
        tokio::time::sleep(PAUSE).await;
    }
    attempt().await
}

/// Opens the database of a configuration, which must be the one that the data folder records.
pub(super) async fn open(config: &Config) -> Result<Database, StartError> {
    let (data, location) = (&config.data, location(config));
    let folder = |source| StartError::DataFolder { folder: data.clone(), source };
    if let Some(recorded) = location.other_record().map_err(folder)? {
        let given = location.to_string();
        return Err(StartError::OtherDatabase { folder: data.clone(), recorded, given });
    }
    let sharing = if config.cluster_secret.is_some() { Sharing::Shared } else { Sharing::Alone };
    let opened = patiently(OpenError::is_lost, async || Database::open_at(&location, sharing).await).await;
    let database = opened.map_err(|error| open_error(&location, error))?;
    location.record().map_err(folder)?;
    Ok(database)
}

/// Explains errors of the database of a configuration.
pub(super) fn explainer(config: &Config) -> impl Fn(DatabaseError) -> StartError + use<> {
    let location = location(config);
    move |error| explain(&location, &error)
}

fn location(config: &Config) -> DatabaseLocation {
    DatabaseLocation { data: config.data.clone(), postgres: config.database.clone() }
}

fn open_error(location: &DatabaseLocation, error: OpenError) -> StartError {
    let because = |reason: String, cure| StartError::Database { database: location.to_string(), reason, cure };
    match error {
        OpenError::Sql(error) | OpenError::Migrate(sqlx::migrate::MigrateError::Execute(error)) => {
            explain(location, &error.into())
        }
        OpenError::Migrate(error) => because(error.to_string(), UPGRADE_FIX),
        OpenError::Damaged(verdict) => because(format!("it is damaged ({verdict})"), RESTORE_FIX),
        error @ OpenError::OldServer(_) => because(error.to_string(), "use PostgreSQL 15 or newer"),
        error @ OpenError::Replica => because(error.to_string(), "give the address of the primary with --database"),
        error @ OpenError::InUse => because(error.to_string(), IN_USE_FIX),
    }
}

fn explain(location: &DatabaseLocation, error: &DatabaseError) -> StartError {
    let reason = match error {
        DatabaseError::Sql(error) => error.to_string(),
        DatabaseError::Rows { .. } | DatabaseError::Value { .. } | DatabaseError::Closed | DatabaseError::Taken => {
            error.to_string()
        }
    };
    let cure = if error.is_full() {
        MAKE_ROOM_FIX
    } else if error.is_corruption() {
        RESTORE_FIX
    } else if location.postgres.is_some() {
        of_postgres(error)
    } else {
        MAKE_WRITABLE_FIX
    };
    StartError::Database { database: location.to_string(), reason, cure }
}

/// Fix of an error of PostgreSQL, by its SQLSTATE: <https://www.postgresql.org/docs/current/errcodes-appendix.html>.
fn of_postgres(error: &DatabaseError) -> &'static str {
    match error.sqlstate().as_deref() {
        Some("28000" | "28P01") => {
            "correct the user and the password of --database (or PGPASSWORD, or ~/.pgpass), or let the user in by pg_hba.conf"
        }
        Some("3D000") => "create it (createdb NAME), or correct its name in --database",
        Some("42501") => "give the user of --database all rights on it (ALTER DATABASE NAME OWNER TO USER)",
        Some("42P01" | "42703") => "a table or column of it is missing: restore it from a backup (pg_restore)",
        Some("25006") => "it is read-only: give the address of the primary with --database",
        Some("08P01") => "connect without a pooler, or set the pooler up as docs/cluster.md says",
        Some("53300") => "raise max_connections of its server: each server of a farm uses 9",
        _ => REACH_FIX,
    }
}
