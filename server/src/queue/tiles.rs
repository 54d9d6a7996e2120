//! Tiles of a job and their workers: read from the leases, which are deleted an hour after they were granted, and from the
//! record of makers.

pub(super) mod durations;
pub(super) mod recorded;
pub(super) mod reported;
pub(super) mod results;
pub(super) mod undo;

use std::collections::HashMap;

use proto::tile_history::{TileLeaseView, TileOutcome, TilePage, TileState, TileView};
use proto::{JobId, LeaseId, rounding};

use crate::clock::rfc3339;
use crate::db::{self, Row};
use crate::queue::{Queue, Result, json_numbers, parse_column};

/// Tile that a page begins after.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TileCursor {
    /// Its frame.
    pub(crate) frame: u32,
    /// Its position in the frame.
    pub(crate) position: i64,
}

impl TileCursor {
    /// Reads a cursor.
    pub(crate) fn parse(text: &str) -> Option<Self> {
        let (frame, position) = text.split_once('-')?;
        Some(Self { frame: frame.parse().ok()?, position: position.parse().ok().filter(|position| *position >= 0)? })
    }
}

impl std::fmt::Display for TileCursor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}-{}", self.frame, self.position)
    }
}

/// Tiles of a job after a cursor.
const TILES_SQL: &str = "SELECT id, frame, position, x_px, y_px, width_px, height_px, state, epoch FROM tile
     WHERE job = ? AND (frame, position) > (?, ?) AND position >= 0 ORDER BY frame, position LIMIT ?";

/// Tiles of one frame after a position.
const FRAME_TILES_SQL: &str = "SELECT id, frame, position, x_px, y_px, width_px, height_px, state, epoch FROM tile
     WHERE job = ? AND frame = ? AND position > ? ORDER BY position LIMIT ?";

const LEASES_SQL: &str =
    "SELECT lease.id, lease.tile, lease.worker, worker.name, worker.device, lease.granted_ms, lease.ended,
            lease.ended_at_ms, lease.took_ms, lease.used_us
     FROM @numbers(?) @join lease ON lease.tile = listed.value @join worker ON worker.id = lease.worker
     ORDER BY lease.tile, lease.epoch";

const MAKERS_SQL: &str =
    "SELECT tile_maker.tile, maker.worker, maker.name, maker.device, tile_maker.ended_at_ms, tile_maker.took_ms,
            tile_maker.used_us
     FROM @numbers(?) @join tile_maker ON tile_maker.tile = listed.value
     @join maker ON maker.number = tile_maker.maker";

impl Queue {
    /// Page of a job's tiles, or of one frame's; `None` if there is no such job.
    pub(crate) async fn tiles(
        &self,
        id: JobId,
        frame: Option<u32>,
        after: Option<TileCursor>,
        limit: u32,
    ) -> Result<Option<TilePage>> {
        let job: Option<i64> =
            db::query_scalar("SELECT number FROM job WHERE id = ? AND cleanup IS DISTINCT FROM 'delete'")
                .bind(id.to_string())
                .fetch_optional(self.readers())
                .await?;
        let Some(job) = job else { return Ok(None) };
        let query = match frame {
            None => {
                let after = after.unwrap_or(TileCursor { frame: 0, position: -1 });
                db::query(TILES_SQL).bind(job).bind(after.frame).bind(after.position)
            }
            Some(frame) => {
                let position = after.filter(|after| after.frame == frame).map_or(-1, |after| after.position);
                db::query(FRAME_TILES_SQL).bind(job).bind(frame).bind(position)
            }
        };
        let mut rows = query.bind(limit + 1).fetch_all(self.readers()).await?;
        let more = rows.len() > limit as usize;
        rows.truncate(limit as usize);
        let mut ids = Vec::with_capacity(rows.len());
        for row in &rows {
            ids.push(row.get::<i64>("id")?);
        }
        let mut leases: HashMap<i64, Vec<TileLeaseView>> = HashMap::new();
        let ids = json_numbers(ids);
        for row in &db::query(MAKERS_SQL).bind(&ids).fetch_all(self.readers()).await? {
            leases.entry(row.get("tile")?).or_default().push(maker_view(row)?);
        }
        for row in &db::query(LEASES_SQL).bind(&ids).fetch_all(self.readers()).await? {
            leases.entry(row.get("tile")?).or_default().push(self.lease_view(row)?);
        }
        let mut tiles = Vec::with_capacity(rows.len());
        let mut last = None;
        for row in &rows {
            last = Some(TileCursor { frame: row.get("frame")?, position: row.get("position")? });
            tiles.push(tile_view(row, leases.remove(&row.get::<i64>("id")?).unwrap_or_default())?);
        }
        let next_cursor = last.filter(|_| more).map(|cursor| cursor.to_string());
        Ok(Some(TilePage { tiles, next_cursor }))
    }

    fn lease_view(&self, row: &Row) -> Result<TileLeaseView> {
        let worker: String = row.get("worker")?;
        let outcome = match row.get::<Option<String>>("ended")? {
            None => None,
            Some(ended) => Some(parse_column("lease.ended", &ended, outcome)?),
        };
        let ended_at_ms: Option<i64> = row.get("ended_at_ms")?;
        let took_ms: Option<i64> = row.get("took_ms")?;
        let started_at_ms = match (outcome, ended_at_ms, took_ms) {
            (None, _, _) => self.clock.wall_ms() - (self.clock.now_ms() - row.get::<i64>("granted_ms")?).max(0),
            (Some(_), Some(ended_at_ms), Some(took_ms)) => ended_at_ms - took_ms,
            // Its server ended before it did.
            (Some(_), _, _) => {
                let id: String = row.get("id")?;
                let made_at_ms = parse_column("lease.id", &id, |id| id.parse::<LeaseId>().ok())?.made_at_ms();
                ended_at_ms.map_or(made_at_ms, |ended_at_ms| made_at_ms.min(ended_at_ms))
            }
        };
        let used_us: Option<i64> = row.get("used_us")?;
        Ok(TileLeaseView {
            worker: parse_column("lease.worker", &worker, |id| id.parse().ok())?,
            worker_name: row.get("name")?,
            device: row.get("device")?,
            started_at: rfc3339(started_at_ms),
            ended_at: outcome.map(|_| rfc3339(ended_at_ms.unwrap_or(started_at_ms))),
            outcome,
            seconds: used_us.filter(|_| outcome == Some(TileOutcome::Done)).map(seconds),
        })
    }
}

/// Lease that was recorded before it was deleted.
fn maker_view(row: &Row) -> Result<TileLeaseView> {
    let worker: String = row.get("worker")?;
    let (ended_at_ms, took_ms): (i64, i64) = (row.get("ended_at_ms")?, row.get("took_ms")?);
    let used_us: Option<i64> = row.get("used_us")?;
    Ok(TileLeaseView {
        worker: parse_column("maker.worker", &worker, |id| id.parse().ok())?,
        worker_name: row.get("name")?,
        device: row.get("device")?,
        started_at: rfc3339(ended_at_ms - took_ms),
        ended_at: Some(rfc3339(ended_at_ms)),
        outcome: Some(TileOutcome::Done),
        seconds: used_us.map(seconds),
    })
}

fn seconds(used_us: i64) -> f64 {
    rounding::seconds(used_us as f64 / 1e6)
}

fn tile_view(row: &Row, leases: Vec<TileLeaseView>) -> Result<TileView> {
    let state: String = row.get("state")?;
    Ok(TileView {
        frame: row.get("frame")?,
        x: row.get("x_px")?,
        y: row.get("y_px")?,
        width: row.get("width_px")?,
        height: row.get("height_px")?,
        state: parse_column("tile.state", &state, tile_state)?,
        attempts: row.get("epoch")?,
        leases,
    })
}

fn tile_state(name: &str) -> Option<TileState> {
    Some(match name {
        "ready" => TileState::Ready,
        "leased" => TileState::Leased,
        "done" => TileState::Done,
        "dead" => TileState::Dead,
        "void" => TileState::Void,
        _ => return None,
    })
}

fn outcome(name: &str) -> Option<TileOutcome> {
    Some(match name {
        "done" => TileOutcome::Done,
        "failed" => TileOutcome::Failed,
        "crashed" => TileOutcome::Crashed,
        "lost" => TileOutcome::Lost,
        "interrupted" => TileOutcome::Released,
        "void" => TileOutcome::Void,
        _ => return None,
    })
}
