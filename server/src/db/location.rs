//! Where a farm's database is: in the data folder, or on a PostgreSQL server that `--database` names.

use std::fmt;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

use sqlx::ConnectOptions;
use sqlx::postgres::PgConnectOptions;

use super::Database;
use crate::private_files;

/// File in a data folder that records the address of its farm's database; there is none if that is in the folder.
const RECORD_FILE: &str = "database";

/// Place of a farm's database.
#[derive(Clone, Debug)]
pub(crate) struct DatabaseLocation {
    /// The data folder.
    pub(crate) data: PathBuf,
    /// Address of the database, unless it is in the data folder.
    pub(crate) postgres: Option<PostgresAddress>,
}

impl DatabaseLocation {
    /// Place that a data folder records. Its address has no password.
    pub(crate) fn of_folder(data: &Path) -> io::Result<Self> {
        let postgres = recorded(data)?.map(|text| text.parse());
        let postgres = postgres.transpose().map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))?;
        Ok(Self { data: data.to_owned(), postgres })
    }

    /// Database that the data folder records, if it is not this one.
    pub(crate) fn other_record(&self) -> io::Result<Option<String>> {
        let recorded = recorded(&self.data)?;
        let file = Database::file(&self.data);
        Ok(match (recorded, &self.postgres) {
            (Some(recorded), Some(address)) if recorded == address.to_string() => None,
            (None, Some(_)) if file.exists() => Some(file.display().to_string()),
            (None, _) => None,
            (Some(recorded), _) => Some(recorded),
        })
    }

    /// Removes the record of the data folder, so that its database is the file in it.
    pub(crate) fn forget(&self) -> io::Result<()> {
        std::fs::remove_file(self.data.join(RECORD_FILE))
    }

    /// Records it in the data folder.
    pub(crate) fn record(&self) -> io::Result<()> {
        let (Some(address), file) = (&self.postgres, self.data.join(RECORD_FILE)) else { return Ok(()) };
        if file.exists() {
            return Ok(());
        }
        let part = self.data.join("database.part");
        let mut written = private_files::create_file(&part)?;
        writeln!(written, "{address}")?;
        written.sync_all()?;
        std::fs::rename(part, file)
    }
}

/// Address that a data folder records.
fn recorded(data: &Path) -> io::Result<Option<String>> {
    match std::fs::read_to_string(data.join(RECORD_FILE)) {
        Ok(text) => Ok(Some(text.trim().to_owned())),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

impl fmt::Display for DatabaseLocation {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.postgres {
            Some(address) => address.fmt(formatter),
            None => Database::file(&self.data).display().fmt(formatter),
        }
    }
}

/// Address of a database on a PostgreSQL server. Texts of it leave the password out.
#[derive(Clone)]
pub struct PostgresAddress {
    options: Arc<PgConnectOptions>,
    /// As `postgres://USER@HOST:PORT/DATABASE`.
    shown: String,
}

/// Error returned when text names no database.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0}: write postgres://USER:PASSWORD@HOST:PORT/DATABASE, such as postgres://farm@db.example/sdfarm; the password may \
     also be in PGPASSWORD or ~/.pgpass; without it, the database is a file in the data folder"
)]
pub struct ParseDatabaseError(String);

impl FromStr for PostgresAddress {
    type Err = ParseDatabaseError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        if !["postgres://", "postgresql://"].iter().any(|scheme| text.starts_with(scheme)) {
            return Err(ParseDatabaseError("this is no address of a PostgreSQL database".to_owned()));
        }
        let options: PgConnectOptions =
            text.parse().map_err(|error| ParseDatabaseError(format!("this address cannot be read ({error})")))?;
        let Some(database) = options.get_database().filter(|name| !name.is_empty()) else {
            return Err(ParseDatabaseError("this address names no database".to_owned()));
        };
        let host =
            options.get_socket().map_or_else(|| options.get_host().to_owned(), |path| path.display().to_string());
        let shown = format!("postgres://{}@{host}:{}/{database}", options.get_username(), options.get_port());
        Ok(Self {
            options: Arc::new(options.application_name("sdfarm").options(PLANNER).disable_statement_logging()),
            shown,
        })
    }
}

/// Settings of the planner: every statement finds its rows by an index, as on a file, where a test checks it. Without
/// them the planner reads whole tables, because a plan is made while they are small, and kept as they grow.
const PLANNER: [(&str, &str); 5] = [
    ("enable_seqscan", "off"),
    ("enable_bitmapscan", "off"),
    ("enable_hashjoin", "off"),
    ("enable_mergejoin", "off"),
    ("jit", "off"),
];

impl PostgresAddress {
    /// Options of a connection.
    pub(super) fn options(&self) -> &PgConnectOptions {
        &self.options
    }
}

impl fmt::Display for PostgresAddress {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.shown)
    }
}

impl fmt::Debug for PostgresAddress {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.shown)
    }
}

impl PartialEq for PostgresAddress {
    fn eq(&self, other: &Self) -> bool {
        self.shown == other.shown
    }
}

impl Eq for PostgresAddress {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_never_shows_its_password() {
        let address: PostgresAddress = "postgres://farm:se%40cret@db.example:5433/sdfarm".parse().expect("parses");
        assert_eq!(address.to_string(), "postgres://farm@db.example:5433/sdfarm");
        assert_eq!(format!("{address:?}"), address.to_string());
    }

    #[test]
    fn wrong_addresses_name_the_cure() {
        for (text, part) in [
            ("mysql://x/y", "no address of a PostgreSQL database"),
            ("postgres://farm@db.example", "names no database"),
            ("postgres://farm@db.example:port/x", "cannot be read"),
        ] {
            let error = text.parse::<PostgresAddress>().expect_err(text).to_string();
            assert!(error.contains(part) && error.contains("write postgres://"), "{error}");
        }
    }
}
