//! Results: a tile's blob, a frame's picture, or why there is none.
//!
//! A result counts only under a live lease. Tile, frame, job and picture change in the one
//! transaction that ends the lease, so that an effect happens once or not at all.

use std::collections::BTreeMap;

use proto::work::{Outcome, Report};
use proto::{LeaseId, WorkerId};
use sqlx::Row;

use super::lease::{self, Cause, Held};
use super::{Connection, Moment, Result, Ring, counted, end, rows};
use crate::store::StoreError;

/// What came of some results.
#[derive(Clone, Debug, Default)]
pub(super) struct Delivered {
    /// Leases that were no longer live: their results had no effect.
    pub(super) lost: Vec<LeaseId>,
    /// What to ring for.
    pub(super) ring: Ring,
    /// Blobs of frames that are stored now.
    pub(super) leftovers: Vec<String>,
}

/// Takes in a worker's results.
pub(super) async fn deliver(
    connection: &mut Connection,
    worker: WorkerId,
    reports: &[Report],
    moment: Moment,
) -> Result<Delivered> {
    let mut delivered = Delivered::default();
    let mut pictures: BTreeMap<(&str, u64), Vec<LeaseId>> = BTreeMap::new();
    for report in reports {
        if let Outcome::Picture { hash, size_bytes } = &report.outcome {
            pictures.entry((hash, *size_bytes)).or_default().push(report.lease);
        }
    }
    for ((hash, size_bytes), leases) in pictures {
        take_picture(connection, worker, &leases, hash, size_bytes, moment, &mut delivered).await?;
    }
    for report in reports {
        if !matches!(report.outcome, Outcome::Picture { .. }) {
            take_result(connection, worker, report, moment, &mut delivered).await?;
        }
    }
    Ok(delivered)
}

async fn take_result(
    connection: &mut Connection,
    worker: WorkerId,
    report: &Report,
    moment: Moment,
    delivered: &mut Delivered,
) -> Result<()> {
    let Some(held) = lease::held(connection, worker, &[report.lease]).await?.pop() else {
        delivered.lost.push(report.lease);
        return compare(connection, report).await;
    };
    let ring = match &report.outcome {
        Outcome::Blob { hash, size_bytes } if !held.stitch => finish_tile(connection, &held, hash, *size_bytes).await?,
        Outcome::BadBlobs { tiles } if held.stitch => reopen(connection, &held, tiles, moment).await?,
        Outcome::Failed { message } => lease::give_up(connection, &held, Cause::Failed, message, moment).await?,
        Outcome::HandedBack => {
            lease::give_up(connection, &held, Cause::Interrupted, "it was handed back", moment).await?
        }
        Outcome::Blob { .. } | Outcome::BadBlobs { .. } | Outcome::Picture { .. } => {
            let message = "its worker answered with what was not asked for";
            lease::give_up(connection, &held, Cause::Failed, message, moment).await?
        }
    };
    delivered.ring.add(ring);
    Ok(())
}

/// A late result has no effect, but it must be the same as the first.
async fn compare(connection: &mut Connection, report: &Report) -> Result<()> {
    let Outcome::Blob { hash, .. } = &report.outcome else { return Ok(()) };
    let first: Option<Option<String>> =
        sqlx::query_scalar("SELECT tile.blob FROM lease JOIN tile ON tile.id = lease.tile WHERE lease.id = ?")
            .bind(report.lease.to_string())
            .fetch_optional(connection)
            .await?;
    if let Some(Some(first)) = first
        && first != *hash
    {
        tracing::error!(
            code = "nondeterministic_tile", lease = %report.lease, %first, second = %hash,
            "two workers rendered one tile differently; the first result stays"
        );
    }
    Ok(())
}

/// A tile is done; the last one of a frame makes its stitch.
async fn finish_tile(connection: &mut Connection, held: &Held, hash: &str, size_bytes: u64) -> Result<Ring> {
    lease::end_lease(connection, &held.lease, "done").await?;
    let done =
        sqlx::query("UPDATE tile SET state = 'done', blob = ?, blob_bytes = ? WHERE id = ? AND state = 'leased'")
            .bind(hash)
            .bind(size_bytes.cast_signed())
            .bind(held.tile)
            .execute(&mut *connection)
            .await?;
    counted("tile: leased to done", 1, &done)?;
    end::progress(connection, held.job, end::Progress { tiles: 1, rays: held.rays, frames: 0 }).await?;
    let complete: bool = sqlx::query_scalar(
        "UPDATE frame SET tiles_done = tiles_done + 1 WHERE job = ? AND number = ? AND state = 'open'
         RETURNING tiles_done = tiles_total",
    )
    .bind(held.job)
    .bind(held.frame)
    .fetch_one(&mut *connection)
    .await?;
    if !complete {
        return Ok(Ring::default());
    }
    begin_stitch(connection, held.job, held.frame).await?;
    Ok(Ring::WORK)
}

async fn begin_stitch(connection: &mut Connection, job: i64, frame: u32) -> Result<()> {
    let stitching = sqlx::query("UPDATE frame SET state = 'stitching' WHERE job = ? AND number = ? AND state = 'open'")
        .bind(job)
        .bind(frame)
        .execute(&mut *connection)
        .await?;
    counted("frame: open to stitching", 1, &stitching)?;
    let made = sqlx::query(
        "INSERT INTO tile (job, frame, kind, position, x_px, y_px, width_px, height_px, rays, state)
         SELECT number, ?2, 'stitch', -1, 0, 0, width_px, height_px, 0, 'ready' FROM job WHERE number = ?1
         ON CONFLICT (job, frame, position) DO UPDATE SET state = 'ready' WHERE state = 'void'",
    )
    .bind(job)
    .bind(frame)
    .execute(connection)
    .await?;
    counted("tile: stitch made", 1, &made)
}

/// The stitch found blobs missing or damaged: those tiles are rendered again, then stitched anew.
async fn reopen(connection: &mut Connection, held: &Held, positions: &[u32], moment: Moment) -> Result<Ring> {
    let rays: Vec<i64> = sqlx::query_scalar(
        "UPDATE tile SET state = 'ready', blob = NULL, blob_bytes = NULL
         WHERE job = ? AND frame = ? AND kind = 'render' AND state = 'done'
           AND position IN (SELECT value FROM json_each(?)) RETURNING rays",
    )
    .bind(held.job)
    .bind(held.frame)
    .bind(super::json_numbers(positions.iter().map(|position| i64::from(*position))))
    .fetch_all(&mut *connection)
    .await?;
    let ring = lease::give_up(connection, held, Cause::Lost, "its blobs were damaged again and again", moment).await?;
    if rays.is_empty() || !is_stitching(connection, held).await? {
        return Ok(ring);
    }
    tracing::warn!(job = held.job, frame = held.frame, tiles = rays.len(), "blobs are damaged; rendering them again");
    let void = sqlx::query("UPDATE tile SET state = 'void' WHERE id = ? AND state = 'ready'")
        .bind(held.tile)
        .execute(&mut *connection)
        .await?;
    counted("tile: stitch void", 1, &void)?;
    let count = rows(rays.len());
    let open = sqlx::query(
        "UPDATE frame SET state = 'open', tiles_done = tiles_done - ? WHERE job = ? AND number = ? AND state = 'stitching'",
    )
    .bind(count)
    .bind(held.job)
    .bind(held.frame)
    .execute(&mut *connection)
    .await?;
    counted("frame: stitching to open", 1, &open)?;
    let back = end::Progress { tiles: -count, rays: -rays.iter().sum::<i64>(), frames: 0 };
    end::progress(connection, held.job, back).await?;
    Ok(ring)
}

async fn is_stitching(connection: &mut Connection, held: &Held) -> Result<bool> {
    let stitching: Option<bool> =
        sqlx::query_scalar("SELECT state = 'stitching' FROM frame WHERE job = ? AND number = ?")
            .bind(held.job)
            .bind(held.frame)
            .fetch_optional(connection)
            .await?;
    Ok(stitching == Some(true))
}

/// A frame's picture: for its stitch, or for every tile of the frame at once.
async fn take_picture(
    connection: &mut Connection,
    worker: WorkerId,
    leases: &[LeaseId],
    hash: &str,
    size_bytes: u64,
    moment: Moment,
    delivered: &mut Delivered,
) -> Result<()> {
    let held = lease::held(connection, worker, leases).await?;
    let live: Vec<&str> = held.iter().map(|held| held.lease.as_str()).collect();
    delivered.lost.extend(leases.iter().filter(|lease| !live.contains(&lease.to_string().as_str())));
    let mut frames: BTreeMap<(i64, u32), Vec<Held>> = BTreeMap::new();
    for held in held {
        frames.entry((held.job, held.frame)).or_default().push(held);
    }
    for ((job, frame), held) in frames {
        let stitched = matches!(held.as_slice(), [held] if held.stitch);
        if stitched || covers(connection, job, frame, held.len()).await? {
            let picture = Picture { job, frame, hash, size_bytes };
            store_frame(connection, &held, stitched, &picture, moment, delivered).await?;
            continue;
        }
        for held in held {
            let message = "its worker delivered a picture without holding the whole frame";
            let ring = lease::give_up(connection, &held, Cause::Interrupted, message, moment).await?;
            delivered.ring.add(ring);
        }
    }
    Ok(())
}

/// Whether so many leased tiles are all of a frame.
async fn covers(connection: &mut Connection, job: i64, frame: u32, tiles: usize) -> Result<bool> {
    let total: Option<i64> =
        sqlx::query_scalar("SELECT tiles_total FROM frame WHERE job = ? AND number = ? AND state = 'open'")
            .bind(job)
            .bind(frame)
            .fetch_optional(connection)
            .await?;
    Ok(total == Some(rows(tiles)))
}

struct Picture<'a> {
    job: i64,
    frame: u32,
    hash: &'a str,
    size_bytes: u64,
}

async fn store_frame(
    connection: &mut Connection,
    held: &[Held],
    stitched: bool,
    picture: &Picture<'_>,
    moment: Moment,
    delivered: &mut Delivered,
) -> Result<()> {
    finish_all(connection, held).await?;
    let key: Option<String> = sqlx::query_scalar(
        "UPDATE frame SET state = 'stored', picture = ?1, size_bytes = ?2, tiles_done = tiles_total
         WHERE job = ?3 AND number = ?4 AND state = ?5 RETURNING picture_key",
    )
    .bind(picture.hash)
    .bind(picture.size_bytes.cast_signed())
    .bind(picture.job)
    .bind(picture.frame)
    .bind(if stitched { "stitching" } else { "open" })
    .fetch_optional(&mut *connection)
    .await?;
    let key = key.ok_or(StoreError::Rows { what: "frame: to stored", expected: 1, changed: 0 })?;
    remember(connection, picture, &key, moment).await?;
    let (tiles, rays) = if stitched { (0, 0) } else { (rows(held.len()), held.iter().map(|held| held.rays).sum()) };
    end::progress(connection, picture.job, end::Progress { tiles, rays, frames: 1 }).await?;
    end::succeed_if_stored(connection, picture.job, moment).await?;
    if stitched {
        let blobs = sqlx::query("SELECT DISTINCT blob FROM tile WHERE job = ? AND frame = ? AND blob IS NOT NULL")
            .bind(picture.job)
            .bind(picture.frame)
            .fetch_all(connection)
            .await?;
        for row in blobs {
            delivered.leftovers.push(row.try_get("blob")?);
        }
    }
    Ok(())
}

async fn finish_all(connection: &mut Connection, held: &[Held]) -> Result<()> {
    let ended =
        sqlx::query("UPDATE lease SET ended = 'done' WHERE ended IS NULL AND id IN (SELECT value FROM json_each(?))")
            .bind(super::json_list(held.iter().map(|held| &held.lease)))
            .execute(&mut *connection)
            .await?;
    counted("lease: live to ended", held.len() as u64, &ended)?;
    let done =
        sqlx::query("UPDATE tile SET state = 'done' WHERE state = 'leased' AND id IN (SELECT value FROM json_each(?))")
            .bind(super::json_numbers(held.iter().map(|held| held.tile)))
            .execute(connection)
            .await?;
    counted("tile: leased to done", held.len() as u64, &done)
}

/// Lets later jobs have the picture; the first one of a key stays.
async fn remember(connection: &mut Connection, picture: &Picture<'_>, key: &str, moment: Moment) -> Result<()> {
    sqlx::query(
        "INSERT INTO picture (key, hash, size_bytes, media_type, stored_at_ms)
         SELECT ?1, ?2, ?3, media_type, ?4 FROM job WHERE number = ?5 ON CONFLICT (key) DO NOTHING",
    )
    .bind(key)
    .bind(picture.hash)
    .bind(picture.size_bytes.cast_signed())
    .bind(moment.wall_ms)
    .bind(picture.job)
    .execute(&mut *connection)
    .await?;
    let first: String =
        sqlx::query_scalar("SELECT hash FROM picture WHERE key = ?").bind(key).fetch_one(connection).await?;
    if first != picture.hash {
        tracing::error!(
            code = "nondeterministic_picture", job = picture.job, frame = picture.frame, %first,
            second = picture.hash, "one picture was rendered in two ways; later jobs are shown the first"
        );
    }
    Ok(())
}
