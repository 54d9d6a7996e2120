//! A worker's sync in one transaction: takes results, renews leases, releases strays, claims work.

use std::collections::HashSet;
use std::time::Duration;

use proto::worker_protocol::{Batch, LeaseReport};
use proto::{LeaseId, WorkerId};
use sqlx::Row;

use super::claim::{self, Claimant, Claimed};
use super::lease::{self, Cause};
use super::{Connection, Moment, Opening, Result, Ring, deliver, known, open_frame, workers};
use crate::tile_plan::Plan;

/// A lease granted in a response that the worker never received is released after this time: the worker does
/// not list it.
const STRAY_AFTER_MS: i64 = 2000;

/// Input of a sync.
#[derive(Clone, Debug)]
pub(crate) struct Turn {
    /// The calling worker.
    pub(crate) worker: WorkerId,
    /// Its measured camera rays a second.
    pub(crate) rays_per_second: Option<f64>,
    /// The leases it holds.
    pub(crate) holding: Vec<LeaseId>,
    /// The leases it has finished with.
    pub(crate) results: Vec<LeaseReport>,
    /// Whether it wants a run.
    pub(crate) wants_work: bool,
    /// The worker is shutting down.
    pub(crate) leaving: bool,
    /// Frame that the previous pass of this sync asked to open.
    pub(crate) opening: Option<Opening>,
}

impl Turn {
    /// Whether it contains results, so that its commit must be durable before the response.
    pub(crate) fn delivers(&self) -> bool {
        !self.results.is_empty()
    }
}

/// Outcome of a sync.
#[derive(Clone, Debug)]
pub(crate) struct Turned {
    /// Leases of the call that are no longer live.
    pub(crate) lost: Vec<LeaseId>,
    /// The worker should finish and exit.
    pub(crate) drain: bool,
    /// The granted work, or what prevents it.
    pub(crate) next: Next,
    /// Blobs that may be orphans now.
    pub(crate) leftovers: Vec<String>,
    /// Number of leases found to be overdue.
    pub(crate) expired: u64,
    /// Results without effect.
    pub(crate) fenced: u64,
    /// Number of results that differ from the first result of the same tile.
    pub(crate) nondeterministic: u64,
    pub(super) ring: Ring,
}

impl Turned {
    /// Whether the worker must get the response at once.
    pub(crate) fn has_news(&self) -> bool {
        !self.lost.is_empty() || matches!(self.next, Next::Run(_))
    }

    /// If a tile is backing off: the time until it is ready.
    pub(crate) fn ready_in(&self) -> Option<Duration> {
        match self.next {
            Next::Nothing(Some(ready_in_ms)) => Some(Duration::from_millis(ready_in_ms.unsigned_abs())),
            Next::Nothing(None) | Next::Run(_) | Next::Frame { .. } => None,
        }
    }
}

/// The granted work, or what prevents it.
#[derive(Clone, Debug)]
pub(crate) enum Next {
    /// A run.
    Run(Batch),
    /// A frame has to be opened first: repeat the sync with its [`Opening`].
    Frame {
        /// The job's number.
        job: i64,
        /// The frame.
        frame: u32,
        /// How its frames are cut into tiles.
        plan: Plan,
    },
    /// No work now; if a tile is backing off, it is ready in this many milliseconds.
    Nothing(Option<i64>),
}

/// Carries out a worker's sync; `None` if the worker is unknown.
pub(super) async fn turn(connection: &mut Connection, turn: Turn, moment: Moment) -> Result<Option<Turned>> {
    let Some(worker) = seen(connection, &turn, moment).await? else { return Ok(None) };
    // A pass with the opening that the previous pass asked for belongs to the same sync.
    let is_new = turn.opening.is_none();
    let (expired, mut ring) = if is_new { lease::rescue(connection, moment).await? } else { Default::default() };
    let delivered = deliver::deliver(connection, turn.worker, &turn.results, moment).await?;
    ring.add(delivered.ring);
    let (fenced, nondeterministic) = (delivered.lost.len() as u64, delivered.nondeterministic);
    let mut lost = delivered.lost;
    if is_new {
        ring.add(keep_leases(connection, &turn, moment, &mut lost).await?);
    }
    if turn.leaving {
        ring.add(workers::left(connection, turn.worker, moment).await?);
    }
    let next = if turn.wants_work && !turn.leaving && worker.state == WorkerState::Ready {
        take_work(connection, &turn, worker.max_nodes, moment).await?
    } else {
        Next::Nothing(None)
    };
    let drain = turn.leaving || worker.state == WorkerState::Draining;
    Ok(Some(Turned { lost, drain, next, leftovers: delivered.leftovers, expired, fenced, nondeterministic, ring }))
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum WorkerState {
    Ready,
    Draining,
    Other,
}

/// What a sync needs to know of its worker.
struct Seen {
    state: WorkerState,
    max_nodes: i64,
}

async fn seen(connection: &mut Connection, turn: &Turn, moment: Moment) -> Result<Option<Seen>> {
    let row = sqlx::query(
        "UPDATE worker SET seen_ms = ?, rays_per_second = coalesce(?, rays_per_second)
         WHERE id = ? AND state <> 'gone' RETURNING state, coalesce(max_nodes, ?) AS max_nodes",
    )
    .bind(moment.now_ms)
    .bind(turn.rays_per_second)
    .bind(turn.worker.to_string())
    .bind(claim::ANY_NODES)
    .fetch_optional(connection)
    .await?;
    let Some(row) = row else { return Ok(None) };
    let state = known("worker.state", &row.try_get::<String, _>("state")?, |state| match state {
        "ready" => Some(WorkerState::Ready),
        "draining" => Some(WorkerState::Draining),
        "starting" | "quarantined" => Some(WorkerState::Other),
        _ => None,
    })?;
    Ok(Some(Seen { state, max_nodes: row.try_get("max_nodes")? }))
}

/// Renews the leases that the worker lists, names those that ended, and releases those that it never
/// received.
async fn keep_leases(
    connection: &mut Connection,
    turn: &Turn,
    moment: Moment,
    lost: &mut Vec<LeaseId>,
) -> Result<Ring> {
    let live = lease::live_leases(connection, &turn.worker.to_string()).await?;
    let mut holding: HashSet<String> = turn.holding.iter().map(ToString::to_string).collect();
    let (held, unknown): (Vec<_>, Vec<_>) = live.iter().partition(|live| holding.remove(&live.lease));
    lost.extend(turn.holding.iter().filter(|lease| holding.contains(&lease.to_string())));
    let held: Vec<&str> = held.into_iter().map(|live| live.lease.as_str()).collect();
    lease::renew(connection, &held, moment).await?;
    let mut ring = Ring::default();
    for stray in unknown.into_iter().filter(|live| live.granted_ms <= moment.now_ms - STRAY_AFTER_MS) {
        // The failure of a job, just before in this loop, may have ended more of these leases.
        let Some(held) = lease::live(connection, &stray.lease).await? else { continue };
        tracing::warn!(lease = %held.lease, worker = %turn.worker, "a worker never heard of its lease");
        ring.add(lease::give_up(connection, &held, Cause::Interrupted, "its worker forgot it", moment).await?);
    }
    Ok(ring)
}

async fn take_work(connection: &mut Connection, turn: &Turn, max_nodes: i64, moment: Moment) -> Result<Next> {
    if let Some(opening) = &turn.opening {
        open_frame::open(connection, opening, moment).await?;
    }
    let claimant = Claimant { worker: turn.worker, rays_per_second: turn.rays_per_second, max_nodes };
    Ok(match claim::claim(connection, claimant, moment).await? {
        Claimed::Run(run) => Next::Run(run),
        Claimed::NeedsFrame { job, frame, plan } => Next::Frame { job, frame, plan },
        Claimed::Nothing(ready_in_ms) => Next::Nothing(ready_in_ms),
    })
}
