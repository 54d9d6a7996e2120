//! Claims the next batch of tiles, or the next stitch, for one worker.
//!
//! The order is priority, the submitter served least (see `fair_share`), job, frame, tile, among the jobs whose
//! scene this worker can render; any worker can stitch. If no tile of a job is ready, its next frame is opened;
//! that needs the frame's cache key, which the caller computes outside the transaction.

use crate::db;
use crate::db::{Readers, Row, Statement, Target};
use proto::bounded::RaysPerSecond;
use proto::worker_protocol::{Batch, BatchWork, LeasedTile, StitchInput};
use proto::{JobId, LeaseId, Rect, WorkerId};

use crate::queue::jobs::{fair_share, transitions};
use crate::queue::leases::LOSSES_BEFORE_ISOLATION;
use crate::queue::leases::batch_size::{self, BatchTime, FrameLoad, ReadyTile, WorkerShare};
use crate::queue::leases::straggler::{self, StragglerOutcome};
use crate::queue::tiles::recorded;
use crate::queue::workers::speeds::{self, JobSpeed, measured_sql};
use crate::queue::{Connection, Result, TransitionContext, expect_rows, parse_column};
use crate::tile_plan::TilePlan;

/// Job with something to claim, by priority and age. A test checks that this query needs no full scan.
const NEXT_JOB_SQL: &str = include_str!("next_job.sql");

/// Ready tiles of the job's first frame that has some, or that frame's stitch.
const NEXT_TILES_SQL: &str = include_str!("next_tiles.sql");

/// Time at which the first backed-off tile becomes ready.
const NEXT_RETRY_SQL: &str =
    "SELECT min(not_before_ms) FROM tile WHERE state = 'ready' AND not_before_ms > 0 AND not_before_ms > ?";

/// `max_nodes` of a worker that can render any scene.
pub(in crate::queue) const ANY_NODES: i64 = i64::MAX;

/// Worker that claims.
#[derive(Clone, Copy, Debug)]
pub(in crate::queue) struct ClaimRequest {
    /// Id of the worker.
    pub(in crate::queue) worker: WorkerId,
    /// Its measured camera rays a second.
    pub(in crate::queue) rays_per_second: Option<RaysPerSecond>,
    /// Largest scene it renders, in nodes.
    pub(in crate::queue) max_nodes: i64,
    /// Largest scene that some other ready worker renders, in nodes; -1 if there is no other worker.
    pub(in crate::queue) others_max_nodes: i64,
    /// Whether it takes only work of submitters of whom it holds nothing.
    pub(in crate::queue) beside: bool,
}

/// A new lease on a tile.
#[derive(Clone, Copy, Debug)]
pub(in crate::queue) struct NewLease {
    pub(in crate::queue) tile: i64,
    pub(in crate::queue) lease: LeaseId,
    /// Charge to its submitter, in microseconds of a worker.
    pub(in crate::queue) charged_us: i64,
}

impl NewLease {
    /// Lease without a charge: of a stitch, or a duplicate.
    pub(in crate::queue) fn free(tile: i64, lease: LeaseId) -> Self {
        Self { tile, lease, charged_us: 0 }
    }
}

/// Result of a claim.
#[derive(Clone, Debug)]
pub(in crate::queue) enum ClaimOutcome {
    /// Granted batch, and its time if further batches may be granted with it.
    Run(Batch, Option<BatchTime>),
    /// This frame must be opened first.
    NeedsFrame {
        /// The job's number.
        job: i64,
        /// The frame.
        frame: u32,
        /// Tile plan of its frames.
        plan: TilePlan,
    },
    /// No work now; if a tile is backing off, it is ready after this many milliseconds.
    Nothing(Option<i64>),
}

/// Job whose tiles may be leased.
pub(in crate::queue) struct ClaimableJob {
    pub(in crate::queue) number: i64,
    pub(in crate::queue) id: JobId,
    plan: TilePlan,
    frames_opened: u32,
    pub(super) nodes: i64,
    /// Time limit for rendering a tile.
    pub(in crate::queue) tile_seconds: u32,
    /// Whether its tiles are recorded.
    pub(in crate::queue) recorded: bool,
    /// The job that it is based on.
    pub(in crate::queue) based_on: Option<String>,
    /// Whether none of its tiles has been leased before.
    queued: bool,
    share: fair_share::FairShare,
}

impl ClaimableJob {
    pub(super) fn read(row: &Row) -> Result<Self> {
        let id: String = row.get("id")?;
        Ok(Self {
            number: row.get("number")?,
            id: parse_column("job.id", &id, |id| id.parse().ok())?,
            plan: TilePlan {
                width_px: row.get("width_px")?,
                height_px: row.get("height_px")?,
                samples: row.get("samples")?,
                pixel_bytes: row.get("pixel_bytes")?,
                edge_px: row.get("edge_px")?,
                frames: row.get("frames_total")?,
            },
            frames_opened: row.get("frames_opened")?,
            nodes: row.get("nodes")?,
            tile_seconds: row.get("tile_seconds")?,
            recorded: row.get("recorded")?,
            based_on: row.get("based_on")?,
            queued: row.get("queued")?,
            share: fair_share::FairShare { submitter: row.get("submitter")?, priority: row.get("priority")? },
        })
    }
}

/// Jobs whose next frame no claim opens, because their files are being read.
#[derive(Clone, Debug, Default)]
pub(crate) struct PassedJobs {
    /// Their numbers.
    pub(crate) jobs: Vec<i64>,
    /// Submitters of whom all jobs are passed by.
    pub(crate) submitters: Vec<String>,
}

/// Condition for the tiles that a claim may take: the back-off has ended, the scene is small enough for the
/// worker, and the tile need not avoid this worker unless no other worker could render it.
pub(in crate::queue) struct ClaimFilter {
    pub(super) now_ms: i64,
    pub(in crate::queue) worker: String,
    /// Largest scene that some other worker renders, in nodes; -1 if there is no other worker.
    pub(super) others_max_nodes: i64,
    /// Largest scene that this worker renders, in nodes.
    pub(super) max_nodes: i64,
    /// Whether it takes only work of submitters of whom it holds nothing.
    pub(super) beside: bool,
}

impl ClaimFilter {
    /// Job with something to claim; the next frames of the `passed` jobs do not count.
    pub(super) async fn next_job(
        &self,
        on: impl Into<Target<'_>>,
        passed: &PassedJobs,
    ) -> Result<Option<ClaimableJob>> {
        let (jobs, submitters) = (serde_json::json!(passed.jobs), serde_json::json!(passed.submitters));
        let next = self.bind(NEXT_JOB_SQL).bind(jobs.to_string()).bind(submitters.to_string());
        let row = next.fetch_optional(on).await?;
        row.as_ref().map(ClaimableJob::read).transpose()
    }

    /// Binds the parameters ?1 to ?5, which all statements of a claim share.
    pub(in crate::queue) fn bind(&self, statement: &'static str) -> Statement {
        let statement = db::query(statement).bind(self.now_ms).bind(&self.worker);
        statement.bind(self.others_max_nodes).bind(self.max_nodes).bind(self.beside)
    }
}

/// Claims work for a worker; opens no frame of the `passed` jobs.
pub(in crate::queue) async fn claim(
    connection: &mut Connection,
    claimant: ClaimRequest,
    passed: &PassedJobs,
    context: TransitionContext,
) -> Result<ClaimOutcome> {
    let view = ClaimFilter {
        now_ms: context.now_ms,
        worker: claimant.worker.to_string(),
        others_max_nodes: claimant.others_max_nodes,
        max_nodes: claimant.max_nodes,
        beside: claimant.beside,
    };
    let Some(job) = view.next_job(&mut *connection, passed).await? else {
        if claimant.beside {
            return Ok(ClaimOutcome::Nothing(None));
        }
        return claim_straggler(connection, &view, claimant, context).await;
    };
    let rows = view.bind(NEXT_TILES_SQL).bind(job.number).bind(job.nodes).fetch_all(&mut *connection).await?;
    let Some(next) = rows.first() else {
        return Ok(ClaimOutcome::NeedsFrame { job: job.number, frame: job.frames_opened, plan: job.plan });
    };
    let frame: u32 = next.get("frame")?;
    let (work, time) = if next.get::<String>("kind")? == "stitch" {
        let lease = LeaseId::new();
        grant(connection, &[NewLease::free(next.get("id")?, lease)], &view.worker, context).await?;
        (stitch_work(connection, job.number, frame, lease).await?, None)
    } else {
        claim_tiles(connection, &job, &rows, &view, claimant, context).await?
    };
    if job.queued {
        transitions::start(connection, job.number, context).await?;
    }
    let recording = recorded::recording(connection, &job, frame, &work).await?;
    Ok(ClaimOutcome::Run(Batch { job: job.id, frame, tile_seconds: Some(job.tile_seconds), work, recording }, time))
}

/// Whether there is work for a worker that can render any scene and need avoid none.
pub(in crate::queue) async fn has_work(readers: &Readers, now_ms: i64) -> Result<bool> {
    let (worker, others_max_nodes, max_nodes) = (String::new(), ANY_NODES, ANY_NODES);
    let anyone = ClaimFilter { now_ms, worker, others_max_nodes, max_nodes, beside: false };
    Ok(anyone.next_job(readers, &PassedJobs::default()).await?.is_some())
}

/// Called if no tile is ready: searches for a straggler to duplicate.
async fn claim_straggler(
    connection: &mut Connection,
    view: &ClaimFilter,
    claimant: ClaimRequest,
    context: TransitionContext,
) -> Result<ClaimOutcome> {
    let again_ms = match straggler::claim(connection, view, claimant, context).await? {
        StragglerOutcome::Run(run) => return Ok(ClaimOutcome::Run(run, None)),
        StragglerOutcome::Nothing(again_ms) => again_ms,
    };
    let ready_ms: Option<i64> = db::query_scalar(NEXT_RETRY_SQL).bind(context.now_ms).fetch_one(connection).await?;
    Ok(ClaimOutcome::Nothing(again_ms.into_iter().chain(ready_ms.map(|ready_ms| ready_ms - context.now_ms)).min()))
}

/// A job by its number.
pub(in crate::queue) async fn job(connection: &mut Connection, number: i64) -> Result<ClaimableJob> {
    let row = db::query(
        "SELECT number, id, width_px, height_px, samples, pixel_bytes, edge_px, frames_total, frames_opened, nodes,
                tile_seconds, recorded, based_on, state = 'queued' AS queued, submitter, priority FROM job WHERE number = ?",
    )
    .bind(number)
    .fetch_one(connection)
    .await?;
    ClaimableJob::read(&row)
}

/// Load of a job's frame, for the batch size.
pub(in crate::queue) fn frame_load(job: &ClaimableJob) -> FrameLoad {
    let frames_behind = job.plan.frames.saturating_sub(job.frames_opened);
    FrameLoad {
        tiles: job.plan.tiles().len() as u64,
        rays: job.plan.frame_rays(),
        size_bytes: job.plan.frame_bytes(),
        rays_unopened: u64::from(frames_behind) * job.plan.frame_rays(),
    }
}

/// Largest scene that a ready worker other than this one renders, in nodes; -1 if there is none.
pub(in crate::queue) async fn others_max_nodes(connection: &mut Connection, worker: &str) -> Result<i64> {
    db::query_scalar(
        "SELECT coalesce(max(coalesce(max_nodes, ?)), -1) FROM worker
         WHERE state <> 'gone' AND state = 'ready' AND id <> ?",
    )
    .bind(ANY_NODES)
    .bind(worker)
    .fetch_one(connection)
    .await
}

/// Ready workers that can render a scene of this size: speeds of this worker and of the others.
struct Peers {
    /// Camera rays per second of this worker, if they were measured in the job.
    own: Option<f64>,
    /// Camera rays per second of the fastest other worker, measured in the job, or else reported.
    fastest_other: Option<f64>,
    /// Camera rays per second of the fastest worker measured in the job.
    fastest_measured: Option<f64>,
    /// Mean camera rays per second of the others measured in the job.
    mean_measured: Option<f64>,
    /// Mean camera rays per second that the others report.
    mean_reported: Option<f64>,
    /// Number of the others.
    others: i64,
}

impl Peers {
    /// Speeds that the batch size depends on: this worker's, by its own report (`overall`) if none was measured in the
    /// job, and that of the others. A report may be of much lighter scenes, so it counts no more than the fastest speed
    /// measured in the job, and others count as the mean of those measured, if there are any.
    fn share(&self, overall: Option<f64>) -> WorkerShare {
        let capped = |speed: f64| speed.min(self.fastest_measured.unwrap_or(f64::INFINITY));
        let speed = self.own.map(JobSpeed::Measured).or(overall.map(capped).map(JobSpeed::Overall));
        let mean_other = self.mean_measured.or(self.own).or(self.mean_reported);
        WorkerShare {
            speed,
            mean_other: mean_other.or(overall).unwrap_or(fair_share::DEFAULT_RAYS_PER_SECOND),
            others: self.others.unsigned_abs(),
            fastest_other: self.fastest_other.map(capped),
        }
    }
}

async fn peers(
    connection: &mut Connection,
    worker: &str,
    job: &ClaimableJob,
    context: TransitionContext,
) -> Result<Peers> {
    let row = db::query(concat!(
        "SELECT max(measured) FILTER (WHERE id = ?3) AS own,
                max(coalesce(measured, reported)) FILTER (WHERE id <> ?3) AS fastest_other,
                max(measured) AS fastest_measured,
                avg(measured) FILTER (WHERE id <> ?3) AS mean_measured,
                avg(reported) FILTER (WHERE id <> ?3) AS mean_reported,
                count(*) FILTER (WHERE id <> ?3) AS others
         FROM (SELECT worker.id, rays_per_second AS reported, ",
        measured_sql!(),
        " AS measured
               FROM worker LEFT JOIN speed ON speed.job = ?4 AND speed.worker = worker.id AND speed.at_ms > ?5
               WHERE worker.state <> 'gone' AND worker.state = 'ready' AND coalesce(max_nodes, ?1) >= ?2) AS peers"
    ))
    .bind(ANY_NODES)
    .bind(job.nodes)
    .bind(worker)
    .bind(job.number)
    .bind(context.now_ms - speeds::MAX_AGE_MS)
    .fetch_one(connection)
    .await?;
    Ok(Peers {
        own: row.get("own")?,
        fastest_other: row.get("fastest_other")?,
        fastest_measured: row.get("fastest_measured")?,
        mean_measured: row.get("mean_measured")?,
        mean_reported: row.get("mean_reported")?,
        others: row.get("others")?,
    })
}

/// Number of other ready workers that share the job, because they hold tiles of it, or nothing; at most `limit`, so that
/// of many workers few are read.
async fn sharing_workers(connection: &mut Connection, worker: &str, job: &ClaimableJob, limit: u64) -> Result<u64> {
    let count: i64 = db::query_scalar(
        "SELECT count(*) FROM (
             SELECT 1 FROM worker
             WHERE worker.state <> 'gone' AND worker.state = 'ready' AND coalesce(max_nodes, ?1) >= ?2 AND id <> ?3
               AND coalesce((SELECT tile.job = ?4 FROM lease @index(lease_live_by_worker)
                   @join tile ON tile.id = lease.tile
                   WHERE lease.worker = worker.id AND lease.ended IS NULL LIMIT 1), 1 = 1)
             LIMIT ?5) AS sharing",
    )
    .bind(ANY_NODES)
    .bind(job.nodes)
    .bind(worker)
    .bind(job.number)
    .bind(i64::try_from(limit).unwrap_or(i64::MAX))
    .fetch_one(connection)
    .await?;
    Ok(count.unsigned_abs())
}

async fn claim_tiles(
    connection: &mut Connection,
    job: &ClaimableJob,
    rows: &[Row],
    view: &ClaimFilter,
    claimant: ClaimRequest,
    context: TransitionContext,
) -> Result<(BatchWork, Option<BatchTime>)> {
    let peers = peers(connection, &view.worker, job, context).await?;
    let share = peers.share(claimant.rays_per_second.map(RaysPerSecond::get));
    let whole = frame_load(job);
    let ready = rows.iter().map(read_ready).collect::<Result<Vec<_>>>()?;
    let mut length = batch_size::batch_len(&ready, whole, share);
    if length < batch_size::batch_len(&ready, whole, WorkerShare { others: 0, ..share }) {
        // Only now it matters how many of the others share the job.
        let limit = batch_size::sharing_limit(&ready, whole, share);
        let others = sharing_workers(connection, &view.worker, job, limit).await?;
        length = batch_size::batch_len(&ready, whole, WorkerShare { others, ..share });
    }
    let (tiles, mut grants) = new_leases(&rows[..length])?;
    let rays: Vec<u64> = ready[..length].iter().map(|tile| tile.rays).collect();
    let charges_us = fair_share::estimates_us(&rays, share.speed.or(share.fastest_other.map(JobSpeed::Overall)));
    for (grant, charged_us) in grants.iter_mut().zip(&charges_us) {
        grant.charged_us = *charged_us;
    }
    grant(connection, &grants, &view.worker, context).await?;
    fair_share::charge(connection, &job.share, charges_us.iter().sum()).await?;
    let whole_frame = !job.recorded && batch_size::is_whole_frame(length, whole);
    let time = if whole_frame { batch_size::frame_time(&ready, whole, share) } else { None };
    Ok((BatchWork::Render { whole_frame, tiles }, time))
}

/// New leases, both as sent to the worker and as stored.
pub(in crate::queue) fn new_leases(rows: &[Row]) -> Result<(Vec<LeasedTile>, Vec<NewLease>)> {
    let mut tiles = Vec::with_capacity(rows.len());
    let mut grants = Vec::with_capacity(rows.len());
    for row in rows {
        let tile = LeasedTile {
            lease: LeaseId::new(),
            index: row.get("position")?,
            rect: Rect {
                x: row.get("x_px")?,
                y: row.get("y_px")?,
                width: row.get("width_px")?,
                height: row.get("height_px")?,
            },
        };
        grants.push(NewLease::free(row.get("id")?, tile.lease));
        tiles.push(tile);
    }
    Ok((tiles, grants))
}

/// Ready tile, with the data that the batch size depends on.
pub(in crate::queue) fn read_ready(row: &Row) -> Result<ReadyTile> {
    Ok(ReadyTile { rays: row.get("rays")?, is_isolated: row.get::<i64>("lost")? >= LOSSES_BEFORE_ISOLATION })
}

/// Tile row of a frame's stitch.
pub(in crate::queue) async fn stitch_tile(connection: &mut Connection, job: i64, frame: u32) -> Result<i64> {
    db::query_scalar("SELECT id FROM tile WHERE job = ? AND frame = ? AND position = -1")
        .bind(job)
        .bind(frame)
        .fetch_one(connection)
        .await
}

/// Inputs of a stitch.
pub(in crate::queue) async fn stitch_work(
    connection: &mut Connection,
    job: i64,
    frame: u32,
    lease: LeaseId,
) -> Result<BatchWork> {
    let rows = db::query(
        "SELECT position, x_px, y_px, width_px, height_px, blob, blob_bytes FROM tile
         WHERE job = ? AND frame = ? AND kind = 'render' ORDER BY position",
    )
    .bind(job)
    .bind(frame)
    .fetch_all(connection)
    .await?;
    let parts = rows.iter().map(read_part).collect::<Result<Vec<_>>>()?;
    Ok(BatchWork::Stitch { lease, inputs: parts })
}

pub(in crate::queue) fn read_part(row: &Row) -> Result<StitchInput> {
    Ok(StitchInput {
        index: row.get("position")?,
        rect: Rect {
            x: row.get("x_px")?,
            y: row.get("y_px")?,
            width: row.get("width_px")?,
            height: row.get("height_px")?,
        },
        hash: row.get("blob")?,
        size_bytes: row.get("blob_bytes")?,
    })
}

/// Leases tiles to a worker, each under its next epoch.
async fn grant(
    connection: &mut Connection,
    grants: &[NewLease],
    worker: &str,
    context: TransitionContext,
) -> Result<()> {
    let tiles = crate::queue::json_numbers(grants.iter().map(|grant| grant.tile));
    let leased = db::query(
        "UPDATE tile SET state = 'leased', epoch = epoch + 1, not_before_ms = 0
         WHERE @unindexed(state) = 'ready' AND id IN (SELECT value FROM @numbers(?))",
    )
    .bind(tiles)
    .execute(&mut *connection)
    .await?;
    expect_rows("tile: ready to leased", grants.len() as u64, leased)?;
    make_leases(connection, grants, worker, context).await
}

/// Inserts the leases of newly leased tiles.
pub(in crate::queue) async fn make_leases(
    connection: &mut Connection,
    grants: &[NewLease],
    worker: &str,
    context: TransitionContext,
) -> Result<()> {
    let rows: Vec<(i64, String, i64)> =
        grants.iter().map(|grant| (grant.tile, grant.lease.to_string(), grant.charged_us)).collect();
    let made = db::query(
        "INSERT INTO lease (id, tile, epoch, worker, generation, granted_ms, expires_ms, charged_us, charged_priority)
         SELECT listed.value ->> 1, tile.id, tile.epoch, ?1, ?2, ?3, ?4, CAST(listed.value ->> 2 AS BIGINT), job.priority
         FROM @rows(?5) @join tile ON tile.id = CAST(listed.value ->> 0 AS BIGINT)
         @join job ON job.number = tile.job",
    )
    .bind(worker)
    .bind(context.generation)
    .bind(context.now_ms)
    .bind(context.now_ms + context.lease_ms)
    .bind(serde_json::json!(rows).to_string())
    .execute(connection)
    .await?;
    expect_rows("lease: granted", grants.len() as u64, made)
}
