//! Options of a submitted job: the idempotency key, so that a repeated request creates one job, and its webhooks.
//!
//! All options are written in the transaction that accepts the job, so that a crash cannot separate them.

use proto::JobId;

use crate::db;
use crate::db::Durability;
use crate::queue::jobs::submit;
use crate::queue::{
    BacklogLimits, Connection, ExceededLimit, NewJob, Queue, Result, TransitionContext, Wake, expect_rows, parse_column,
};

/// Retention of idempotency keys.
const RETENTION_MS: i64 = 48 * 3_600_000;
/// Number of keys deleted in one transaction.
const DROP_BATCH: i64 = 1_000;

/// Idempotency key and the fingerprint of its request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct IdempotencyKey {
    /// The client's `Idempotency-Key`.
    pub(crate) key: String,
    /// BLAKE3 of the request.
    pub(crate) fingerprint: String,
}

/// Webhook to register for the job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct NewWebhook {
    /// The address.
    pub(crate) url: String,
    /// Its host and port: attempts to one target are limited together.
    pub(crate) target: String,
    /// Event types to send.
    pub(crate) events: Vec<&'static str>,
}

/// Options of a submitted job.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct SubmitOptions {
    /// Makes the submission idempotent.
    pub(crate) idempotency: Option<IdempotencyKey>,
    /// Webhooks of the job.
    pub(crate) webhooks: Vec<NewWebhook>,
    /// Maximum unfinished work, this job included.
    pub(crate) limits: BacklogLimits,
}

/// Outcome of a submission.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum SubmitOutcome {
    /// The job was accepted, with this number.
    Created(i64),
    /// The job was accepted before, with this id.
    Replayed(JobId),
    /// The idempotency key belongs to another request.
    KeyReused,
    /// The job would exceed a limit of unfinished work.
    Rejected(ExceededLimit),
}

impl Queue {
    /// Accepts a job, once for each idempotency key; durable when it returns.
    pub(crate) async fn submit_with(&self, job: NewJob, options: SubmitOptions) -> Result<SubmitOutcome> {
        let context = self.context();
        let submitted = self
            .database
            .write(Durability::Full, move |connection| {
                Box::pin(async move { accept(connection, &job, &options, context).await })
            })
            .await?;
        self.wake(Wake::WORK);
        Ok(submitted)
    }

    /// Whether a submitter has used this idempotency key before.
    pub(crate) async fn has_idempotency_key(&self, submitter: &str, key: &str) -> Result<bool> {
        let known: Option<i64> = db::query_scalar("SELECT 1 FROM idempotency WHERE submitter = ? AND key = ?")
            .bind(submitter)
            .bind(key)
            .fetch_optional(self.readers())
            .await?;
        Ok(known.is_some())
    }

    /// Deletes expired idempotency keys; returns the number deleted.
    pub(crate) async fn prune_idempotency_keys(&self) -> Result<u64> {
        let made_before_ms = self.clock.wall_ms() - RETENTION_MS;
        let mut count = 0;
        loop {
            let dropped = self
                .database
                .write(Durability::Relaxed, move |connection| {
                    Box::pin(async move { prune(connection, made_before_ms).await })
                })
                .await?;
            count += dropped;
            if dropped == 0 {
                return Ok(count);
            }
        }
    }
}

async fn accept(
    connection: &mut Connection,
    job: &NewJob,
    options: &SubmitOptions,
    context: TransitionContext,
) -> Result<SubmitOutcome> {
    if let Some(once) = &options.idempotency
        && let Some(granted) = earlier_submission(connection, &job.submitter, once).await?
    {
        return Ok(granted);
    }
    // Decided here, because transactions are serial: concurrent submissions cannot exceed a limit together.
    let rays = job.plan.rays_total();
    if let Some(limit) = options.limits.find_exceeded(connection, &job.submitter, rays).await? {
        return Ok(SubmitOutcome::Rejected(limit));
    }
    let number = submit::submit(connection, job, context).await?;
    if let Some(once) = &options.idempotency {
        let kept = db::query(
            "INSERT INTO idempotency (submitter, key, fingerprint, job, created_at_ms) VALUES (?, ?, ?, ?, ?)",
        )
        .bind(&job.submitter)
        .bind(&once.key)
        .bind(&once.fingerprint)
        .bind(number)
        .bind(context.wall_ms)
        .execute(&mut *connection)
        .await?;
        expect_rows("idempotency: stored", 1, kept)?;
    }
    for webhook in &options.webhooks {
        let kept = db::query("INSERT INTO webhook (job, url, target, events) VALUES (?, ?, ?, ?)")
            .bind(number)
            .bind(&webhook.url)
            .bind(&webhook.target)
            .bind(format!(",{},", webhook.events.join(",")))
            .execute(&mut *connection)
            .await?;
        expect_rows("webhook: stored", 1, kept)?;
    }
    Ok(SubmitOutcome::Created(number))
}

/// Job that was accepted with this idempotency key before.
async fn earlier_submission(
    connection: &mut Connection,
    submitter: &str,
    once: &IdempotencyKey,
) -> Result<Option<SubmitOutcome>> {
    let row = db::query(
        "SELECT idempotency.fingerprint, job.id FROM idempotency @join job ON job.number = idempotency.job
         WHERE idempotency.submitter = ? AND idempotency.key = ?",
    )
    .bind(submitter)
    .bind(&once.key)
    .fetch_optional(connection)
    .await?;
    let Some(row) = row else { return Ok(None) };
    if row.get::<String>("fingerprint")? != once.fingerprint {
        return Ok(Some(SubmitOutcome::KeyReused));
    }
    let id: String = row.get("id")?;
    Ok(Some(SubmitOutcome::Replayed(parse_column("job.id", &id, |id| id.parse().ok())?)))
}

async fn prune(connection: &mut Connection, made_before_ms: i64) -> Result<u64> {
    let dropped = db::query(
        "DELETE FROM idempotency WHERE (submitter, key) IN (
             SELECT submitter, key FROM idempotency WHERE created_at_ms < ? ORDER BY created_at_ms LIMIT ?)",
    )
    .bind(made_before_ms)
    .bind(DROP_BATCH)
    .execute(connection)
    .await?;
    Ok(dropped.rows_affected())
}
