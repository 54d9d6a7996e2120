//! Failing workers: a worker with repeated errors in one job is excluded from it for 1 h; a worker excluded
//! from three jobs is quarantined. This module decides about workers, never about tiles.
//!
//! Both happen only if another worker can do the work, so that a single worker never stops the farm. A worker that
//! delivers something else than was asked for is quarantined whatever others there are.
//!
//! Workers of one key are one witness: if a tile fails on them alone, and another owner's worker could render it, all of
//! them are excluded from the job instead of the job failing. A key that has been quarantined so gets no work by registering
//! new workers.

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
/// Number of a key's workers, those that registered last, by which a new one is judged.
const RECENT_WORKERS: i64 = 64;
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

/// Excludes all remote workers of a lease's owner from its job if a worker of another owner, or of the pool, could render its
/// tile; returns whether one could.
pub(in crate::queue) async fn exclude_owner(
    connection: &mut Connection,
    held: &LiveLease,
    context: TransitionContext,
) -> Result<bool> {
    let has_other_witness: Option<i64> = db::query_scalar(
        "SELECT 1 FROM worker JOIN job ON job.number = ?1
         WHERE worker.state <> 'gone' AND worker.state = 'ready' AND (worker.pool = 1 OR worker.owner IS DISTINCT FROM ?2)
           AND (?3 <> 0 OR coalesce(worker.max_nodes, job.nodes) >= job.nodes)
           AND NOT EXISTS (SELECT 1 FROM strike WHERE strike.job = ?1 AND strike.worker = worker.id AND until_ms > ?4)
         LIMIT 1",
    )
    .bind(held.job)
    .bind(&held.owner)
    .bind(held.stitch)
    .bind(context.now_ms)
    .fetch_optional(&mut *connection)
    .await?;
    if has_other_witness.is_none() {
        return Ok(false);
    }
    let job = crate::queue::job_id(connection, held.job).await?;
    tracing::warn!(owner = %held.owner, %job, "only workers of one owner failed in a job; they are excluded from the job");
    db::query(
        "INSERT INTO strike (job, worker, errors, until_ms)
         SELECT CAST(?1 AS BIGINT), id, CAST(?3 AS BIGINT), CAST(?4 AS BIGINT) FROM worker
         WHERE state <> 'gone' AND pool = 0 AND owner = ?2
         ON CONFLICT (job, worker) DO UPDATE SET errors = excluded.errors, until_ms = excluded.until_ms",
    )
    .bind(held.job)
    .bind(&held.owner)
    .bind(ERRORS_BEFORE_EXCLUSION)
    .bind(context.now_ms + EXCLUSION_MS)
    .execute(&mut *connection)
    .await?;
    let workers: Vec<String> =
        db::query_scalar("SELECT id FROM worker WHERE state <> 'gone' AND state = 'ready' AND pool = 0 AND owner = ?")
            .bind(&held.owner)
            .fetch_all(&mut *connection)
            .await?;
    for worker in &workers {
        quarantine(connection, worker, context).await?;
    }
    Ok(true)
}

/// Quarantines a new remote worker if most of its owner's last workers are excluded from too many jobs: otherwise a failing
/// key would get work by registering again.
pub(in crate::queue) async fn quarantine_new(
    connection: &mut Connection,
    worker: &str,
    owner: &str,
    context: TransitionContext,
) -> Result<()> {
    let quarantined = db::query(
        "UPDATE worker SET state = 'quarantined' WHERE id = ?1 AND pool = 0
         AND (SELECT 2 * count(*) FILTER (WHERE exclusions >= ?4) > count(*) FROM (
              SELECT (SELECT count(*) FROM strike JOIN job ON job.number = strike.job
                      WHERE strike.worker = same.id AND until_ms > ?3 AND job.state <> 'failed') AS exclusions
              FROM worker AS same WHERE same.owner = ?2 AND same.pool = 0 AND same.id <> ?1
              ORDER BY same.registered_ms DESC LIMIT ?5) AS known)
         AND EXISTS (SELECT 1 FROM worker AS other
              WHERE other.state <> 'gone' AND other.state = 'ready' AND other.id <> ?1)",
    )
    .bind(worker)
    .bind(owner)
    .bind(context.now_ms)
    .bind(EXCLUSIONS_BEFORE_QUARANTINE)
    .bind(RECENT_WORKERS)
    .execute(connection)
    .await?;
    log_quarantine(quarantined, worker, "most workers of its key failed in too many jobs");
    Ok(())
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
            "a worker gets no more work: check its device and release it (`sdfarm workers release`), or revoke its key"
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
