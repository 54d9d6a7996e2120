//! Backlog and workers by kind of device, for autoscalers. It only reads.

use proto::worker_protocol::CUDA_MAX_NODES;

use crate::db;
use crate::queue::workers::speeds::{MAX_AGE_MS, measured_sql};
use crate::queue::{Queue, Result};
use crate::scaling::{Demand, DeviceWorkers, Load};

/// Unfinished jobs that are not paused, with the mean speed of one worker of each kind that was measured in them.
const LOADS_SQL: &str = concat!(
    "WITH measured AS (
         SELECT speed.job AS job, avg(",
    measured_sql!(),
    ") FILTER (WHERE worker.device NOT LIKE 'cuda:%') AS cpu, avg(",
    measured_sql!(),
    ") FILTER (WHERE worker.device LIKE 'cuda:%') AS cuda
         FROM speed JOIN worker ON worker.id = speed.worker WHERE at_ms > ? GROUP BY speed.job)
     SELECT nodes, cpu, cuda, count(*) AS jobs, CAST(sum(tiles_total - tiles_done) AS BIGINT) AS tiles,
            CAST(sum(rays_total - rays_done) AS BIGINT) AS rays
     FROM job LEFT JOIN measured ON measured.job = job.number
     WHERE finished_at_ms IS NULL AND paused = 0 GROUP BY nodes, cpu, cuda"
);

/// Workers by kind; the device of a worker on a GPU is `cuda:N`. Those that are gone are kept for about an hour: if no
/// other is left, such as after all were stopped for want of work, their speed counts.
const WORKERS_SQL: &str = "SELECT device LIKE 'cuda:%' AS is_cuda, count(*) FILTER (WHERE state = 'ready') AS ready,
        coalesce(avg(rays_per_second) FILTER (WHERE state <> 'gone'), avg(rays_per_second)) AS speed,
        max(coalesce(max_nodes, 9223372036854775807)) FILTER (WHERE state <> 'gone') AS max_nodes
     FROM worker GROUP BY device LIKE 'cuda:%'";

impl Queue {
    /// Backlog and workers; a paused farm has no backlog.
    pub(crate) async fn demand(&self) -> Result<Demand> {
        let readers = self.readers();
        let mut demand = Demand::default();
        // No GPU renders larger scenes, whether there is one now or not.
        demand.cuda.max_nodes = Some(CUDA_MAX_NODES.into());
        for row in db::query(WORKERS_SQL).fetch_all(readers).await? {
            let workers = if row.get("is_cuda")? { &mut demand.cuda } else { &mut demand.cpu };
            *workers = DeviceWorkers {
                ready: row.get("ready")?,
                speed: row.get("speed")?,
                max_nodes: row.get::<Option<i64>>("max_nodes")?.or(workers.max_nodes),
            };
        }
        if self.is_paused().await? {
            return Ok(demand);
        }
        let rows = db::query(LOADS_SQL).bind(self.clock.now_ms() - MAX_AGE_MS).fetch_all(readers).await?;
        let load = |row: &db::Row| {
            Ok(Load {
                nodes: row.get("nodes")?,
                jobs: row.get("jobs")?,
                tiles: row.get("tiles")?,
                rays: row.get("rays")?,
                cpu_speed: row.get("cpu")?,
                cuda_speed: row.get("cuda")?,
            })
        };
        demand.loads = rows.iter().map(load).collect::<Result<_>>()?;
        Ok(demand)
    }
}
