//! Delivers blobs and pictures. Waits for an unreachable server while the result's lease is live, and backs off
//! if the server cannot store.

use std::io::{BufWriter, Read, Seek};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use proto::fail_point::{self, FailPoint};
use proto::worker_protocol::{LeaseOutcome, Phase};
use scene::Job;
use tempfile::SpooledData;
use tokio::task::{JoinError, spawn_blocking};
use tracing::Instrument;

use super::back_off::BackOff;
use super::executor::{
    BatchEvent, BatchExecutor, CancelOnDrop, FrameTask, LeaseHandle, all_dropped, chain, panic_message,
};
use super::rendering::{Rendered, milliseconds};
use super::server_client::{PictureBytes, ServerError};
use crate::blob;
use crate::image::{EncodeThreads, ImageError, PictureSpec};
use crate::renderer::{CancelFlag, TilePixels};
use crate::stitch::{RowSource, TileRows};

/// A picture larger than this is encoded to a file.
const MAX_IN_MEMORY_BYTES: usize = 32 << 20;

/// File of a picture, in memory or unnamed on disk.
pub(super) struct Encoded {
    content: PictureBytes,
    hash: String,
    size_bytes: u64,
    took: Duration,
}

/// Result of encoding a picture on its own thread.
pub(super) type EncodeResult = Result<Result<Encoded, ImageError>, JoinError>;

/// Durations of delivering a picture.
pub(super) struct UploadTimes {
    pub(super) encode_ms: f64,
    pub(super) put_ms: f64,
    pub(super) size_bytes: u64,
}

/// Encodes a picture, into an unnamed file in `scratch` if it is large.
pub(super) fn encode(
    job: &Job,
    frame: u32,
    source: &mut dyn RowSource,
    scratch: &Path,
    threads: EncodeThreads,
    cancel: &CancelFlag,
) -> Result<Encoded, ImageError> {
    let start = Instant::now();
    let mut out = BufWriter::with_capacity(1 << 18, tempfile::spooled_tempfile_in(MAX_IN_MEMORY_BYTES, scratch));
    PictureSpec::new(&job.at(frame).map_err(ImageError::from)?).write_on(threads, source, &mut out, cancel)?;
    let (content, hash, size_bytes) = match out.into_inner().map_err(std::io::IntoInnerError::into_error)?.into_inner()
    {
        SpooledData::InMemory(bytes) => {
            let bytes = Bytes::from(bytes.into_inner());
            let (hash, size_bytes) = (blob::hash(&bytes), bytes.len() as u64);
            (PictureBytes::Memory(bytes), hash, size_bytes)
        }
        SpooledData::OnDisk(mut file) => {
            let (hash, size_bytes) = hash_all(&mut file)?;
            (PictureBytes::File(file), hash, size_bytes)
        }
    };
    Ok(Encoded { content, hash, size_bytes, took: start.elapsed() })
}

fn hash_all(file: &mut (impl Read + Seek)) -> std::io::Result<(String, u64)> {
    file.rewind()?;
    let mut hasher = blake3::Hasher::new();
    let mut bytes = vec![0; 1 << 18];
    loop {
        let read = file.read(&mut bytes)?;
        if read == 0 {
            return Ok((hasher.finalize().to_hex().to_string(), hasher.count()));
        }
        hasher.update(&bytes[..read]);
    }
}

impl BatchExecutor {
    /// Delivers a tile as a blob.
    pub(super) async fn upload_blob(self: Arc<Self>, rendered: Rendered) {
        let (renderer, Rendered { pixels, hold, record }) = (self.renderer.clone(), rendered);
        let begun = Instant::now();
        let encoded = spawn_blocking(move || {
            let bytes = blob::encode(&pixels);
            renderer.recycle(vec![pixels]);
            (blob::hash(&bytes), Bytes::from(bytes))
        });
        let (hash, bytes) = match encoded.await {
            Ok(encoded) => encoded,
            Err(panic) => {
                let message = panic_message("packing the tile", panic);
                return self.finish([&hold], &LeaseOutcome::Failed { message });
            }
        };
        self.send(BatchEvent::Timed { phase: Phase::Encode, took: begun.elapsed(), rays: 0 });
        let size_bytes = bytes.len() as u64;
        let put = self.retry_until_stored(|| self.store.put_blob(&hash, bytes.clone()));
        let put = put.instrument(tracing::info_span!("deliver", size_bytes));
        tokio::select! {
            () = hold.dropped.cancelled() => {}
            stored = put => {
                let outcome = stored.err().unwrap_or_else(|| LeaseOutcome::Blob { hash: hash.clone(), size_bytes });
                fail_point::trigger_infallible(FailPoint::BlobPut);
                if let (LeaseOutcome::Blob { .. }, Some(record)) = (&outcome, record) {
                    self.upload_record(&hold, record).await;
                }
                self.finish([&hold], &outcome);
            }
        }
    }

    /// Encodes a whole frame, and delivers its picture for all its leases.
    pub(super) async fn upload_frame(&self, frame: &FrameTask, rendered: Vec<Rendered>, render: Duration) {
        let pairs = rendered.into_iter().map(|Rendered { pixels, hold, record: _ }| (pixels, hold));
        let (tiles, holds): (Vec<TilePixels>, Vec<LeaseHandle>) = pairs.unzip();
        let stop = CancelOnDrop::default();
        let (encoders, renderer, scratch) = (self.encoders.clone(), self.renderer.clone(), self.scratch.clone());
        let (job, number, cancel) = (frame.job.clone(), frame.number, stop.0.clone());
        let encoding = spawn_blocking(move || {
            let encoded =
                encoders.run(|threads| encode(&job, number, &mut TileRows(&tiles), &scratch, threads, &cancel));
            renderer.recycle(tiles);
            encoded
        });
        let encoded = tokio::select! {
            () = all_dropped(&holds) => return,
            encoded = encoding.instrument(tracing::info_span!("encode")) => encoded,
        };
        if let Some(UploadTimes { encode_ms, put_ms, size_bytes }) = self.upload_picture(encoded, &holds).await {
            let (job, tiles, render_ms) = (frame.id, holds.len(), milliseconds(render));
            tracing::debug!(%job, frame = number, tiles, size_bytes, render_ms, encode_ms, put_ms, "picture stored");
        }
    }

    /// Delivers a picture for its leases; `None` if that failed, which has been reported.
    pub(super) async fn upload_picture(&self, encoded: EncodeResult, holds: &[LeaseHandle]) -> Option<UploadTimes> {
        let encoded = encoded.map_err(|panic| panic_message("the encoder", panic));
        let failed = match encoded {
            Ok(Ok(picture)) => return self.put(picture, holds).await,
            Ok(Err(ImageError::Cancelled)) => return None,
            Ok(Err(ImageError::Io(error))) => {
                // A full or broken scratch disk is not an error of the tile.
                tracing::warn!(%error, "could not write a picture to the scratch folder");
                self.send(BatchEvent::NotStored);
                LeaseOutcome::Released
            }
            Ok(Err(error)) => LeaseOutcome::Failed { message: chain(&error) },
            Err(message) => LeaseOutcome::Failed { message },
        };
        self.finish(holds, &failed);
        None
    }

    async fn put(&self, picture: Encoded, holds: &[LeaseHandle]) -> Option<UploadTimes> {
        let Encoded { content, hash, size_bytes, took } = picture;
        self.send(BatchEvent::Timed { phase: Phase::Encode, took, rays: 0 });
        let start = Instant::now();
        let put = self.retry_until_stored(|| self.store.put_picture(&hash, &content, size_bytes));
        let stored = tokio::select! {
            () = all_dropped(holds) => return None,
            stored = put.instrument(tracing::info_span!("deliver", size_bytes)) => stored,
        };
        let put = start.elapsed();
        let outcome = stored.err().unwrap_or_else(|| LeaseOutcome::Picture { hash: hash.clone(), size_bytes });
        fail_point::trigger_infallible(FailPoint::PicturePut);
        self.finish(holds, &outcome);
        let is_put = matches!(outcome, LeaseOutcome::Picture { .. });
        is_put.then(|| UploadTimes { encode_ms: milliseconds(took), put_ms: milliseconds(put), size_bytes })
    }

    /// Retries until the server has stored it; if that cannot succeed, returns the outcome to report
    /// instead.
    async fn retry_until_stored<F>(&self, put: impl Fn() -> F) -> Result<(), LeaseOutcome>
    where
        F: Future<Output = Result<(), ServerError>>,
    {
        let begun = Instant::now();
        let mut back_off = BackOff::new(Duration::from_millis(50), Duration::from_secs(2));
        loop {
            let error = match put().await {
                Ok(()) => {
                    self.send(BatchEvent::Timed { phase: Phase::Deliver, took: begun.elapsed(), rays: 0 });
                    self.send(BatchEvent::Stored);
                    return Ok(());
                }
                Err(error) => error,
            };
            if error.is_unavailable() {
                back_off.pause().await;
                continue;
            }
            tracing::warn!(%error, "the server did not store a result");
            let is_disk = matches!(error, ServerError::File(_) | ServerError::Store(_));
            let is_elsewhere = error.is_conflict() || error.is_not_found() || is_disk;
            if !error.is_transient() && !is_elsewhere {
                let message = format!("the server rejected the result: {error}");
                return Err(LeaseOutcome::Failed { message });
            }
            self.send(BatchEvent::NotStored);
            return Err(LeaseOutcome::Released);
        }
    }
}
