//! Brings blobs and pictures to the server. A server that is away is waited for, as long
//! as anybody wants the result; one that can't store is left alone for a while.

use std::fs::File;
use std::io::{BufWriter, Read, Seek};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use futures_util::future::join_all;
use proto::work::Outcome;
use scene::Job;
use tokio::task::{JoinError, spawn_blocking};

use super::back_off::BackOff;
use super::link::LinkError;
use super::workbench::{Event, Hold, Workbench, chain, panic_message};
use crate::blob;
use crate::image::{ImageError, Picture};
use crate::renderer::{Cancel, Pixels};
use crate::stitch::{Source, Tiles};

/// A picture in a nameless file.
pub(super) struct Encoded {
    file: File,
    hash: String,
    size_bytes: u64,
}

/// What became of the encoding of a picture on a thread of its own.
pub(super) type Encoding = Result<Result<Encoded, ImageError>, JoinError>;

/// Encodes a picture into a nameless file in `scratch`.
pub(super) fn encode(
    job: &Job,
    frame: u32,
    source: &mut dyn Source,
    scratch: &Path,
    cancel: &Cancel,
) -> Result<Encoded, ImageError> {
    let mut out = BufWriter::with_capacity(1 << 18, tempfile::tempfile_in(scratch)?);
    Picture::of(job, frame).write(source, &mut out, cancel)?;
    let mut file = out.into_inner().map_err(std::io::IntoInnerError::into_error)?;
    file.rewind()?;
    let mut hasher = blake3::Hasher::new();
    let mut bytes = vec![0; 1 << 18];
    let mut size_bytes = 0;
    loop {
        let read = file.read(&mut bytes)?;
        if read == 0 {
            break;
        }
        hasher.update(&bytes[..read]);
        size_bytes += read as u64;
    }
    Ok(Encoded { file, hash: hasher.finalize().to_hex().to_string(), size_bytes })
}

impl Workbench {
    /// Delivers a tile as a blob.
    pub(super) async fn deliver_blob(self: Arc<Self>, pixels: Pixels, hold: Hold) {
        let encoded = spawn_blocking(move || {
            let bytes = blob::encode(&pixels);
            (blob::key(&bytes), Bytes::from(bytes))
        });
        let (hash, bytes) = match encoded.await {
            Ok(encoded) => encoded,
            Err(panic) => {
                let message = panic_message("packing the tile", panic);
                return self.finish(&[hold], &Outcome::Failed { message });
            }
        };
        let size_bytes = bytes.len() as u64;
        let put = self.until_stored(|| self.link.put_blob(&hash, bytes.clone()));
        tokio::select! {
            () = hold.dropped.cancelled() => {}
            stored = put => {
                let outcome = stored.err().unwrap_or_else(|| Outcome::Blob { hash: hash.clone(), size_bytes });
                self.finish(std::slice::from_ref(&hold), &outcome);
            }
        }
    }

    /// Encodes a whole frame, and delivers its picture for all its leases.
    pub(super) async fn deliver_frame(&self, job: Arc<Job>, frame: u32, tiles: Vec<Pixels>, holds: &[Hold]) {
        let (scratch, cancel) = (self.scratch.clone(), Cancel::new());
        let raised = cancel.clone();
        let encoding = spawn_blocking(move || encode(&job, frame, &mut Tiles(&tiles), &scratch, &raised));
        tokio::select! {
            () = nobody_waits(holds) => cancel.cancel(),
            encoded = encoding => self.deliver_picture(encoded, holds).await,
        }
    }

    /// Delivers a picture for the leases that it settles.
    pub(super) async fn deliver_picture(&self, encoded: Encoding, holds: &[Hold]) {
        let Encoded { file, hash, size_bytes } = match encoded.map_err(|panic| panic_message("the encoder", panic)) {
            Ok(Ok(picture)) => picture,
            Ok(Err(ImageError::Cancelled)) => return,
            Ok(Err(ImageError::Io(error))) => {
                // This machine's disk is no fault of the tile's.
                tracing::warn!(%error, "could not write a picture to the scratch folder");
                self.tell(Event::NotStored);
                return self.finish(holds, &Outcome::HandedBack);
            }
            Ok(Err(error)) => return self.finish(holds, &Outcome::Failed { message: chain(&error) }),
            Err(message) => return self.finish(holds, &Outcome::Failed { message }),
        };
        tokio::select! {
            () = nobody_waits(holds) => {}
            stored = self.until_stored(|| self.link.put_picture(&hash, &file, size_bytes)) => {
                let outcome = stored.err().unwrap_or_else(|| Outcome::Picture { hash: hash.clone(), size_bytes });
                self.finish(holds, &outcome);
            }
        }
    }

    /// Calls until the server took it; where that is hopeless, says what to report instead.
    async fn until_stored<F>(&self, put: impl Fn() -> F) -> Result<(), Outcome>
    where
        F: Future<Output = Result<(), LinkError>>,
    {
        let mut back_off = BackOff::new(Duration::from_millis(50), Duration::from_secs(2));
        loop {
            let error = match put().await {
                Ok(()) => {
                    self.tell(Event::Stored);
                    return Ok(());
                }
                Err(error) => error,
            };
            if error.is_absence() {
                back_off.pause().await;
                continue;
            }
            tracing::warn!(%error, "the server did not store a result");
            let is_elsewhere = error.is_conflict() || error.is_not_found() || matches!(error, LinkError::File(_));
            if !error.is_passing() && !is_elsewhere {
                let message = format!("the server refused the result: {error}");
                return Err(Outcome::Failed { message });
            }
            self.tell(Event::NotStored);
            return Err(Outcome::HandedBack);
        }
    }
}

/// Waits until all these leases are dropped.
pub(super) async fn nobody_waits(holds: &[Hold]) {
    join_all(holds.iter().map(|hold| hold.dropped.cancelled())).await;
}
