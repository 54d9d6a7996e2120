//! Jobs, as users read them, through the reading connections.

pub(super) mod backlog;
pub(super) mod changes;
pub(super) mod cleanup;
pub(super) mod fair_share;
pub(super) mod finish;
pub(super) mod idempotency;
pub(super) mod pause;
pub(super) mod places;
pub(super) mod retention;
pub(super) mod submit;
pub(super) mod trace_context;
pub(super) mod transitions;

use crate::db;
use crate::db::{Readers, Row};
use proto::JobId;
use proto::job::{DoneOfTotal, JobPage, JobState, JobView};
use proto::rounding;

use crate::clock::rfc3339;
use crate::queue::{Queue, Result, parse_column};

/// Text that selects the newest job.
const LATEST: &str = "latest";
/// Length of an id, in characters.
const ID_CHARACTERS: usize = 36;
/// Minimum length of a part of an id, in characters.
const MIN_ID_CHARACTERS: usize = 4;
/// Number of newest jobs that are searched for a name or a part of an id.
const MAX_SCANNED_ROWS: u32 = 100_000;

/// Columns of a [`JobView`], up to a condition.
macro_rules! jobs_where {
    ($condition:literal) => {
        concat!(
            "WITH placed AS MATERIALIZED (
                 SELECT number, row_number() OVER (ORDER BY priority DESC, coalesce(place, number * 1048576), number)
                     AS position
                 FROM (SELECT number, priority, place FROM job WHERE finished_at_ms IS NULL AND paused = 0
                       ORDER BY priority DESC, coalesce(place, number * 1048576), number LIMIT 200) AS next)
             SELECT number, id, name, submitter, priority, state, frames_total, frames_stored, tiles_total, tiles_done, rays_total, rays_peak,
                    paused, warnings, error, recorded, based_on,
                    CASE WHEN based_on IS NULL THEN 0 ELSE (SELECT count(*) FROM tile WHERE tile.job = job.number AND kept = 1) END
                    AS tiles_kept,
                    CASE WHEN finished_at_ms IS NULL AND paused = 0
                         THEN (SELECT position FROM placed WHERE placed.number = job.number) END AS queue_position, created_at_ms, started_at_ms, finished_at_ms, nodes,
                    finished_at_ms IS NULL AND (frames_opened < frames_total OR EXISTS (
                        SELECT 1 FROM tile WHERE tile.job = job.number AND tile.state = 'ready' AND kind = 'render'))
                    AS waits,
                    (SELECT max(coalesce(max_nodes, 9223372036854775807)) FROM worker
                     WHERE state <> 'gone' AND state IN ('starting', 'ready')) AS farm_max_nodes,
                    (SELECT value <> 0 FROM meta WHERE name = 'paused') AS farm_paused
             FROM job WHERE cleanup IS DISTINCT FROM 'delete' AND ",
            $condition
        )
    };
}
pub(super) use jobs_where;

/// Picture of a frame, as recorded in the database.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum StoredImage {
    /// The picture is stored.
    Stored {
        /// BLAKE3 of its bytes, in hex.
        hash: String,
        /// Its size.
        size_bytes: u64,
        /// Its media type.
        media_type: String,
    },
    /// The picture is not stored; its job is in this state.
    NotYet(JobState),
    /// The job has fewer frames.
    NoFrame(u32),
    /// The job does not exist.
    NoJob,
}

/// Whether a picture with this cache key is stored.
pub(super) async fn has_picture(readers: &Readers, key: &str) -> Result<bool> {
    let found: Option<i64> =
        db::query_scalar("SELECT 1 FROM picture WHERE key = ?").bind(key).fetch_optional(readers).await?;
    Ok(found.is_some())
}

/// Reads a row with the columns of [`jobs_where`].
pub(super) fn read_job(row: &Row, wall_ms: i64) -> Result<JobView> {
    let id: String = row.get("id")?;
    let state = finish::job_state(&row.get::<String>("state")?)?;
    let warnings: String = row.get("warnings")?;
    let mut warnings: Vec<String> = parse_column("job.warnings", &warnings, |text| serde_json::from_str(text).ok())?;
    warnings.extend(too_large(row)?);
    let started_at_ms: Option<i64> = row.get("started_at_ms")?;
    let rays_total: i64 = row.get("rays_total")?;
    let progress = row.get::<i64>("rays_peak")? as f64 / rays_total as f64;
    let error: Option<String> = row.get("error")?;
    let based_on: Option<String> = row.get("based_on")?;
    let (paused, farm_paused): (bool, bool) = (row.get("paused")?, row.get("farm_paused")?);
    Ok(JobView {
        id: parse_column("job.id", &id, |id| id.parse().ok())?,
        name: row.get("name")?,
        submitter: row.get("submitter")?,
        priority: row.get("priority")?,
        state,
        paused,
        progress: rounding::fraction(progress),
        tiles: DoneOfTotal { done: row.get("tiles_done")?, total: row.get("tiles_total")? },
        frames: DoneOfTotal { done: row.get("frames_stored")?, total: row.get("frames_total")? },
        recorded: row.get("recorded")?,
        based_on: based_on.map(|id| parse_column("job.based_on", &id, |id| id.parse().ok())).transpose()?,
        tiles_kept: row.get("tiles_kept")?,
        queue_position: row.get("queue_position")?,
        errors: error.into_iter().collect(),
        warnings,
        created_at: rfc3339(row.get("created_at_ms")?),
        started_at: started_at_ms.map(rfc3339),
        finished_at: row.get::<Option<i64>>("finished_at_ms")?.map(rfc3339),
        eta_seconds: started_at_ms
            .filter(|_| state == JobState::Running && !paused && !farm_paused)
            .and_then(|start| eta(start, wall_ms, progress)),
    })
}

/// Warning for a job whose scene is too large for every current worker.
fn too_large(row: &Row) -> Result<Option<String>> {
    let nodes: i64 = row.get("nodes")?;
    let farm_max_nodes: Option<i64> = row.get("farm_max_nodes")?;
    let waits: bool = row.get("waits")?;
    Ok(farm_max_nodes.filter(|max_nodes| waits && *max_nodes < nodes).map(|max_nodes| {
        format!(
            "no worker of this farm renders scenes of more than {max_nodes} nodes, and this scene has {nodes}: \
             start a CPU worker (`sdfarm worker --device cpu`)"
        )
    }))
}

/// Estimated seconds left, assuming constant speed.
fn eta(started_at_ms: i64, wall_ms: i64, progress: f64) -> Option<f64> {
    let elapsed_seconds = (wall_ms - started_at_ms).max(0) as f64 / 1000.0;
    (progress > 0.0).then(|| rounding::seconds(elapsed_seconds * (1.0 - progress) / progress))
}

impl Queue {
    /// A job's view.
    pub(crate) async fn job(&self, id: JobId) -> Result<Option<JobView>> {
        let row = db::query(jobs_where!("id = ?")).bind(id.to_string()).fetch_optional(self.readers()).await?;
        row.map(|row| read_job(&row, self.clock.wall_ms())).transpose()
    }

    /// Page of jobs with numbers below `before`, newest first; only the jobs of `submitter`, if given.
    pub(crate) async fn jobs(
        &self,
        submitter: Option<&str>,
        state: Option<JobState>,
        limit: u32,
        before: Option<i64>,
    ) -> Result<JobPage> {
        let query = match (submitter, state) {
            (None, None) => db::query(jobs_where!("number < ? ORDER BY number DESC LIMIT ?")),
            (None, Some(state)) => {
                db::query(jobs_where!("state = ? AND number < ? ORDER BY number DESC LIMIT ?")).bind(state.name())
            }
            (Some(submitter), None) => {
                db::query(jobs_where!("submitter = ? AND number < ? ORDER BY number DESC LIMIT ?")).bind(submitter)
            }
            (Some(submitter), Some(state)) => {
                db::query(jobs_where!("submitter = ? AND state = ? AND number < ? ORDER BY number DESC LIMIT ?"))
                    .bind(submitter)
                    .bind(state.name())
            }
        };
        let query = query.bind(before.unwrap_or(i64::MAX));
        let mut rows = query.bind(limit + 1).fetch_all(self.readers()).await?;
        let more = rows.len() > limit as usize;
        rows.truncate(limit as usize);
        let last: Option<i64> = rows.last().filter(|_| more).map(|row| row.get("number")).transpose()?;
        let wall_ms = self.clock.wall_ms();
        let jobs = rows.iter().map(|row| read_job(row, wall_ms)).collect::<Result<Vec<_>>>()?;
        Ok(JobPage { jobs, next_cursor: last.map(|number| number.to_string()) })
    }

    /// Jobs that match a text, newest first: `latest`, a complete id, its first or last characters, or a name;
    /// only the jobs of `submitter`, if given.
    pub(crate) async fn jobs_like(&self, submitter: Option<&str>, text: &str, limit: u32) -> Result<JobPage> {
        if text == LATEST {
            let mut page = self.jobs(submitter, None, 1, None).await?;
            page.next_cursor = None;
            return Ok(page);
        }
        let id = text.to_ascii_lowercase();
        let is_part = (MIN_ID_CHARACTERS..=ID_CHARACTERS).contains(&id.len())
            && id.bytes().all(|byte| byte == b'-' || byte.is_ascii_hexdigit());
        // Only the newest jobs are searched; older ones are found by their complete id.
        let rows = db::query(jobs_where!(
            "number IN (
                 SELECT number FROM (SELECT number, id, name, submitter FROM job ORDER BY number DESC LIMIT ?1) AS newest
                 WHERE (?2 IS NULL OR submitter = ?2) AND (name = ?3 OR (?4 = 1 AND (substr(id, 1, CAST(?5 AS INTEGER)) = ?6
                           OR substr(id, length(id) + 1 - CAST(?5 AS INTEGER)) = ?6)))
                 UNION SELECT number FROM job WHERE id = ?6 AND (?2 IS NULL OR submitter = ?2)
             ) ORDER BY number DESC LIMIT ?7"
        ))
        .bind(MAX_SCANNED_ROWS)
        .bind(submitter)
        .bind(text)
        .bind(is_part)
        .bind(i64::try_from(id.len()).expect("the name of a job is short"))
        .bind(&id)
        .bind(limit)
        .fetch_all(self.readers())
        .await?;
        let wall_ms = self.clock.wall_ms();
        let jobs = rows.iter().map(|row| read_job(row, wall_ms)).collect::<Result<Vec<_>>>()?;
        Ok(JobPage { jobs, next_cursor: None })
    }

    /// File of the job with this id, as it was submitted.
    pub(crate) async fn file(&self, id: JobId) -> Result<Option<String>> {
        db::query_scalar("SELECT text FROM job_file JOIN job ON number = job WHERE id = ?")
            .bind(id.to_string())
            .fetch_optional(self.readers())
            .await
    }

    /// File of the job with this number, as it was submitted.
    pub(crate) async fn file_of(&self, number: i64) -> Result<Option<String>> {
        db::query_scalar("SELECT text FROM job_file WHERE job = ?").bind(number).fetch_optional(self.readers()).await
    }

    /// Submitter of the job with this number.
    pub(crate) async fn submitter_of(&self, number: i64) -> Result<Option<String>> {
        db::query_scalar("SELECT submitter FROM job WHERE number = ?").bind(number).fetch_optional(self.readers()).await
    }

    /// Picture of a frame.
    pub(crate) async fn image(&self, id: JobId, frame: u32) -> Result<StoredImage> {
        let row = db::query(
            "SELECT job.state, job.frames_total, job.media_type, frame.picture, frame.size_bytes
             FROM job LEFT JOIN frame ON frame.job = job.number AND frame.number = ? WHERE job.id = ?",
        )
        .bind(frame)
        .bind(id.to_string())
        .fetch_optional(self.readers())
        .await?;
        let Some(row) = row else { return Ok(StoredImage::NoJob) };
        let frames: u32 = row.get("frames_total")?;
        if frame >= frames {
            return Ok(StoredImage::NoFrame(frames));
        }
        let state = finish::job_state(&row.get::<String>("state")?)?;
        Ok(match row.get::<Option<String>>("picture")? {
            None => StoredImage::NotYet(state),
            Some(hash) => {
                StoredImage::Stored { hash, size_bytes: row.get("size_bytes")?, media_type: row.get("media_type")? }
            }
        })
    }

    /// Number of ready pool workers.
    pub(crate) async fn pool_ready(&self) -> Result<u32> {
        db::query_scalar("SELECT count(*) FROM worker WHERE state <> 'gone' AND state = 'ready' AND pool = 1")
            .fetch_one(self.readers())
            .await
    }

    /// Whether the database responds.
    pub(crate) async fn check(&self) -> Result<()> {
        db::query("SELECT value FROM meta").fetch_one(self.readers()).await?;
        Ok(())
    }
}
