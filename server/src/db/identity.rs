//! Which database this is: another one has the same rows after a restore, and goes on differently.

use super::{Connection, DatabaseError, query_scalar};

impl Connection {
    /// Number of this database, which changes if it is restored into another one, or to an earlier state by its WAL, or if
    /// a replica takes over. A file has none: `sdfarm restore` knows when it is restored.
    pub(crate) async fn identity(&mut self) -> Result<Option<i64>, DatabaseError> {
        if let Self::Sqlite(_) = self {
            return Ok(None);
        }
        // The name of a WAL segment begins with its timeline.
        let identity = query_scalar(
            "SELECT hashtextextended(
                 (SELECT CAST(system_identifier AS TEXT) FROM pg_control_system()) || ' ' ||
                 (SELECT CAST(oid AS TEXT) FROM pg_database WHERE datname = current_database()) || ' ' ||
                 left(pg_walfile_name(pg_current_wal_lsn()), 8), 0)",
        );
        identity.fetch_optional(self).await
    }
}
