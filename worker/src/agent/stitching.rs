//! Stitches: fetches a frame's blobs, verifies every byte, and encodes the picture.

use std::fs::File;
use std::io::Write;
use std::time::{Duration, Instant};

use futures_util::stream::{self, StreamExt};
use proto::Rect;
use proto::fail_point::{self, FailPoint};
use proto::worker_protocol::{LeaseOutcome, StitchInput};
use scene::Job;
use tokio::task::spawn_blocking;
use tracing::Instrument;

use super::back_off::BackOff;
use super::executor::{BatchEvent, BatchExecutor, CancelOnDrop, FrameTask, LeaseHandle, panic_message};
use super::rendering::milliseconds;
use super::server_client::ServerError;
use super::upload::{UploadTimes, encode};
use crate::blob;
use crate::stitch::BlobRows;

/// Number of blobs fetched and checked concurrently.
const MAX_CONCURRENT_FETCHES: usize = 4;

impl BatchExecutor {
    /// Stitches a frame and delivers its picture.
    pub(super) async fn stitch(&self, frame: &FrameTask, parts: &[StitchInput], hold: &LeaseHandle) {
        let start = Instant::now();
        let fetched = tokio::select! {
            fetched = self.fetch(&frame.job, parts) => fetched,
            () = hold.dropped.cancelled() => return self.send(BatchEvent::Rendered { took: None, frame_of: None }),
        };
        let (file, places) = match fetched {
            Ok(fetched) => fetched,
            Err(outcome) => {
                self.send(BatchEvent::Rendered { took: None, frame_of: None });
                if let LeaseOutcome::Released = outcome {
                    self.send(BatchEvent::NotStored);
                }
                return self.finish([hold], &outcome);
            }
        };
        fail_point::trigger_infallible(FailPoint::Stitching);
        let fetch_ms = milliseconds(start.elapsed());
        let (stop, encoders, scratch) = (CancelOnDrop::default(), self.encoders.clone(), self.scratch.clone());
        let (job, number, cancel) = (frame.job.clone(), frame.number, stop.0.clone());
        let encoding = spawn_blocking(move || {
            encoders.run(|threads| encode(&job, number, &mut BlobRows::new(file, places), &scratch, threads, &cancel))
        });
        let encoded = tokio::select! {
            () = hold.dropped.cancelled() => return self.send(BatchEvent::Rendered { took: None, frame_of: None }),
            encoded = encoding.instrument(tracing::info_span!("encode")) => encoded,
        };
        self.send(BatchEvent::Rendered { took: Some(start.elapsed()), frame_of: None });
        let delivered = self.upload_picture(encoded, std::slice::from_ref(hold)).await;
        if let Some(UploadTimes { encode_ms, put_ms, size_bytes }) = delivered {
            let (job, tiles) = (frame.id, parts.len());
            tracing::debug!(%job, frame = number, tiles, size_bytes, fetch_ms, encode_ms, put_ms, "picture stored");
        }
    }

    /// Fetches all blobs into one unnamed file, or returns the outcome to report instead.
    async fn fetch(&self, job: &Job, parts: &[StitchInput]) -> Result<(File, Vec<(Rect, u64)>), LeaseOutcome> {
        let full = |error: std::io::Error| {
            tracing::warn!(%error, "could not write blobs to the scratch folder");
            LeaseOutcome::Released
        };
        let planes = job.image.film().rendered_channels().len();
        let mut file = tempfile::tempfile_in(&self.scratch).map_err(full)?;
        let (mut places, mut bad, mut end) = (Vec::new(), Vec::new(), 0);
        let fetches: Vec<_> = parts.iter().map(|part| self.fetch_part(part, planes)).collect();
        let mut fetched = stream::iter(fetches).buffered(MAX_CONCURRENT_FETCHES);
        for part in parts {
            let Some(bytes) = fetched.next().await.transpose()?.flatten() else {
                tracing::warn!(tile = part.index, hash = part.hash, "blob missing or damaged");
                bad.push(part.index);
                continue;
            };
            places.push((part.rect, end));
            end += bytes.len() as u64;
            let written = spawn_blocking(move || file.write_all(&bytes).map(|()| file)).await;
            file = written.map_err(std::io::Error::other).flatten().map_err(full)?;
        }
        if bad.is_empty() { Ok((file, places)) } else { Err(LeaseOutcome::BadBlobs { tiles: bad }) }
    }

    /// Fetches a blob; `None` if it is missing or damaged.
    async fn fetch_part(&self, part: &StitchInput, planes: usize) -> Result<Option<Vec<u8>>, LeaseOutcome> {
        let mut back_off = BackOff::new(Duration::from_millis(50), Duration::from_secs(2));
        loop {
            match self.store.blob(&part.hash, part.size_bytes).await {
                Ok(None) => return Ok(None),
                Ok(Some(bytes)) => {
                    let part = part.clone();
                    let checked = spawn_blocking(move || is_intact(&bytes, &part, planes).then_some(bytes));
                    return checked.await.map_err(|panic| {
                        let message = panic_message("checking a blob", panic);
                        LeaseOutcome::Failed { message }
                    });
                }
                Err(error) if error.is_unavailable() => back_off.pause().await,
                Err(
                    error @ (ServerError::Status { .. }
                    | ServerError::InvalidResponse(_)
                    | ServerError::File(_)
                    | ServerError::Store(_)),
                ) => {
                    tracing::warn!(%error, "could not fetch a blob");
                    return Err(LeaseOutcome::Released);
                }
                Err(ServerError::Unreachable(_)) => unreachable!("that is an absence"),
            }
        }
    }
}

/// Whether these are the bytes of a tile.
pub(super) fn is_intact(bytes: &[u8], part: &StitchInput, planes: usize) -> bool {
    let header = blob::BlobReader::open_at(std::io::Cursor::new(bytes), 0);
    blob::hash(bytes) == part.hash
        && bytes.len() as u64 == blob::size_bytes(part.rect, planes)
        && header.is_ok_and(|header| header.rect() == part.rect && header.planes() == planes)
}
