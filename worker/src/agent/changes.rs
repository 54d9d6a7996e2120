//! Tiles of recorded jobs: which of them keep the pixels of an earlier job, and the records of the others.
//!
//! All of this may fail without harm: a tile without a record is rendered.

use std::collections::VecDeque;
use std::sync::Arc;

use bytes::Bytes;
use proto::JobId;
use proto::worker_protocol::{EarlierFrame, EarlierTile, TileRecord};
use scene::visits::{VisitGrid, Visited};
use scene::{Change, Job, change};
use tokio::sync::Mutex;
use tokio::task::spawn_blocking;

use super::executor::{BatchEvent, BatchExecutor, FrameTask, LeaseHandle, all_dropped};
use super::rendering::{Rendered, TileTask};
use super::stitching::is_intact;
use crate::blob;
use crate::renderer::TilePixels;

/// Number of differences between frames that are kept.
const MAX_CHANGES: usize = 8;

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
    /// Whether the pixels are those of the earlier job.
    kept: bool,
}

impl Record {
    /// Record of a tile that was rendered.
    pub(super) fn of_rendered(visited: &Visited) -> Self {
        Self { bytes: visited.to_bytes().into(), kept: false }
    }
}

/// Frame of two jobs, and the cells of the first one's record.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Edit {
    before: JobId,
    after: JobId,
    frame: u32,
    grid: VisitGrid,
}

/// The differences between frames that were found last, the newest first.
#[derive(Debug, Default)]
pub(super) struct ChangeCache(Mutex<VecDeque<(Edit, Arc<Change>)>>);

impl ChangeCache {
    /// Difference between two frames; `None` if it can't be found. Each is found once, also by batches at the same time.
    async fn get(&self, edit: Edit, before: &Arc<Job>, after: &Arc<Job>) -> Option<Arc<Change>> {
        let mut known = self.0.lock().await;
        if let Some((_, change)) = known.iter().find(|(other, _)| *other == edit) {
            return Some(change.clone());
        }
        let (before, after) = (before.clone(), after.clone());
        let find = move || Some(change(&before.at(edit.frame).ok()?, &after.at(edit.frame).ok()?, &edit.grid));
        let found = Arc::new(spawn_blocking(find).await.ok().flatten()?);
        if let Change::Anywhere(reason) = &*found {
            tracing::info!(job = %edit.after, earlier = %edit.before, frame = edit.frame, reason, "no tile is kept");
        }
        known.push_front((edit, found.clone()));
        known.truncate(MAX_CHANGES);
        Some(found)
    }
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
        for place in places {
            if place.hold.dropped.is_cancelled() {
                continue;
            }
            let tile = earlier.tiles.iter().find(|tile| tile.pixels.rect == place.rect);
            match self.unchanged(frame, earlier, &before, tile).await {
                Some((pixels, record)) => {
                    let kept = Rendered { pixels, hold: place.hold, record: Some(record) };
                    self.clone().upload_blob(kept).await;
                }
                None => changed.push(place),
            }
        }
        changed
    }

    /// Pixels and record of an earlier tile, if the later one has the same.
    async fn unchanged(
        &self,
        frame: &FrameTask,
        earlier: &EarlierFrame,
        before: &Arc<Job>,
        tile: Option<&EarlierTile>,
    ) -> Option<(TilePixels, Record)> {
        let EarlierTile { pixels, record, record_bytes } = tile?;
        let bytes = self.store.blob(record, *record_bytes).await.ok().flatten()?;
        let visited = Visited::from_bytes(&bytes).filter(|_| blob::hash(&bytes) == *record)?;
        let edit = Edit { before: earlier.job, after: frame.id, frame: frame.number, grid: *visited.grid() };
        if self.changes.get(edit, before, &frame.job).await?.can_reach(&visited) {
            return None;
        }
        let planes = frame.job.image.channels().len();
        let found = self.store.blob(&pixels.hash, pixels.size_bytes).await.ok().flatten()?;
        let pixels = is_intact(&found, pixels, planes).then(|| blob::decode(&found).ok()).flatten()?;
        Some((pixels, Record { bytes: bytes.into(), kept: true }))
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
