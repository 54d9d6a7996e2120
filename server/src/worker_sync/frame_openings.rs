//! Prepares the frames that a claim must open: the keys of their pictures are read from their jobs.

use std::sync::Arc;

use tokio::sync::{Semaphore, SemaphorePermit};

use crate::db::DatabaseError;
use crate::job_reader::{JobLoadError, JobReader};
use crate::queue::{FrameOpening, Queue};
use crate::tile_plan::TilePlan;

/// Preparation of frames.
#[derive(Debug)]
pub(crate) struct FrameOpenings {
    queue: Queue,
    jobs: Arc<JobReader>,
    /// Syncs open frames one at a time. All are to open the same frame, the next one, so that of `n` at once one
    /// would succeed and `n - 1` try again.
    turn: Semaphore,
}

/// A sync's turn to open frames; ends when it is dropped.
#[derive(Debug)]
pub(super) struct OpeningTurn<'a> {
    _permit: SemaphorePermit<'a>,
    /// Whether another sync has opened frames since this one asked for its turn.
    pub(super) has_waited: bool,
}

impl FrameOpenings {
    /// Prepares frames of this queue's jobs.
    pub(crate) fn new(queue: Queue, jobs: Arc<JobReader>) -> Self {
        Self { queue, jobs, turn: Semaphore::new(1) }
    }

    /// Waits for a turn to open frames.
    pub(super) async fn turn(&self) -> OpeningTurn<'_> {
        if let Ok(permit) = self.turn.try_acquire() {
            return OpeningTurn { _permit: permit, has_waited: false };
        }
        let permit = self.turn.acquire().await.expect("the semaphore is never closed");
        OpeningTurn { _permit: permit, has_waited: true }
    }

    /// Opening of a frame; `None` if its job cannot be parsed now, or not any more.
    pub(super) async fn of(
        &self,
        number: i64,
        frame: u32,
        plan: TilePlan,
    ) -> Result<Option<FrameOpening>, DatabaseError> {
        match self.jobs.frame_opening(&self.queue, number, frame, plan).await {
            Ok(opening) => Ok(Some(opening)),
            Err(JobLoadError::Store(error)) => Err(error),
            Err(error @ JobLoadError::Refused(_)) => {
                tracing::error!(job = number, %error, "an accepted job cannot be parsed any more");
                self.queue.fail_unreadable(number, error.to_string()).await?;
                Ok(None)
            }
            Err(
                error @ (JobLoadError::Gone
                | JobLoadError::Broken(_)
                | JobLoadError::Unexpected
                | JobLoadError::TooManyWaiting { .. }),
            ) => {
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
