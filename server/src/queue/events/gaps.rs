//! Numbers of events that a restored database skips.
//!
//! Clients may have received events that a restore has undone. The numbers of those must not be given again, because a
//! client that goes on after one of them would miss the new event with that number. A new epoch therefore begins at the
//! next multiple of 2^32. A client that goes on after a number in the gap gets a snapshot.

use crate::db;
use crate::queue::{Connection, Result};

/// Binary digits of an event's number within its epoch.
const EPOCH_BITS: u32 = 32;

/// Has the next server of a restored database begin an epoch. The database may be that of an older release.
pub(crate) async fn mark_restored(connection: &mut Connection) -> Result<()> {
    db::query("INSERT INTO meta (name, value) VALUES ('restored', 1) ON CONFLICT DO NOTHING")
        .execute(connection)
        .await?;
    Ok(())
}

/// Begins an epoch if a server starts on a restored database.
pub(in crate::queue) async fn check_restored(connection: &mut Connection) -> Result<()> {
    let marks = db::query("DELETE FROM meta WHERE name = 'restored'").execute(&mut *connection).await?;
    if marks.rows_affected() > 0 { begin_epoch(connection).await } else { Ok(()) }
}

/// Begins an epoch if the database is not the one that it was.
pub(in crate::queue) async fn check_identity(connection: &mut Connection) -> Result<()> {
    let Some(identity) = connection.identity().await? else { return Ok(()) };
    let known: Option<i64> = db::query_scalar("SELECT value FROM meta WHERE name = 'database_identity'")
        .fetch_optional(&mut *connection)
        .await?;
    if known == Some(identity) {
        return Ok(());
    }
    if known.is_some() {
        tracing::warn!("the database was restored, or its server replaced: clients of events may get a snapshot");
        begin_epoch(connection).await?;
    }
    db::query(
        "INSERT INTO meta (name, value) VALUES ('database_identity', ?)
         ON CONFLICT (name) DO UPDATE SET value = excluded.value",
    )
    .bind(identity)
    .execute(connection)
    .await?;
    Ok(())
}

/// Skips all numbers up to the next epoch.
async fn begin_epoch(connection: &mut Connection) -> Result<()> {
    let newest: i64 = db::query_scalar(
        "SELECT @max((SELECT coalesce(max(number), 0) FROM outbox), (SELECT coalesce(max(events_pruned), 0) FROM job))",
    )
    .fetch_one(&mut *connection)
    .await?;
    let next = ((newest >> EPOCH_BITS) + 1) << EPOCH_BITS;
    db::query("INSERT INTO event_gap (after_number, next_number) VALUES (?, ?) ON CONFLICT DO NOTHING")
        .bind(newest)
        .bind(next)
        .execute(&mut *connection)
        .await?;
    connection.number_after("outbox", "number", next - 1).await
}
