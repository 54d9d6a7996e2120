//! Prepares the frames that a claim must open: the keys of their pictures are read from their jobs.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::pin::Pin;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::sync::{Semaphore, SemaphorePermit};
use tokio::time::{Sleep, sleep};

use crate::job_reader::{JobLoadError, JobReader};
use crate::queue::{FrameOpening, Queue};
use crate::tile_plan::TilePlan;

/// Maximum time that one sync waits for job files. Then it claims work of other jobs.
const MAX_READ_WAIT: Duration = Duration::from_millis(200);
/// Maximum number of jobs that syncs pass by because their files are being read. Beyond it, they wait for these.
const MAX_PASSED: usize = 64;
/// A file that no process could read is read again after this time, then after twice as long, and so on.
const FIRST_PAUSE: Duration = Duration::from_secs(1);
/// Maximum time until it is read again.
const MAX_PAUSE: Duration = Duration::from_mins(1);

/// Preparation of frames.
#[derive(Debug)]
pub(crate) struct FrameOpenings {
    reads: Arc<Reads>,
    /// Syncs open frames one at a time. All are to open the same frame, the next one, so that of `n` at once one
    /// would succeed and `n - 1` try again.
    turn: Semaphore,
}

/// Job files that are being read.
#[derive(Debug)]
struct Reads {
    queue: Queue,
    jobs: Arc<JobReader>,
    /// Numbers of the jobs, and whether syncs pass them by.
    running: Mutex<HashMap<i64, bool>>,
}

/// A sync's turn to open frames; ends when it is dropped.
#[derive(Debug)]
pub(super) struct OpeningTurn<'a> {
    _permit: SemaphorePermit<'a>,
    /// Ends the sync's wait for job files.
    wait: Pin<Box<Sleep>>,
    /// Whether another sync has opened frames since this one asked for its turn.
    pub(super) has_waited: bool,
}

impl FrameOpenings {
    /// Prepares frames of this queue's jobs.
    pub(crate) fn new(queue: Queue, jobs: Arc<JobReader>) -> Self {
        Self { reads: Arc::new(Reads { queue, jobs, running: Mutex::default() }), turn: Semaphore::new(1) }
    }

    /// Waits for a turn to open frames.
    pub(super) async fn turn(&self) -> OpeningTurn<'_> {
        let free = self.turn.try_acquire().ok();
        let has_waited = free.is_none();
        let permit = match free {
            Some(permit) => permit,
            None => self.turn.acquire().await.expect("the semaphore is never closed"),
        };
        OpeningTurn { _permit: permit, wait: Box::pin(sleep(MAX_READ_WAIT)), has_waited }
    }

    /// Numbers of the jobs whose next frame no claim opens now, because their files are being read.
    pub(super) fn passed_jobs(&self) -> Vec<i64> {
        let running = self.reads.running.lock().expect("no holder panics");
        running.iter().filter(|(_, is_passed)| **is_passed).map(|(&number, _)| number).collect()
    }

    /// Opening of a frame; `None` if its job's file cannot be read within the sync's time, or not any more. Then syncs pass
    /// the job by until it was read; they are woken when it was.
    pub(super) async fn of(
        &self,
        number: i64,
        frame: u32,
        plan: TilePlan,
        turn: &mut OpeningTurn<'_>,
    ) -> Option<FrameOpening> {
        if self.reads.jobs.known(number, frame).is_none() && self.reads.begin(number) {
            let mut read = tokio::spawn(self.reads.clone().read(number, frame));
            tokio::select! {
                biased;
                _ = &mut read => {}
                () = &mut turn.wait => {}
            }
        }
        let known = self.reads.jobs.known(number, frame);
        if known.is_none() {
            self.reads.pass_by(number);
        }
        known.map(|facts| facts.opening(number, plan))
    }

    /// Whether [`MAX_PASSED`] jobs are passed by, so that a sync waits for them.
    pub(super) fn are_many_passed(&self) -> bool {
        self.passed_jobs().len() >= MAX_PASSED
    }

    /// Prepares up to `count` frames after one that is being opened, as far as the job has them.
    pub(super) async fn following(
        &self,
        opening: &FrameOpening,
        plan: TilePlan,
        count: u32,
        turn: &mut OpeningTurn<'_>,
    ) -> Vec<FrameOpening> {
        let mut openings = Vec::new();
        for frame in (opening.frame + 1..plan.frames).take(count as usize) {
            match self.of(opening.job, frame, plan, turn).await {
                Some(next) => openings.push(next),
                None => break,
            }
        }
        openings
    }
}

impl Reads {
    /// Records that a job's file is being read; false if it already is.
    fn begin(&self, number: i64) -> bool {
        match self.running.lock().expect("no holder panics").entry(number) {
            Entry::Vacant(vacant) => {
                vacant.insert(false);
                true
            }
            Entry::Occupied(_) => false,
        }
    }

    /// Lets syncs pass a job by, if its file is still being read.
    fn pass_by(&self, number: i64) {
        if let Some(is_passed) = self.running.lock().expect("no holder panics").get_mut(&number) {
            *is_passed = true;
        }
    }

    /// Reads a job's file until its frame is known or the job has ended.
    async fn read(self: Arc<Self>, number: i64, frame: u32) {
        let mut pause = FIRST_PAUSE;
        while !self.try_read(number, frame).await {
            self.pass_by(number);
            sleep(pause).await;
            pause = (2 * pause).min(MAX_PAUSE);
        }
        if self.running.lock().expect("no holder panics").remove(&number) == Some(true) {
            self.queue.wake_workers();
        }
    }

    /// Reads a job's file; false if it is to be read again.
    async fn try_read(&self, number: i64, frame: u32) -> bool {
        let error = match self.jobs.frame(&self.queue, number, frame).await {
            Ok(_) | Err(JobLoadError::Gone) => return true,
            Err(error @ JobLoadError::Refused(_)) => {
                tracing::error!(job = number, %error, "an accepted job cannot be parsed any more");
                match self.queue.fail_unreadable(number, error.to_string()).await {
                    Ok(()) => return true,
                    Err(error) => JobLoadError::Store(error),
                }
            }
            Err(
                error @ (JobLoadError::Store(_)
                | JobLoadError::Broken(_)
                | JobLoadError::Unexpected
                | JobLoadError::TooManyWaiting { .. }),
            ) => error,
        };
        tracing::error!(job = number, %error, "could not open a frame");
        false
    }
}
