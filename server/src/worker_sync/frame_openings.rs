//! Prepares the frames that a claim must open: the keys of their pictures are read from their jobs.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::pin::Pin;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::sync::{Semaphore, SemaphorePermit};
use tokio::time::{Sleep, sleep};

use crate::db::DatabaseError;
use crate::job_reader::{JobLoadError, JobReader};
use crate::queue::{FrameOpening, PassedJobs, Queue};
use crate::tile_plan::TilePlan;

/// Maximum time that one sync waits for job files. Then it claims work of other jobs.
const MAX_READ_WAIT: Duration = Duration::from_millis(200);
/// Maximum number of jobs of one submitter whose files are being read. With more, syncs pass by all of its jobs.
const MAX_READ_AT_ONCE: usize = 4;
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
    /// By the numbers of their jobs.
    running: Mutex<HashMap<i64, Read>>,
}

/// A job file that is being read.
#[derive(Debug)]
struct Read {
    submitter: String,
    /// Whether syncs pass its job by.
    is_passed: bool,
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

    /// Jobs whose next frame no claim opens now, because their files are being read.
    pub(super) fn passed(&self) -> PassedJobs {
        let running = self.reads.running.lock().expect("no holder panics");
        let mut passed = PassedJobs::default();
        let mut counts: HashMap<&str, usize> = HashMap::new();
        for (&number, Read { submitter, .. }) in running.iter().filter(|(_, read)| read.is_passed) {
            passed.jobs.push(number);
            let count = counts.entry(submitter).or_default();
            *count += 1;
            if *count == MAX_READ_AT_ONCE {
                passed.submitters.push(submitter.clone());
            }
        }
        passed
    }

    /// Opening of a frame; `None` if its job's file cannot be read within the sync's time, or not any more. Then syncs pass
    /// the job by until it was read; they are woken when it was.
    pub(super) async fn of(
        &self,
        number: i64,
        frame: u32,
        plan: TilePlan,
        turn: &mut OpeningTurn<'_>,
    ) -> Result<Option<FrameOpening>, DatabaseError> {
        if self.reads.jobs.known(number, frame).is_none() {
            let submitter = self.reads.queue.submitter_of(number).await?.unwrap_or_default();
            if let Some(running) = self.reads.begin(number, submitter) {
                let mut read = tokio::spawn(running.read(frame));
                tokio::select! {
                    biased;
                    _ = &mut read => {}
                    () = &mut turn.wait => {}
                }
            }
        }
        let known = self.reads.jobs.known(number, frame);
        if known.is_none() {
            self.reads.pass_by(number);
        }
        Ok(known.map(|facts| facts.opening(number, plan)))
    }

    /// Prepares up to `count` frames after one that is being opened, as far as the job has them.
    pub(super) async fn following(
        &self,
        opening: &FrameOpening,
        plan: TilePlan,
        count: u32,
        turn: &mut OpeningTurn<'_>,
    ) -> Result<Vec<FrameOpening>, DatabaseError> {
        let mut openings = Vec::new();
        for frame in (opening.frame + 1..plan.frames).take(count as usize) {
            match self.of(opening.job, frame, plan, turn).await? {
                Some(next) => openings.push(next),
                None => break,
            }
        }
        Ok(openings)
    }
}

impl Reads {
    /// Records that a job's file is being read; `None` if it already is.
    fn begin(self: &Arc<Self>, number: i64, submitter: String) -> Option<RunningRead> {
        match self.running.lock().expect("no holder panics").entry(number) {
            Entry::Vacant(vacant) => {
                vacant.insert(Read { submitter, is_passed: false });
                Some(RunningRead { reads: Arc::clone(self), number })
            }
            Entry::Occupied(_) => None,
        }
    }

    /// Lets syncs pass a job by, if its file is still being read.
    fn pass_by(&self, number: i64) {
        if let Some(read) = self.running.lock().expect("no holder panics").get_mut(&number) {
            read.is_passed = true;
        }
    }
}

/// A job file that is being read, until this is dropped.
struct RunningRead {
    reads: Arc<Reads>,
    number: i64,
}

impl Drop for RunningRead {
    fn drop(&mut self) {
        let read = self.reads.running.lock().expect("no holder panics").remove(&self.number);
        if read.is_some_and(|read| read.is_passed) {
            self.reads.queue.wake_workers();
        }
    }
}

impl RunningRead {
    /// Reads the file until the frame is known or the job has ended.
    async fn read(self, frame: u32) {
        let mut pause = FIRST_PAUSE;
        while !self.try_read(frame).await {
            self.reads.pass_by(self.number);
            sleep(pause).await;
            pause = (2 * pause).min(MAX_PAUSE);
        }
    }

    /// Reads the file; false if it is to be read again.
    async fn try_read(&self, frame: u32) -> bool {
        let Reads { queue, jobs, .. } = &*self.reads;
        let error = match jobs.frame(queue, self.number, frame).await {
            Ok(_) | Err(JobLoadError::Gone) => return true,
            Err(error @ JobLoadError::Refused(_)) => {
                match queue.fail_unreadable(self.number, error.to_string()).await {
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
        tracing::error!(job = self.number, %error, "could not open a frame");
        false
    }
}
