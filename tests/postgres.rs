//! Databases for tests on the PostgreSQL server that `tests/on_postgres` starts; without it there are none, and the tests
//! use files.

use std::path::Path;
use std::process::Command;

/// Address of the server.
pub(crate) fn server() -> Option<String> {
    std::env::var("SDFARM_TEST_DATABASE").ok()
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
