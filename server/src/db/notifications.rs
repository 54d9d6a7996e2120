//! Short messages between the servers of one PostgreSQL database, by NOTIFY. They may be lost: a listener that connects
//! again misses those in between.

use sqlx::postgres::{PgListener, PgPool};

use super::DatabaseError;

/// Channel of the farm's servers.
const CHANNEL: &str = "sdfarm";

/// Sends messages.
#[derive(Clone, Debug)]
pub(crate) struct Notifications(PgPool);

/// Receives messages, its own server's too.
#[derive(Debug)]
pub(crate) struct Listener(PgListener);

impl Notifications {
    pub(super) fn new(pool: PgPool) -> Self {
        Self(pool)
    }

    /// Sends a message to all servers.
    pub(crate) async fn send(&self, message: &str) -> Result<(), DatabaseError> {
        sqlx::query("SELECT pg_notify($1, $2)").bind(CHANNEL).bind(message).execute(&self.0).await?;
        Ok(())
    }

    /// Listens from now on.
    pub(crate) async fn listen(&self) -> Result<Listener, DatabaseError> {
        let mut listener = PgListener::connect_with(&self.0).await?;
        listener.listen(CHANNEL).await?;
        Ok(Listener(listener))
    }
}

impl Listener {
    /// The next message; `None` after the connection was lost, which is then made again.
    pub(crate) async fn next(&mut self) -> Result<Option<String>, DatabaseError> {
        Ok(self.0.try_recv().await?.map(|notification| notification.payload().to_owned()))
    }
}
