//! Accepts jobs, and stores at once their first frames whose pictures exist.
//!
//! Depends on no HTTP types; what a submission may contain is checked before.

use std::sync::Arc;

use crate::db::DatabaseError;
use crate::job_reader::{FrameFacts, JobReader};
use crate::queue::{NewJob, OpenOutcome, Queue, SubmitOptions, SubmitOutcome};

/// Maximum number of frames of a job that are looked up in the picture cache at submission; the others are
/// looked up when they are opened.
const MAX_EAGER_CACHE_LOOKUPS: u32 = 64;

/// Acceptance of jobs.
#[derive(Clone, Debug)]
pub(crate) struct Submissions {
    queue: Queue,
    jobs: Arc<JobReader>,
}

impl Submissions {
    /// Accepts jobs into this queue.
    pub(crate) fn new(queue: Queue, jobs: Arc<JobReader>) -> Self {
        Self { queue, jobs }
    }

    /// Accepts a job with its first frames, and at once stores those whose pictures are cached.
    pub(crate) async fn accept(
        &self,
        new: NewJob,
        frames: Vec<FrameFacts>,
        options: SubmitOptions,
    ) -> Result<SubmitOutcome, DatabaseError> {
        let (plan, fresh) = (new.plan, new.no_cache);
        let submitted = self.queue.submit_with(new, options).await?;
        let SubmitOutcome::Created(number) = submitted else { return Ok(submitted) };
        self.jobs.insert(number, frames);
        if fresh {
            return Ok(submitted);
        }
        for frame in 0..plan.frames.min(MAX_EAGER_CACHE_LOOKUPS) {
            // If the job cannot be read now, the frame is opened like any other.
            let Ok(facts) = self.jobs.frame(&self.queue, number, frame).await else { break };
            let opening = facts.opening(number, plan);
            if !self.queue.has_picture(&opening.picture_key).await?
                || self.queue.reuse(opening).await? != OpenOutcome::Stored
            {
                break;
            }
        }
        Ok(submitted)
    }
}
