//! Prepares the frames that a claim must open: their jobs are parsed, and the keys of their pictures computed.

use std::sync::Arc;

use crate::db::DatabaseError;
use crate::job_cache::{JobCache, JobLoadError, Reader};
use crate::queue::{FrameOpening, Queue};
use crate::tile_plan::TilePlan;

/// Preparation of frames.
#[derive(Debug)]
pub(crate) struct FrameOpenings {
    queue: Queue,
    jobs: Arc<JobCache>,
}

impl FrameOpenings {
    /// Prepares frames of this queue's jobs.
    pub(crate) fn new(queue: Queue, jobs: Arc<JobCache>) -> Self {
        Self { queue, jobs }
    }

    /// Opening of a frame; `None` if its job cannot be parsed now, or not any more.
    pub(super) async fn of(
        &self,
        number: i64,
        frame: u32,
        plan: TilePlan,
    ) -> Result<Option<FrameOpening>, DatabaseError> {
        let opening = match self.jobs.get(&self.queue, number).await {
            Ok(job) => self.jobs.frame_opening(Reader::Claim(number), &job, number, frame, plan).await,
            Err(error) => Err(error),
        };
        match opening {
            Ok(opening) => Ok(Some(opening)),
            Err(JobLoadError::Store(error)) => Err(error),
            Err(error @ JobLoadError::Refused(_)) => {
                tracing::error!(job = number, %error, "an accepted job cannot be parsed any more");
                self.queue.fail_unreadable(number, error.to_string()).await?;
                Ok(None)
            }
            Err(error @ (JobLoadError::Gone | JobLoadError::Thread | JobLoadError::TooManyWaiting { .. })) => {
                tracing::error!(job = number, %error, "could not open a frame");
                Ok(None)
            }
        }
    }

    /// Prepares up to `count` frames after one that is being opened, as far as the job has them.
    pub(super) async fn following(
        &self,
        opening: &FrameOpening,
        plan: TilePlan,
        count: u32,
    ) -> Result<Vec<FrameOpening>, DatabaseError> {
        let mut openings = Vec::new();
        for frame in (opening.frame + 1..plan.frames).take(count as usize) {
            match self.of(opening.job, frame, plan).await? {
                Some(next) => openings.push(next),
                None => break,
            }
        }
        Ok(openings)
    }
}
