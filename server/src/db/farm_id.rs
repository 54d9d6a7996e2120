//! Which farm a database is of: a random number that is made once, and goes with its rows when they are moved.

use std::fmt;

use super::{Database, DatabaseError, Durability, query, query_scalar};

/// Number of a farm. Servers that share a database are of one farm, and so is a restored copy of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct FarmId(i64);

impl FarmId {
    /// The farm with this number.
    pub(crate) fn new(number: i64) -> Self {
        Self(number)
    }

    /// Number of a new farm.
    pub(crate) fn random() -> Self {
        // The upper half has the digits that tell the version.
        Self(uuid::Uuid::new_v4().as_u64_pair().1.cast_signed() & i64::MAX)
    }
}

impl fmt::Display for FarmId {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{:016x}", self.0)
    }
}

impl Database {
    /// The farm of this database, which becomes one if it is new.
    pub(crate) async fn farm_id(&self) -> Result<FarmId, DatabaseError> {
        let FarmId(made) = FarmId::random();
        self.write(Durability::Full, move |connection| {
            Box::pin(async move {
                let insert =
                    query("INSERT INTO meta (name, value) VALUES ('farm_id', ?) ON CONFLICT (name) DO NOTHING");
                insert.bind(made).execute(&mut *connection).await?;
                let id = query_scalar("SELECT value FROM meta WHERE name = 'farm_id'").fetch_one(connection).await?;
                Ok(FarmId(id))
            })
        })
        .await
    }
}
