//! Stitch runs: fetches a frame's blobs, checks every byte, and makes the picture.

use std::fs::File;
use std::io::Write;
use std::sync::Arc;
use std::time::Duration;

use proto::Rect;
use proto::work::{Outcome, Part};
use scene::Job;
use tokio::task::spawn_blocking;

use super::back_off::BackOff;
use super::deliver::encode;
use super::link::LinkError;
use super::workbench::{Event, Hold, Workbench};
use crate::blob;
use crate::stitch::Blobs;

impl Workbench {
    /// Stitches a frame and delivers its picture.
    pub(super) async fn stitch(&self, job: &Arc<Job>, frame: u32, parts: &[Part], hold: &Hold) {
        let fetched = tokio::select! {
            fetched = self.fetch(job, parts) => fetched,
            () = hold.dropped.cancelled() => return self.tell(Event::Rendered),
        };
        let (file, places) = match fetched {
            Ok(fetched) => fetched,
            Err(outcome) => {
                self.tell(Event::Rendered);
                if let Outcome::HandedBack = outcome {
                    self.tell(Event::NotStored);
                }
                return self.finish(std::slice::from_ref(hold), &outcome);
            }
        };
        let (job, scratch, cancel) = (job.clone(), self.scratch.clone(), hold.cancel.clone());
        let encoding = spawn_blocking(move || encode(&job, frame, &mut Blobs::new(file, places), &scratch, &cancel));
        let encoded = encoding.await;
        self.tell(Event::Rendered);
        self.deliver_picture(encoded, std::slice::from_ref(hold)).await;
    }

    /// Fetches all blobs into one nameless file; or says what to report instead.
    async fn fetch(&self, job: &Job, parts: &[Part]) -> Result<(File, Vec<(Rect, u64)>), Outcome> {
        let full = |error: std::io::Error| {
            tracing::warn!(%error, "could not write blobs to the scratch folder");
            Outcome::HandedBack
        };
        let planes = job.image.channels().len();
        let mut file = tempfile::tempfile_in(&self.scratch).map_err(full)?;
        let (mut places, mut bad, mut end) = (Vec::new(), Vec::new(), 0);
        for part in parts {
            let Some(bytes) = self.fetch_part(part, planes).await? else {
                tracing::warn!(tile = part.index, hash = part.hash, "a blob is missing or damaged");
                bad.push(part.index);
                continue;
            };
            places.push((part.rect, end));
            end += bytes.len() as u64;
            let written = spawn_blocking(move || file.write_all(&bytes).map(|()| file)).await;
            file = written.map_err(std::io::Error::other).flatten().map_err(full)?;
        }
        if bad.is_empty() { Ok((file, places)) } else { Err(Outcome::BadBlobs { tiles: bad }) }
    }

    /// Fetches a blob; `None` if it is missing or damaged.
    async fn fetch_part(&self, part: &Part, planes: usize) -> Result<Option<Vec<u8>>, Outcome> {
        let mut back_off = BackOff::new(Duration::from_millis(50), Duration::from_secs(2));
        loop {
            match self.link.blob(&part.hash, part.size_bytes).await {
                Ok(bytes) => return Ok(bytes.filter(|bytes| is_whole(bytes, part, planes))),
                Err(error) if error.is_not_found() => return Ok(None),
                Err(error) if error.is_absence() => back_off.pause().await,
                Err(error @ (LinkError::Answered { .. } | LinkError::Garbled(_) | LinkError::File(_))) => {
                    tracing::warn!(%error, "could not fetch a blob");
                    return Err(Outcome::HandedBack);
                }
                Err(LinkError::Unreachable(_)) => unreachable!("that is an absence"),
            }
        }
    }
}

fn is_whole(bytes: &[u8], part: &Part, planes: usize) -> bool {
    let header = blob::Reader::open_at(std::io::Cursor::new(bytes), 0);
    blob::key(bytes) == part.hash
        && bytes.len() as u64 == blob::size_bytes(part.rect, planes)
        && header.is_ok_and(|header| header.rect() == part.rect && header.planes() == planes)
}
