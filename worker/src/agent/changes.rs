//! Tiles of recorded jobs: which of them keep the pixels of an earlier job, and the records of the others.
//!
//! All of this may fail without harm: a tile without a record is rendered.

use std::sync::Arc;

use bytes::Bytes;
use proto::JobId;
use proto::worker_protocol::{EarlierTile, TileRecord};
use scene::visits::Visited;
use scene::{Job, reached};
use tokio::task::spawn_blocking;

use super::executor::{BatchEvent, BatchExecutor, FrameTask, LeaseHandle, all_dropped};
use super::rendering::{Rendered, TileTask};
use super::stitching::is_intact;
use crate::blob;
use crate::renderer::TilePixels;

/// A rendered tile, with what its rays asked for.
#[derive(Debug)]
pub(super) struct Recorded {
    pub(super) pixels: TilePixels,
    pub(super) visited: Option<Visited>,
}

impl From<(TilePixels, Option<Visited>)> for Recorded {
    fn from((pixels, visited): (TilePixels, Option<Visited>)) -> Self {
        Self { pixels, visited }
    }
}

/// Record of a tile, as it is stored.
#[derive(Clone, Debug)]
pub(super) struct Record {
    bytes: Bytes,
    /// Whether the pixels come from the earlier job.
    kept: bool,
}

impl Record {
    /// Record of a tile that was rendered.
    pub(super) fn of_rendered(visited: &Visited) -> Self {
        Self { bytes: visited.to_bytes().into(), kept: false }
    }
}

/// An earlier tile with its record.
struct RecordedTile<'a> {
    tile: &'a EarlierTile,
    bytes: Bytes,
    visited: Visited,
}

impl BatchExecutor {
    /// Delivers those tiles that keep the pixels of the earlier job; returns the others.
    pub(super) async fn keep_unchanged(self: &Arc<Self>, frame: &FrameTask, places: Vec<TileTask>) -> Vec<TileTask> {
        let Some(earlier) = frame.recording.as_ref().and_then(|recording| recording.earlier.as_ref()) else {
            return places;
        };
        let holds: Vec<LeaseHandle> = places.iter().map(|place| place.hold.clone()).collect();
        let before = tokio::select! {
            before = self.job(earlier.job) => before,
            () = all_dropped(&holds) => return places,
        };
        let before = match before {
            Ok(before) => before,
            Err(error) => {
                tracing::info!(job = %frame.id, earlier = %earlier.job, %error, "could not read the earlier job");
                return places;
            }
        };
        let mut changed = Vec::with_capacity(places.len());
        let mut recorded = Vec::with_capacity(places.len());
        for place in places {
            let tile = earlier.tiles.iter().find(|tile| tile.pixels.rect == place.rect);
            match self.record_of(tile).await {
                Some(record) => recorded.push((place, record)),
                None => changed.push(place),
            }
        }
        let mut kept = self.unchanged(frame, earlier.job, &before, &recorded).await.into_iter();
        for (place, record) in recorded {
            if !kept.next().unwrap_or(false) {
                changed.push(place);
                continue;
            }
            match self.pixels_of(frame, record.tile).await {
                Some(pixels) => {
                    let record = Some(Record { bytes: record.bytes, kept: true });
                    self.clone().upload_blob(Rendered { pixels, hold: place.hold, record }).await;
                }
                None => changed.push(place),
            }
        }
        changed
    }

    /// The record of an earlier tile.
    async fn record_of<'a>(&self, tile: Option<&'a EarlierTile>) -> Option<RecordedTile<'a>> {
        let tile = tile?;
        let bytes = self.store.blob(&tile.record, tile.record_bytes).await.ok().flatten()?;
        let visited = Visited::from_bytes(&bytes).filter(|_| blob::hash(&bytes) == tile.record)?;
        Some(RecordedTile { tile, bytes: bytes.into(), visited })
    }

    /// Whether each of some earlier tiles has the same pixels in the later job; nothing if that is not known.
    async fn unchanged(
        &self,
        frame: &FrameTask,
        earlier: JobId,
        before: &Arc<Job>,
        recorded: &[(TileTask, RecordedTile<'_>)],
    ) -> Vec<bool> {
        let (before, after, number) = (before.clone(), frame.job.clone(), frame.number);
        let visited: Vec<Visited> = recorded.iter().map(|(_, record)| record.visited.clone()).collect();
        let comparing = spawn_blocking(move || {
            let (before, after) = (before.at(number).ok()?, after.at(number).ok()?);
            Some(reached(&before, &after, &visited.iter().collect::<Vec<_>>()))
        });
        match comparing.await {
            Ok(Some(Ok(reached))) => reached.into_iter().map(|is_reached| !is_reached).collect(),
            Ok(Some(Err(reason))) => {
                tracing::info!(job = %frame.id, %earlier, frame = number, reason, "no tile is kept");
                Vec::new()
            }
            Ok(None) => Vec::new(),
            Err(error) => {
                tracing::error!(job = %frame.id, %earlier, frame = number, %error, "comparing frames panicked");
                Vec::new()
            }
        }
    }

    /// The pixels of an earlier tile.
    async fn pixels_of(&self, frame: &FrameTask, EarlierTile { pixels, .. }: &EarlierTile) -> Option<TilePixels> {
        let planes = frame.job.image.film().rendered_channels().len();
        let bytes = self.store.blob(&pixels.hash, pixels.size_bytes).await.ok().flatten()?;
        is_intact(&bytes, pixels, planes).then(|| blob::decode(&bytes).ok()).flatten()
    }

    /// Stores the record of a tile, and reports it before the tile.
    pub(super) async fn upload_record(&self, hold: &LeaseHandle, record: Record) {
        let Record { bytes, kept } = record;
        let (hash, size_bytes) = (blob::hash(&bytes), bytes.len() as u64);
        match self.store.put_blob(&hash, bytes).await {
            Ok(()) => self.send(BatchEvent::Recorded(TileRecord { lease: hold.lease, hash, size_bytes, kept })),
            Err(error) => tracing::info!(%error, "could not store the record of a tile"),
        }
    }
}
