//! Workers, as users see them.

use std::collections::HashMap;

use crate::db::{self, Row};
use proto::WorkerId;
use proto::pool::{WorkerHold, WorkerList, WorkerState, WorkerView};
use proto::rounding;

use crate::clock::rfc3339;
use crate::queue::{Queue, Result, parse_column};

/// Columns of a [`WorkerView`], up to a condition.
macro_rules! workers_where {
    ($condition:literal) => {
        concat!(
            "SELECT id, name, device, state, pool, rays_per_second, seen_ms, errors, last_error FROM worker
             WHERE state <> 'gone' AND ",
            $condition
        )
    };
}

/// Live leases by worker and frame, up to a condition. The index is forced, because with another one the query would
/// read every lease that was ever granted.
macro_rules! holds_where {
    ($condition:literal) => {
        concat!(
            "SELECT lease.worker, job.id, job.name, tile.frame, count(*) AS tiles
             FROM lease @index(lease_live_by_worker) @join tile ON tile.id = lease.tile @join job ON job.number = tile.job
             WHERE lease.ended IS NULL AND ",
            $condition,
            " GROUP BY lease.worker, job.number, job.id, job.name, tile.frame ORDER BY lease.worker, job.number, tile.frame"
        )
    };
}

/// Tiles that workers hold, by the id of the worker.
type Holds = HashMap<String, Vec<WorkerHold>>;

impl Queue {
    /// Every worker that is not gone.
    pub(crate) async fn workers(&self) -> Result<WorkerList> {
        let rows = db::query(workers_where!("id IS NOT NULL ORDER BY id")).fetch_all(self.readers()).await?;
        let mut holds =
            read_holds(&db::query(holds_where!("lease.worker IS NOT NULL")).fetch_all(self.readers()).await?)?;
        let workers = rows.iter().map(|row| self.view(row, &mut holds)).collect::<Result<Vec<_>>>()?;
        Ok(WorkerList { workers })
    }

    /// A worker that is not gone.
    pub(crate) async fn worker(&self, worker: WorkerId) -> Result<Option<WorkerView>> {
        let id = worker.to_string();
        let row = db::query(workers_where!("id = ?")).bind(&id).fetch_optional(self.readers()).await?;
        let Some(row) = row else { return Ok(None) };
        let holds = db::query(holds_where!("lease.worker = ?")).bind(&id).fetch_all(self.readers()).await?;
        self.view(&row, &mut read_holds(&holds)?).map(Some)
    }

    fn view(&self, row: &Row, holds: &mut Holds) -> Result<WorkerView> {
        let text: String = row.get("id")?;
        let id: WorkerId = parse_column("worker.id", &text, |id| id.parse().ok())?;
        let state: String = row.get("state")?;
        let state = parse_column("worker.state", &state, worker_state)?;
        let unseen_ms = (self.clock.now_ms() - row.get::<i64>("seen_ms")?).max(0);
        let holds = holds.remove(&text).unwrap_or_default();
        Ok(WorkerView {
            id,
            name: row.get("name")?,
            device: row.get("device")?,
            state,
            rays_per_second: row.get::<Option<f64>>("rays_per_second")?.map(rounding::rate),
            leases: holds.iter().map(|hold| hold.tiles).sum(),
            pool: row.get("pool")?,
            registered_at: rfc3339(id.made_at_ms()),
            last_seen_at: rfc3339(self.clock.wall_ms() - unseen_ms),
            quarantined: state == WorkerState::Quarantined,
            draining: state == WorkerState::Draining,
            errors: row.get("errors")?,
            last_error: row.get("last_error")?,
            holds,
        })
    }
}

fn read_holds(rows: &[Row]) -> Result<Holds> {
    let mut holds = Holds::new();
    for row in rows {
        let job: String = row.get("id")?;
        holds.entry(row.get("worker")?).or_default().push(WorkerHold {
            job: parse_column("job.id", &job, |id| id.parse().ok())?,
            name: row.get("name")?,
            frame: row.get("frame")?,
            tiles: row.get("tiles")?,
        });
    }
    Ok(holds)
}

fn worker_state(name: &str) -> Option<WorkerState> {
    Some(match name {
        "starting" => WorkerState::Starting,
        "ready" => WorkerState::Ready,
        "draining" => WorkerState::Draining,
        "gone" => WorkerState::Gone,
        "quarantined" => WorkerState::Quarantined,
        _ => return None,
    })
}
