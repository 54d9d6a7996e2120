//! Whether a worker that renders one batch for long should take a batch of another submitter beside it.

use proto::WorkerId;

use crate::db;
use crate::queue::leases::claim::{ANY_NODES, ClaimFilter, PassedJobs};
use crate::queue::{Queue, Result};

/// A ready worker without a lease that may take tiles of a job.
const FREE_WORKER_SQL: &str = "
    SELECT 1 FROM worker WHERE state <> 'gone' AND state = 'ready' AND id <> ?2
      AND coalesce(max_nodes, ?3) >= ?3
      AND NOT EXISTS (SELECT 1 FROM lease @index(lease_live_by_worker)
          WHERE lease.worker = worker.id AND lease.ended IS NULL)
      AND NOT EXISTS (SELECT 1 FROM strike WHERE strike.job = ?4 AND strike.worker = worker.id AND until_ms > ?1)
    LIMIT 1";

impl Queue {
    /// Whether there is work of a submitter of whom this worker holds nothing, and no other worker is free for it.
    pub(crate) async fn others_wait(&self, worker: WorkerId) -> Result<bool> {
        let (now_ms, worker) = (self.clock.now_ms(), worker.to_string());
        let max_nodes: Option<Option<i64>> =
            db::query_scalar("SELECT max_nodes FROM worker WHERE id = ? AND state = 'ready'")
                .bind(&worker)
                .fetch_optional(self.readers())
                .await?;
        let Some(max_nodes) = max_nodes else { return Ok(false) };
        let max_nodes = max_nodes.unwrap_or(ANY_NODES);
        let view = ClaimFilter { now_ms, worker: worker.clone(), others_max_nodes: ANY_NODES, max_nodes, beside: true };
        let Some(job) = view.next_job(self.readers(), &PassedJobs::default()).await? else { return Ok(false) };
        let free: Option<i64> = db::query_scalar(FREE_WORKER_SQL)
            .bind(now_ms)
            .bind(worker)
            .bind(job.nodes)
            .bind(job.number)
            .fetch_optional(self.readers())
            .await?;
        Ok(free.is_none())
    }
}
