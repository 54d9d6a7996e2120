//! A worker and its live leases as they are before its sync, read by one statement, because each statement is a round
//! trip to the database. It decides nothing.

use crate::db::{self, Row};
use crate::queue::leases::LiveLease;
use crate::queue::leases::claim::ANY_NODES;
use crate::queue::leases::sync::SyncInput;
use crate::queue::{Connection, Result, TransitionContext, expect_rows, parse_column};

/// Whether a worker may get work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::queue) enum WorkerStatus {
    /// It may.
    Ready,
    /// It finishes what it has.
    Draining,
    /// It may not now.
    Other,
}

/// A worker before its sync.
#[derive(Debug)]
#[expect(clippy::struct_excessive_bools, reason = "independent columns of one row")]
pub(in crate::queue) struct WorkerState {
    /// Its id.
    pub(in crate::queue) id: String,
    /// Whether it may get work.
    pub(in crate::queue) status: WorkerStatus,
    /// Whether it is a child process of the server.
    pub(in crate::queue) is_pool: bool,
    /// Time of its registration.
    pub(in crate::queue) registered_ms: i64,
    /// Largest scene it renders, in nodes.
    pub(in crate::queue) max_nodes: i64,
    /// Time of its last delivery.
    pub(in crate::queue) delivered_ms: i64,
    /// Whether the farm is paused.
    pub(in crate::queue) is_paused: bool,
    /// Largest scene that another ready worker renders, in nodes; -1 if there is none.
    pub(in crate::queue) others_max_nodes: i64,
    /// Whether a lease is overdue or another remote worker is lost.
    pub(in crate::queue) is_anything_overdue: bool,
    /// Whether a result is, or waits to be, verified.
    pub(in crate::queue) has_verifications: bool,
    /// Its live leases, also of jobs that have ended.
    pub(in crate::queue) leases: Vec<HeldLease>,
}

/// A lease that has not ended.
#[derive(Clone, Debug)]
pub(in crate::queue) struct HeldLease {
    /// The lease and its tile.
    pub(in crate::queue) live: LiveLease,
    /// Position of its tile in the frame.
    pub(in crate::queue) position: i64,
    /// Whether its job has not ended; otherwise its results do not count.
    pub(in crate::queue) is_open: bool,
    /// Whether another worker has a lease on its tile.
    pub(in crate::queue) has_duplicate: bool,
    /// Number of tiles of its frame, if that is open.
    pub(in crate::queue) frame_tiles: Option<i64>,
    /// Camera rays; 0 for a stitch.
    pub(in crate::queue) rays: i64,
    /// Submitter of its job.
    pub(in crate::queue) submitter: String,
    /// Charge to the submitter.
    pub(in crate::queue) charged_us: i64,
    /// Priority that it was charged to.
    pub(in crate::queue) charged_priority: i64,
}

/// A lease that ends with a result.
#[derive(Clone, Copy, Debug)]
pub(in crate::queue) struct UsedLease<'a> {
    /// The lease.
    pub(in crate::queue) held: &'a HeldLease,
    /// Time that was used for it.
    pub(in crate::queue) used_us: i64,
}

/// The index is forced, because with another one the statement would read every lease that the worker ever had.
const WORKER_SQL: &str = "
    SELECT worker.state, coalesce(worker.max_nodes, ?2) AS max_nodes, worker.delivered_ms, worker.pool,
           worker.registered_ms,
           (SELECT value <> 0 FROM meta WHERE name = 'paused') AS is_paused,
           (SELECT coalesce(max(coalesce(other.max_nodes, ?2)), -1) FROM worker AS other
            WHERE other.state <> 'gone' AND other.state = 'ready' AND other.id <> ?1) AS others_max_nodes,
           EXISTS (SELECT 1 FROM lease AS overdue WHERE overdue.ended IS NULL AND overdue.expires_ms <= ?3)
               OR EXISTS (SELECT 1 FROM worker AS other WHERE other.state <> 'gone' AND other.pool = 0
                          AND other.seen_ms <= ?4 AND other.id <> ?1) AS is_anything_overdue,
           (SELECT min(number) FROM verification) IS NOT NULL AS has_verifications,
           coalesce(worker.owner, worker.id) AS owner, lease.id AS lease, lease.worker, lease.granted_ms, lease.charged_us, lease.charged_priority,
           tile.id AS tile, tile.job, tile.frame, tile.kind, tile.position, tile.rays, tile.errors, tile.crashes, tile.lost,
           tile.interrupts, tile.blamed_by, job.submitter, job.finished_at_ms IS NULL AS is_open, frame.tiles_total AS frame_tiles,
           EXISTS (SELECT 1 FROM lease AS other
                   WHERE other.tile = tile.id AND other.ended IS NULL AND other.id <> lease.id) AS has_duplicate
    FROM worker
    LEFT JOIN lease @index(lease_live_by_worker) ON lease.worker = worker.id AND lease.ended IS NULL
    LEFT JOIN tile ON tile.id = lease.tile
    LEFT JOIN job ON job.number = tile.job
    LEFT JOIN frame ON frame.job = tile.job AND frame.number = tile.frame AND frame.state = 'open'
    WHERE worker.id = ?1 AND worker.state <> 'gone' AND coalesce(worker.owner, ?5) = ?5";

impl WorkerState {
    /// Reads a worker; `None` if it is unknown, or belongs to another caller.
    pub(in crate::queue) async fn read(
        connection: &mut Connection,
        turn: &SyncInput,
        context: TransitionContext,
    ) -> Result<Option<Self>> {
        let id = turn.worker.to_string();
        let rows = db::query(WORKER_SQL)
            .bind(&id)
            .bind(ANY_NODES)
            .bind(context.now_ms)
            .bind(context.now_ms - context.lease_ms)
            .bind(&turn.owner)
            .fetch_all(connection)
            .await?;
        let Some(row) = rows.first() else { return Ok(None) };
        let mut leases = Vec::with_capacity(rows.len());
        for row in &rows {
            if row.get::<Option<String>>("lease")?.is_some() {
                leases.push(HeldLease::read(row)?);
            }
        }
        Ok(Some(Self {
            id,
            status: parse_column("worker.state", &row.get::<String>("state")?, |state| match state {
                "ready" => Some(WorkerStatus::Ready),
                "draining" => Some(WorkerStatus::Draining),
                "starting" | "quarantined" => Some(WorkerStatus::Other),
                _ => None,
            })?,
            is_pool: row.get("pool")?,
            registered_ms: row.get("registered_ms")?,
            max_nodes: row.get("max_nodes")?,
            delivered_ms: row.get("delivered_ms")?,
            is_paused: row.get("is_paused")?,
            others_max_nodes: row.get("others_max_nodes")?,
            is_anything_overdue: row.get("is_anything_overdue")?,
            has_verifications: row.get("has_verifications")?,
            leases,
        }))
    }
}

impl HeldLease {
    fn read(row: &Row) -> Result<Self> {
        Ok(Self {
            live: LiveLease::read(row)?,
            position: row.get("position")?,
            is_open: row.get("is_open")?,
            has_duplicate: row.get("has_duplicate")?,
            frame_tiles: row.get("frame_tiles")?,
            rays: row.get("rays")?,
            submitter: row.get("submitter")?,
            charged_us: row.get("charged_us")?,
            charged_priority: row.get("charged_priority")?,
        })
    }
}

/// Records that a worker has called, and whether it has delivered results.
pub(in crate::queue) async fn touch(
    connection: &mut Connection,
    turn: &SyncInput,
    has_delivered: bool,
    context: TransitionContext,
) -> Result<()> {
    let touched = db::query(
        "UPDATE worker SET seen_ms = ?1, rays_per_second = coalesce(?2, rays_per_second), owner = coalesce(owner, ?3),
                           delivered_ms = CASE WHEN ?4 <> 0 THEN ?1 ELSE delivered_ms END
         WHERE id = ?5",
    )
    .bind(context.now_ms)
    .bind(turn.rays_per_second.map(proto::bounded::RaysPerSecond::get))
    .bind(&turn.owner)
    .bind(has_delivered)
    .bind(turn.worker.to_string())
    .execute(connection)
    .await?;
    expect_rows("worker: seen", 1, touched)
}
