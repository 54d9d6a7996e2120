//! Workers: registration, draining and exit.

pub(super) mod changes;
pub(super) mod exclusion;
pub(super) mod minutes;
pub(super) mod needs;
pub(super) mod scaling;
pub(super) mod speeds;
pub(super) mod state;
pub(super) mod views;

use crate::db;
use proto::WorkerId;
use proto::worker_protocol::RegisterRequest;

use crate::queue::leases::{self, LeaseEnd};
use crate::queue::{Connection, Queue, Result, TransitionContext, Wake, expect_rows, parse_column, verification};

/// Maximum number of registered workers of one key.
pub(crate) const MAX_WORKERS_OF_KEY: usize = 16_384;

/// Worker that registers.
#[derive(Clone, Debug)]
pub(crate) struct NewWorker {
    /// Its registration request.
    pub(crate) request: RegisterRequest,
    /// Whether it is a child process of this server.
    pub(crate) pool: bool,
    /// Its label.
    pub(crate) name: String,
    /// Caller that registers it: only that caller may speak for it.
    pub(crate) owner: String,
}

/// Registered worker.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Registration {
    /// Worker id, valid until it exits.
    pub(crate) worker: WorkerId,
}

/// Registers a worker as ready; `None` if its key has too many.
pub(super) async fn register(
    connection: &mut Connection,
    new: NewWorker,
    context: TransitionContext,
) -> Result<Option<Registration>> {
    let limit = i64::try_from(MAX_WORKERS_OF_KEY).expect("it is a small number");
    let known: i64 = db::query_scalar(
        "SELECT count(*) FROM (SELECT 1 FROM worker WHERE owner = ? AND state <> 'gone' AND pool = 0 LIMIT ?) AS known",
    )
    .bind(&new.owner)
    .bind(limit)
    .fetch_one(&mut *connection)
    .await?;
    if known >= limit && !new.pool {
        return Ok(None);
    }
    let worker = WorkerId::new();
    let made = db::query(
        "INSERT INTO worker (id, name, device, state, pool, process, max_nodes, generation, seen_ms, registered_ms, owner)
         VALUES (?1, ?2, ?3, 'ready', ?4, ?5, ?6, ?7, ?8, ?8, ?9)",
    )
    .bind(worker.to_string())
    .bind(new.name)
    .bind(new.request.device)
    .bind(new.pool)
    .bind(new.request.process)
    .bind(new.request.max_nodes)
    .bind(context.generation)
    .bind(context.now_ms)
    .bind(&new.owner)
    .execute(&mut *connection)
    .await?;
    expect_rows("worker: registered", 1, made)?;
    exclusion::quarantine_new(connection, &worker.to_string(), &new.owner, context).await?;
    Ok(Some(Registration { worker }))
}

impl Queue {
    /// Owner of a worker that has not exited.
    pub(crate) async fn worker_owner(&self, worker: WorkerId) -> Result<Option<String>> {
        let owner = db::query_scalar("SELECT owner FROM worker WHERE id = ? AND state <> 'gone'")
            .bind(worker.to_string())
            .fetch_optional(self.readers())
            .await?;
        Ok(owner.flatten())
    }

    /// Name and device of a worker.
    pub(crate) async fn worker_device(&self, worker: WorkerId) -> Result<Option<(String, String)>> {
        let row = db::query("SELECT name, device FROM worker WHERE id = ?").bind(worker.to_string());
        let row = row.fetch_optional(self.readers()).await?;
        row.map(|row| Ok((row.get("name")?, row.get("device")?))).transpose()
    }
}

/// Asks the worker of this server's pool with this process id to drain; false if there is none yet.
pub(super) async fn drain(connection: &mut Connection, process: u32, generation: i64) -> Result<bool> {
    let drained = db::query(
        "UPDATE worker SET state = 'draining' WHERE process = ? AND pool = 1 AND generation = ?
         AND state IN ('starting', 'ready', 'quarantined')",
    )
    .bind(process)
    .bind(generation)
    .execute(connection)
    .await?;
    Ok(drained.rows_affected() > 0)
}

/// Records that a process of this server's pool has ended, and ends its leases.
pub(super) async fn reaped(
    connection: &mut Connection,
    process: u32,
    cause: LeaseEnd,
    message: &str,
    context: TransitionContext,
) -> Result<(Option<WorkerId>, Wake)> {
    let rows = db::query(
        "UPDATE worker SET state = 'gone' WHERE process = ? AND pool = 1 AND generation = ? AND state <> 'gone'
         RETURNING id",
    )
    .bind(process)
    .bind(context.generation)
    .fetch_all(&mut *connection)
    .await?;
    let mut woken = Wake::default();
    let mut worker = None;
    for row in rows {
        let id: String = row.get("id")?;
        woken.add(end_leases(connection, &id, cause, message, context).await?);
        worker = Some(parse_column("worker.id", &id, |id| id.parse().ok())?);
    }
    Ok((worker, woken))
}

/// Records that a worker has shut down; leases granted to it in the meantime are released.
pub(super) async fn deregister(
    connection: &mut Connection,
    worker: WorkerId,
    context: TransitionContext,
) -> Result<Wake> {
    let id = worker.to_string();
    let gone = db::query("UPDATE worker SET state = 'gone' WHERE id = ? AND state <> 'gone'")
        .bind(&id)
        .execute(&mut *connection)
        .await?;
    expect_rows("worker: gone", 1, gone)?;
    end_leases(connection, &id, LeaseEnd::Released, "its worker shut down", context).await
}

/// Ends all leases of a worker.
pub(super) async fn end_leases(
    connection: &mut Connection,
    worker: &str,
    cause: LeaseEnd,
    message: &str,
    context: TransitionContext,
) -> Result<Wake> {
    let mut woken = verification::release_of(connection, worker).await?;
    for lease in leases::live_lease_ids(connection, worker).await? {
        if let Some(held) = leases::live_lease(connection, &lease).await? {
            woken.add(leases::end_without_result(connection, &held, cause, message, context).await?);
        }
    }
    Ok(woken)
}
