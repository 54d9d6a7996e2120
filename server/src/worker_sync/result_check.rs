//! Checks the results of a sync against the store and their jobs, before they reach the queue.

use std::collections::HashMap;
use std::sync::Arc;

use proto::LeaseId;
use proto::worker_protocol::LeaseOutcome;

use super::SyncError;
use crate::blobs::{BlobStore, ContentHash, ContentKind};
use crate::delivery_check::check_blob;
use crate::job_reader::{JobLoadError, JobReader};
use crate::queue::{CheckedNames, Queue, RejectedResult, ReportedTile, SyncInput, content_of};

/// Number of characters that are kept of the name of a rejected result.
const MAX_LOGGED_CHARACTERS: usize = 80;

/// Verdict about the bytes of a result.
#[derive(Clone, Debug, PartialEq)]
enum Verdict {
    /// They are what was asked for, as far as their header tells.
    Right,
    /// They are not in the store, for example because a sweep was faster than the report.
    Missing,
    /// They are something else; a correct worker never sends them.
    Wrong(String),
}

/// Bytes of a result, and what they are for.
#[derive(Clone, Debug, PartialEq)]
struct Delivered {
    kind: ContentKind,
    hash: String,
    size_bytes: u64,
    /// `None` for a lease that has ended: then the result has no effect.
    tile: Option<ReportedTile>,
}

/// Check of results.
#[derive(Debug)]
pub(crate) struct ResultCheck {
    queue: Queue,
    content: Arc<BlobStore>,
    jobs: Arc<JobReader>,
}

impl ResultCheck {
    /// Checks the results that these stores have, against the jobs of the queue.
    pub(crate) fn new(queue: Queue, content: Arc<BlobStore>, jobs: Arc<JobReader>) -> Self {
        Self { queue, content, jobs }
    }

    /// See [`BlobStore::block_sweep`]: what was checked is still there when it is counted.
    pub(super) async fn block_sweep(&self) -> impl Drop + '_ {
        self.content.block_sweep().await
    }

    /// Takes out the results whose bytes are wrong or missing; their tiles are requeued.
    pub(super) async fn check(&self, turn: &mut SyncInput) -> Result<(), SyncError> {
        self.check_accusations(turn).await?;
        let delivers =
            |outcome: &LeaseOutcome| matches!(outcome, LeaseOutcome::Blob { .. } | LeaseOutcome::Picture { .. });
        let leases: Vec<LeaseId> =
            turn.reports.iter().filter(|report| delivers(&report.outcome)).map(|report| report.lease).collect();
        if leases.is_empty() {
            return Ok(());
        }
        if self.queue.may_have_others() && self.content.is_shared() {
            let names: Vec<_> = turn.reports.iter().filter_map(|report| content_of(&report.outcome)).collect();
            turn.checked = Some(self.queue.begin_check(&names).await?);
        }
        let tiles: HashMap<LeaseId, ReportedTile> = self.queue.reported_tiles(turn.worker, &leases).await?;
        // The leases of a whole frame have one picture, which is checked once.
        let mut last: Option<(Delivered, Verdict)> = None;
        let mut kept = Vec::with_capacity(turn.reports.len());
        for report in std::mem::take(&mut turn.reports) {
            let (kind, hash, size_bytes) = match &report.outcome {
                LeaseOutcome::Blob { hash, size_bytes } => (ContentKind::Blob, hash, *size_bytes),
                LeaseOutcome::Picture { hash, size_bytes } => (ContentKind::Picture, hash, *size_bytes),
                LeaseOutcome::BadBlobs { .. } | LeaseOutcome::Failed { .. } | LeaseOutcome::Released => {
                    kept.push(report);
                    continue;
                }
            };
            let tile = tiles.get(&report.lease).map(|tile| tile.as_delivered(kind));
            let delivered = Delivered { kind, hash: hash.clone(), size_bytes, tile };
            let verdict = match &last {
                Some((same, verdict)) if *same == delivered => verdict.clone(),
                _ => self.check_or_miss(&delivered, turn.checked.as_ref()).await?,
            };
            let (is_wrong, reason) = match &verdict {
                Verdict::Right => {
                    kept.push(report);
                    last = Some((delivered, verdict));
                    continue;
                }
                Verdict::Missing => (false, "its bytes are not in the store".to_owned()),
                Verdict::Wrong(reason) => (true, reason.clone()),
            };
            let hash = delivered.hash.chars().take(MAX_LOGGED_CHARACTERS).collect();
            turn.rejected.push(RejectedResult { lease: report.lease, hash, reason, is_wrong });
            last = Some((delivered, verdict));
        }
        turn.reports = kept;
        Ok(())
    }

    /// Takes out the reports that blobs of a stitch are damaged if none of them is.
    async fn check_accusations(&self, turn: &mut SyncInput) -> Result<(), SyncError> {
        let mut kept = Vec::with_capacity(turn.reports.len());
        for mut report in std::mem::take(&mut turn.reports) {
            if let LeaseOutcome::BadBlobs { tiles } = &mut report.outcome {
                let blobs = self.queue.stitch_blobs(turn.worker, report.lease, tiles).await?;
                let is_known = !blobs.is_empty();
                tiles.clear();
                for (position, hash) in blobs {
                    let name = ContentHash::parse(&hash);
                    let is_intact = match &name {
                        Some(name) => self.content.hash(ContentKind::Blob, name).await?.as_ref() == Some(&hash),
                        None => false,
                    };
                    if !is_intact {
                        tiles.push(position);
                    }
                }
                if is_known && tiles.is_empty() {
                    let reason = "it says that blobs are damaged which are intact".to_owned();
                    turn.rejected.push(RejectedResult {
                        lease: report.lease,
                        hash: String::new(),
                        reason,
                        is_wrong: true,
                    });
                    continue;
                }
            }
            kept.push(report);
        }
        turn.reports = kept;
        Ok(())
    }

    /// Checks a result. One whose bytes cannot be read keeps no other result from being counted, unless the store as a
    /// whole fails.
    async fn check_or_miss(&self, delivered: &Delivered, known: Option<&CheckedNames>) -> Result<Verdict, SyncError> {
        match self.check_bytes(delivered, known).await {
            Err(SyncError::Content(error)) if !error.is_full() && error.unreachable_attempt().is_none() => {
                let error: &(dyn std::error::Error + 'static) = &error;
                tracing::error!(hash = delivered.hash, error, "could not read a result; its tile is requeued");
                Ok(Verdict::Missing)
            }
            checked => checked,
        }
    }

    async fn check_bytes(&self, delivered: &Delivered, known: Option<&CheckedNames>) -> Result<Verdict, SyncError> {
        let Some(name) = ContentHash::parse(&delivered.hash) else {
            return Ok(Verdict::Wrong("the result's name is not a hash".to_owned()));
        };
        let found = match known {
            Some(known) => known.find(&self.content, delivered.kind, &name).await?,
            None => self.content.ends(delivered.kind, &name).await?,
        };
        let Some(file) = found else { return Ok(Verdict::Missing) };
        if file.size_bytes != delivered.size_bytes {
            let (claimed, found) = (delivered.size_bytes, file.size_bytes);
            return Ok(Verdict::Wrong(format!("the result has {found} bytes instead of the reported {claimed}")));
        }
        let Some(tile) = &delivered.tile else { return Ok(Verdict::Right) };
        let checked = match delivered.kind {
            ContentKind::Blob => check_blob(&file, tile.rect, tile.pixel_bytes),
            ContentKind::Picture => match self.jobs.frame(&self.queue, tile.job, tile.frame).await {
                Ok(facts) => match &facts.expected {
                    Ok(expected) => expected.check(&file),
                    Err(error) => Err(format!("its frame cannot be rendered: {error}")),
                },
                Err(JobLoadError::Store(error)) => return Err(error.into()),
                Err(error @ JobLoadError::Refused(_)) => {
                    self.queue.fail_unreadable(tile.job, error.to_string()).await?;
                    return Ok(Verdict::Missing);
                }
                Err(
                    error @ (JobLoadError::Gone
                    | JobLoadError::Broken(_)
                    | JobLoadError::Unexpected
                    | JobLoadError::TooManyWaiting { .. }),
                ) => {
                    tracing::warn!(job = tile.job, %error, "could not check a picture; its tile is requeued");
                    return Ok(Verdict::Missing);
                }
            },
        };
        Ok(checked.map_or_else(Verdict::Wrong, |()| Verdict::Right))
    }
}
