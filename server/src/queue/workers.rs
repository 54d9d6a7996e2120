//! Workers: registration, draining, and their end.

use proto::WorkerId;
use proto::worker_protocol::RegisterRequest;
use sqlx::Row;

use super::lease::{self, Cause};
use super::{Connection, Moment, Result, Ring, counted, known};

/// Worker that registers.
#[derive(Clone, Debug)]
pub(crate) struct NewWorker {
    /// Its registration request.
    pub(crate) hello: RegisterRequest,
    /// It is a child process of this server.
    pub(crate) pool: bool,
    /// Its label.
    pub(crate) name: String,
}

/// A worker that was taken in.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Registered {
    /// Its id until it exits.
    pub(crate) worker: WorkerId,
}

/// Takes in a worker, ready to work.
pub(super) async fn register(connection: &mut Connection, new: NewWorker, moment: Moment) -> Result<Registered> {
    let worker = WorkerId::new();
    let made = sqlx::query(
        "INSERT INTO worker (id, name, device, state, pool, process, max_nodes, generation, seen_ms)
         VALUES (?, ?, ?, 'ready', ?, ?, ?, ?, ?)",
    )
    .bind(worker.to_string())
    .bind(new.name)
    .bind(new.hello.device)
    .bind(new.pool)
    .bind(new.hello.process)
    .bind(new.hello.max_nodes)
    .bind(moment.generation)
    .bind(moment.now_ms)
    .execute(connection)
    .await?;
    counted("worker: registered", 1, &made)?;
    Ok(Registered { worker })
}

/// Asks the pool worker of a process to drain; false if there is none yet.
pub(super) async fn drain(connection: &mut Connection, process: u32) -> Result<bool> {
    let drained = sqlx::query(
        "UPDATE worker SET state = 'draining' WHERE process = ? AND pool = 1
         AND state IN ('starting', 'ready', 'quarantined')",
    )
    .bind(process)
    .execute(connection)
    .await?;
    Ok(drained.rows_affected() > 0)
}

/// Records that a pool worker's process has ended, and ends its leases.
pub(super) async fn reaped(
    connection: &mut Connection,
    process: u32,
    cause: Cause,
    message: &str,
    moment: Moment,
) -> Result<(Option<WorkerId>, Ring)> {
    let rows =
        sqlx::query("UPDATE worker SET state = 'gone' WHERE process = ? AND pool = 1 AND state <> 'gone' RETURNING id")
            .bind(process)
            .fetch_all(&mut *connection)
            .await?;
    let mut ring = Ring::default();
    let mut worker = None;
    for row in rows {
        let id: String = row.try_get("id")?;
        ring.add(end_leases(connection, &id, cause, message, moment).await?);
        worker = Some(known("worker.id", &id, |id| id.parse().ok())?);
    }
    Ok((worker, ring))
}

/// Records that a worker has shut down; leases granted to it in the meantime are released.
pub(super) async fn left(connection: &mut Connection, worker: WorkerId, moment: Moment) -> Result<Ring> {
    let id = worker.to_string();
    let gone = sqlx::query("UPDATE worker SET state = 'gone' WHERE id = ? AND state <> 'gone'")
        .bind(&id)
        .execute(&mut *connection)
        .await?;
    counted("worker: gone", 1, &gone)?;
    end_leases(connection, &id, Cause::Interrupted, "its worker ended", moment).await
}

async fn end_leases(
    connection: &mut Connection,
    worker: &str,
    cause: Cause,
    message: &str,
    moment: Moment,
) -> Result<Ring> {
    let mut ring = Ring::default();
    for lease in lease::held_by(connection, worker).await? {
        if let Some(held) = lease::live(connection, &lease).await? {
            ring.add(lease::give_up(connection, &held, cause, message, moment).await?);
        }
    }
    Ok(ring)
}
