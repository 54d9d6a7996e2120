//! Failing workers: a worker with repeated errors in one job is excluded from it for 1 h; a worker excluded
//! from three jobs is quarantined. This module decides about workers, never about tiles.
//!
//! Both happen only if another worker can do the work, so that a single worker never stops the farm. A worker that
//! delivers something else than was asked for is quarantined whatever others there are.

use std::collections::BTreeSet;

use crate::db;
use proto::WorkerId;

use crate::queue::leases::LiveLease;
use crate::queue::{Connection, Queue, Result, TransitionContext};

/// Number of a worker's errors in one job that excludes it from the job.
const ERRORS_BEFORE_EXCLUSION: i64 = 3;
/// Duration of an exclusion.
const EXCLUSION_MS: i64 = 3_600_000;
/// Number of exclusions that quarantines a worker. Jobs that failed as a whole do not count, because they
/// failed on every worker.
const EXCLUSIONS_BEFORE_QUARANTINE: i64 = 3;
/// Number of a worker's results with wrong bytes that quarantines it. A correct worker has none.
const WRONG_RESULTS_BEFORE_QUARANTINE: i64 = 3;

/// Maximum length of the message that is kept of a worker's last error.
const MAX_MESSAGE_CHARACTERS: usize = 300;

/// Counts a tile that failed on a worker, for those who look after the worker.
pub(in crate::queue) async fn count_error(connection: &mut Connection, worker: &str, message: &str) -> Result<()> {
    let message: String = message.chars().take(MAX_MESSAGE_CHARACTERS).collect();
    let counted = db::query("UPDATE worker SET errors = errors + 1, last_error = ? WHERE id = ?")
        .bind(message)
        .bind(worker)
        .execute(connection)
        .await?;
    crate::queue::expect_rows("worker: error counted", 1, counted)
}

impl Queue {
    /// Workers on which three or more tiles of unfinished jobs have failed.
    pub(crate) async fn failing_workers(&self) -> Result<BTreeSet<WorkerId>> {
        let ids: Vec<String> = db::query_scalar(
            "SELECT strike.worker FROM strike JOIN job ON job.number = strike.job
             WHERE job.finished_at_ms IS NULL AND (strike.until_ms IS NULL OR strike.until_ms > ?)
             GROUP BY strike.worker HAVING CAST(sum(strike.errors) AS BIGINT) >= ?",
        )
        .bind(self.clock.now_ms())
        .bind(ERRORS_BEFORE_EXCLUSION)
        .fetch_all(self.readers())
        .await?;
        ids.iter().map(|id| crate::queue::parse_column("strike.worker", id, |id| id.parse().ok())).collect()
    }
}

/// Records a worker's error in a job.
pub(in crate::queue) async fn record_error(
    connection: &mut Connection,
    worker: &str,
    job: i64,
    context: TransitionContext,
) -> Result<()> {
    let errors: i64 = db::query_scalar(
        "INSERT INTO strike (job, worker, errors, until_ms) VALUES (?1, ?2, 1, NULL)
         ON CONFLICT (job, worker) DO UPDATE SET
             errors = CASE WHEN strike.until_ms <= ?3 THEN 1 ELSE strike.errors + 1 END,
             until_ms = CASE WHEN CASE WHEN strike.until_ms <= ?3 THEN 1 ELSE strike.errors + 1 END >= ?4
                             THEN ?3 + ?5 END
         RETURNING errors",
    )
    .bind(job)
    .bind(worker)
    .bind(context.now_ms)
    .bind(ERRORS_BEFORE_EXCLUSION)
    .bind(EXCLUSION_MS)
    .fetch_one(&mut *connection)
    .await?;
    if errors != ERRORS_BEFORE_EXCLUSION {
        return Ok(());
    }
    let job = crate::queue::job_id(connection, job).await?;
    tracing::warn!(worker, %job, errors, "a worker failed too often in a job; it is excluded from the job");
    quarantine(connection, worker, context).await
}

/// Quarantines a worker that is excluded from three jobs or more, unless it is the last ready worker.
async fn quarantine(connection: &mut Connection, worker: &str, context: TransitionContext) -> Result<()> {
    let quarantined = db::query(
        "UPDATE worker SET state = 'quarantined' WHERE id = ?1 AND state = 'ready'
         AND (SELECT count(*) FROM strike JOIN job ON job.number = strike.job
              WHERE strike.worker = ?1 AND until_ms > ?2 AND job.state <> 'failed') >= ?3
         AND EXISTS (SELECT 1 FROM worker AS other
              WHERE other.state <> 'gone' AND other.state = 'ready' AND other.id <> ?1)",
    )
    .bind(worker)
    .bind(context.now_ms)
    .bind(EXCLUSIONS_BEFORE_QUARANTINE)
    .execute(connection)
    .await?;
    log_quarantine(quarantined, worker, "it failed in too many jobs");
    Ok(())
}

/// Counts results of a worker that were not what was asked for; after a few it is quarantined, also if it is the
/// last ready worker, because a picture that is late is better than a wrong one. Returns whether it is now.
pub(in crate::queue) async fn record_wrong_results(
    connection: &mut Connection,
    worker: WorkerId,
    count: usize,
) -> Result<bool> {
    if count == 0 {
        return Ok(false);
    }
    let wrong: Option<i64> = db::query_scalar(
        "UPDATE worker SET wrong_results = wrong_results + ? WHERE id = ? AND state <> 'gone' RETURNING wrong_results",
    )
    .bind(crate::queue::row_count(count))
    .bind(worker.to_string())
    .fetch_optional(&mut *connection)
    .await?;
    if wrong.is_none_or(|wrong| wrong < WRONG_RESULTS_BEFORE_QUARANTINE) {
        return Ok(false);
    }
    quarantine_at_once(connection, &worker.to_string(), "it delivered something else than was asked for").await?;
    Ok(true)
}

/// Quarantines a worker, whatever other workers there are.
pub(in crate::queue) async fn quarantine_at_once(
    connection: &mut Connection,
    worker: &str,
    reason: &str,
) -> Result<()> {
    let quarantined = db::query(
        "UPDATE worker SET state = 'quarantined', last_error = ? WHERE id = ? AND state NOT IN ('gone', 'quarantined')",
    )
    .bind(reason)
    .bind(worker)
    .execute(connection)
    .await?;
    log_quarantine(quarantined, worker, reason);
    Ok(())
}

fn log_quarantine(quarantined: db::Changed, worker: &str, reason: &str) {
    if quarantined.rows_affected() > 0 {
        tracing::error!(
            code = "worker_quarantined",
            worker,
            reason,
            "a worker gets no more work: check its device and release or restart it, or revoke its key"
        );
    }
}

/// Whether a worker other than the lease's is excluded from its job: then the tile must not avoid this worker.
pub(in crate::queue) async fn is_other_worker_excluded(
    connection: &mut Connection,
    held: &LiveLease,
    context: TransitionContext,
) -> Result<bool> {
    let barred: Option<i64> =
        db::query_scalar("SELECT 1 FROM strike WHERE job = ? AND worker <> ? AND until_ms > ? LIMIT 1")
            .bind(held.job)
            .bind(&held.worker)
            .bind(context.now_ms)
            .fetch_optional(connection)
            .await?;
    Ok(barred.is_some())
}

/// Restarts all exclusions at startup, with full length, because the monotonic clock starts at zero.
pub(in crate::queue) async fn recover(connection: &mut Connection, now_ms: i64) -> Result<()> {
    db::query("UPDATE strike SET until_ms = ? WHERE until_ms IS NOT NULL")
        .bind(now_ms + EXCLUSION_MS)
        .execute(connection)
        .await?;
    Ok(())
}
