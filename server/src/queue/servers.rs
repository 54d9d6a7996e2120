//! Servers of the database: each renews its row, and hands back what the pools of those held that have ended.
//!
//! A server that is taken for ended by mistake loses nothing but the work that its pool has begun: its workers register
//! again.

pub(super) mod contact;
pub(super) mod doomed;
pub(super) mod recover;
pub(super) mod repair;
pub(super) mod stats;

use crate::db;
use crate::db::Durability;
use crate::queue::events::gaps;
use crate::queue::leases::{claim, ends};
use crate::queue::servers::recover::StartingServer;
use crate::queue::{Connection, Queue, Result, TransitionContext, Wake, json_numbers, row_count, verification};

/// A server that has not renewed its row for this long has ended.
pub(super) const SERVER_GONE_MS: i64 = 6_000;

impl Queue {
    /// Renews this server's row, and returns the number of others. If contact with the database is steady, the rows of
    /// servers that have ended are deleted, and the leases of their pools handed back. From the first renewal on, leases
    /// expire only if contact is steady.
    pub(crate) async fn renew_server(&self) -> Result<i64> {
        let others = self.renew_server_if(self.contact.is_steady()).await?;
        self.contact.renew();
        Ok(others)
    }

    /// Renews this server's row, and if `judges`, ends what servers have left that do not.
    pub(super) async fn renew_server_if(&self, judges: bool) -> Result<i64> {
        let (context, name) = (self.context(), self.server_name.clone());
        let (others, wake) = self
            .database
            .write_for_worker(Durability::Relaxed, move |connection| {
                Box::pin(async move { renew(connection, &name, judges, context).await })
            })
            .await?;
        self.wake(wake);
        Ok(others)
    }

    /// Removes the row of this server, whose pool has ended.
    pub(crate) async fn end_server(&self) -> Result<()> {
        let generation = self.generation;
        self.database
            .write(Durability::Relaxed, move |connection| {
                Box::pin(async move {
                    db::query("DELETE FROM server WHERE generation = ?").bind(generation).execute(connection).await?;
                    Ok(())
                })
            })
            .await
    }

    /// Whether there is work that some worker could claim.
    pub(crate) async fn has_claimable_work(&self) -> Result<bool> {
        Ok(!self.is_paused().await? && claim::has_work(self.readers(), self.clock.now_ms()).await?)
    }

    /// Records the fingerprint of the secret that the farm's servers share; false if others that run have another secret.
    pub(crate) async fn agrees_on_secret(&self, fingerprint: i64) -> Result<bool> {
        let generation = self.generation;
        self.database
            .write(Durability::Full, move |connection| {
                Box::pin(async move { agree_on_secret(connection, fingerprint, generation).await })
            })
            .await
    }

    /// Generation of this server, which no other one has.
    pub(crate) fn generation(&self) -> i64 {
        self.generation
    }
}

/// Replaces the rows of servers that have ended, and of the last one with this name, by that of a server that starts;
/// returns the number of others.
pub(super) async fn begin(connection: &mut Connection, start: &StartingServer, generation: i64) -> Result<i64> {
    db::query("DELETE FROM server WHERE name = ? OR seen_ms < ? OR ? = 0")
        .bind(&start.name)
        .bind(start.now_ms - SERVER_GONE_MS)
        .bind(start.may_have_others)
        .execute(&mut *connection)
        .await?;
    let others = db::query_scalar("SELECT count(*) FROM server").fetch_one(&mut *connection).await?;
    db::query("INSERT INTO server (generation, name, started_at_ms, seen_ms) VALUES (?, ?, ?, ?)")
        .bind(generation)
        .bind(&start.name)
        .bind(start.wall_ms)
        .bind(start.now_ms)
        .execute(connection)
        .await?;
    Ok(others)
}

async fn renew(
    connection: &mut Connection,
    name: &str,
    judges: bool,
    context: TransitionContext,
) -> Result<(i64, Wake)> {
    let renewed = db::query("UPDATE server SET seen_ms = ? WHERE generation = ?")
        .bind(context.now_ms)
        .bind(context.generation)
        .execute(&mut *connection)
        .await?;
    if renewed.rows_affected() == 0 {
        tracing::warn!("this server was taken for ended, because it did not reach the database for a while");
        db::query("INSERT INTO server (generation, name, started_at_ms, seen_ms) VALUES (?, ?, ?, ?)")
            .bind(context.generation)
            .bind(name)
            .bind(context.wall_ms)
            .bind(context.now_ms)
            .execute(&mut *connection)
            .await?;
    }
    gaps::check_identity(connection).await?;
    let mut wake = Wake::default();
    let mut ended = Vec::new();
    if judges {
        ended = db::query("DELETE FROM server WHERE seen_ms < ? AND generation <> ? RETURNING name")
            .bind(context.now_ms - SERVER_GONE_MS)
            .bind(context.generation)
            .scalar::<String>()
            .fetch_all(&mut *connection)
            .await?;
    }
    for name in &ended {
        tracing::warn!(name, "another server has ended: the leases of its pool are handed back");
    }
    if !ended.is_empty() {
        hand_back(connection, context.wall_ms).await?;
        wake = Wake { work: true, news: true };
    }
    let running = db::query_scalar("SELECT count(*) FROM server WHERE generation <> ?")
        .bind(context.generation)
        .fetch_one(connection)
        .await?;
    Ok((running, wake))
}

async fn agree_on_secret(connection: &mut Connection, fingerprint: i64, generation: i64) -> Result<bool> {
    let known: Option<i64> = db::query_scalar("SELECT value FROM meta WHERE name = 'secret_fingerprint'")
        .fetch_optional(&mut *connection)
        .await?;
    let others: i64 = db::query_scalar("SELECT count(*) FROM server WHERE generation <> ?")
        .bind(generation)
        .fetch_one(&mut *connection)
        .await?;
    if known == Some(fingerprint) || (known.is_some() && others > 0) {
        return Ok(known == Some(fingerprint));
    }
    db::query(
        "INSERT INTO meta (name, value) VALUES ('secret_fingerprint', ?)
         ON CONFLICT (name) DO UPDATE SET value = excluded.value",
    )
    .bind(fingerprint)
    .execute(connection)
    .await?;
    Ok(true)
}

/// Ends the leases of pools whose server has no row, and marks their workers as gone; returns the number of leases.
pub(super) async fn hand_back(connection: &mut Connection, wall_ms: i64) -> Result<i64> {
    let tiles = ends::interrupt_pool(connection, wall_ms).await?;
    db::query(
        "UPDATE tile SET state = 'ready', interrupts = interrupts + 1
         WHERE state = 'leased' AND id IN (SELECT value FROM @numbers(?))
           AND NOT EXISTS (SELECT 1 FROM lease WHERE lease.tile = tile.id AND ended IS NULL)",
    )
    .bind(json_numbers(tiles.iter().copied()))
    .execute(&mut *connection)
    .await?;
    let gone = db::query(
        "UPDATE worker SET state = 'gone' WHERE pool = 1 AND state <> 'gone'
           AND NOT EXISTS (SELECT 1 FROM server WHERE server.generation = worker.generation) RETURNING id",
    );
    for worker in gone.scalar::<String>().fetch_all(&mut *connection).await? {
        verification::release_of(connection, &worker).await?;
    }
    Ok(row_count(tiles.len()))
}
