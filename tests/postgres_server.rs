//! Databases for tests on the PostgreSQL server that `tests/on_postgres` starts; without it there are none, and the tests
//! use files.

use std::path::Path;
use std::process::Command;

use crate::skip::skip;

/// Address of the server.
pub(crate) fn server() -> Option<String> {
    std::env::var("SDFARM_TEST_DATABASE").ok()
}

/// Address of the server; without it, the test is skipped.
pub(crate) fn required() -> Option<String> {
    let address = server();
    if address.is_none() {
        skip("on-postgres", "there is no PostgreSQL server for the tests: run them by tests/on_postgres");
    }
    address
}

/// Runs SQL on the database at an address; returns what it prints.
pub(crate) fn psql(address: &str, text: &str) -> String {
    let mut psql = Command::new("psql");
    let output = psql.args(["--no-psqlrc", "--tuples-only", "--no-align", "--quiet", "-c", text, address]).output();
    let output = output.expect("psql runs");
    assert!(output.status.success(), "{text}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).trim().to_owned()
}

/// Ends all connections of farms to the database at an address; returns how many there were.
pub(crate) fn cut_connections(address: &str) -> u32 {
    let cut = "SELECT count(pg_terminate_backend(pid)) FROM pg_stat_activity
               WHERE datname = current_database() AND application_name = 'sdfarm'";
    psql(address, cut).parse().expect("a number")
}

/// Address of the database of a data folder, which is made if there is none yet.
pub(crate) fn database_of(data: &Path) -> Option<String> {
    let server = server()?;
    let name = format!("test_{}", &blake3::hash(data.as_os_str().as_encoded_bytes()).to_hex()[..24]);
    let made = Command::new("createdb").arg("--maintenance-db").arg(format!("{server}/postgres")).arg(&name).output();
    let made = made.expect("createdb runs");
    let error = String::from_utf8_lossy(&made.stderr);
    assert!(made.status.success() || error.contains("already exists"), "{error}");
    Some(format!("{server}/{name}"))
}
