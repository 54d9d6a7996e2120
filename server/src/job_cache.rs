//! Parses job files, on threads with enough stack for deeply nested ones, and caches a few.
//!
//! Submitters take turns, and claims have threads of their own, so that large submissions delay other submitters' by
//! one file, and no claim. The cache is bounded: waiting jobs are stored in the database only.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, mpsc};

use tokio::sync::oneshot;

use crate::db::DatabaseError;
use crate::delivery_check::ExpectedPicture;
use crate::fair_queue::{FairQueue, QueueTurn, TooManyWaiting, WaitingLimits};
use crate::queue::{FrameOpening, Queue};
use crate::tile_plan::TilePlan;

/// A file above this size is large. Parsing takes up to ten times the size of the file in memory, so large ones are
/// parsed one after another: submitters' on one thread, because the allocator keeps memory by thread.
const LARGE_FILE_BYTES: usize = 256 << 10;
/// Stack size of a parsing thread.
const STACK_BYTES: usize = 16 << 20;
/// Maximum number of cached jobs.
const MAX_CACHED_JOBS: usize = 8;
/// Maximum size of their files in total, unless there is only one.
const MAX_CACHED_BYTES: usize = 8 << 20;

/// Maximum number of files that one submitter waits to have parsed.
const MAX_WAITING: usize = 256;

/// Reason for which a job is parsed.
#[derive(Clone, Copy, Debug)]
pub(crate) enum ParseReason<'a> {
    /// A submission of this caller.
    Submitter(&'a str),
    /// A claim of work of the job with this number.
    Claim(i64),
}

/// Error when loading a job of the queue.
#[derive(Debug, thiserror::Error)]
pub(crate) enum JobLoadError {
    /// The database could not be read.
    #[error(transparent)]
    Store(#[from] DatabaseError),
    /// The file is missing: the job was deleted in the meantime.
    #[error("the job was deleted")]
    Gone,
    /// The file was accepted once, but this version rejects it.
    #[error("this version rejects the job's file: {0}")]
    Refused(#[from] scene::ParseError),
    /// The submitter has too many files waiting.
    #[error("{name} has {limit} jobs waiting to be parsed")]
    TooManyWaiting {
        /// The submitter.
        name: String,
        /// Maximum number of waiting files.
        limit: usize,
    },
    /// No thread to parse it on.
    #[error("no thread could be started to parse the job")]
    Thread,
}

/// Work of a thread.
type Task = Box<dyn FnOnce() + Send>;

/// Parses and caches jobs.
#[derive(Debug)]
pub(crate) struct JobCache {
    kept: Mutex<VecDeque<CachedJob>>,
    submitters: Arc<FairQueue>,
    /// One place for all large files of submitters, whatever the number of cores.
    large: Arc<FairQueue>,
    large_thread: Mutex<mpsc::Sender<Task>>,
    claims: Arc<FairQueue>,
    /// One place for all large files of claims.
    large_claims: Arc<FairQueue>,
}

#[derive(Debug)]
struct CachedJob {
    number: i64,
    text_bytes: usize,
    job: Arc<scene::Job>,
}

impl JobCache {
    /// Parsing threads: one for each core for submissions, as many for claims, and one for large files.
    pub(crate) fn new() -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            kept: Mutex::default(),
            submitters: FairQueue::new(cores, WaitingLimits::of_one(MAX_WAITING)),
            large: FairQueue::new(1, WaitingLimits::of_one(MAX_WAITING)),
            large_thread: Mutex::new(start_large_thread()),
            claims: FairQueue::new(cores, WaitingLimits::of_one(usize::MAX)),
            large_claims: FairQueue::new(1, WaitingLimits::of_one(usize::MAX)),
        }
    }

    /// Parses a job file on its own thread, and calls `work` with the result there.
    pub(crate) async fn parse<T: Send + 'static>(
        &self,
        reader: ParseReason<'_>,
        text: bytes::Bytes,
        work: impl FnOnce(Result<scene::Job, scene::ParseError>) -> T + Send + 'static,
    ) -> Result<T, JobLoadError> {
        self.read(reader, text.len(), move || work(scene::parse(&text))).await
    }

    /// Runs `work` on a job file of this size, when it is the reader's turn.
    pub(crate) async fn read<T: Send + 'static>(
        &self,
        reader: ParseReason<'_>,
        text_bytes: usize,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, JobLoadError> {
        match reader {
            ParseReason::Submitter(name) if text_bytes > LARGE_FILE_BYTES => {
                let place = enter(&self.large, name).await?;
                run_on(place, work, |task| self.start_large(task)).await
            }
            ParseReason::Submitter(_) | ParseReason::Claim(_) => self.run(reader, work).await,
        }
    }

    fn start_large(&self, mut task: Task) -> Result<(), JobLoadError> {
        let mut thread = self.large_thread.lock().expect("no holder panics");
        // A thread that could not be started, or has ended, is started again.
        for _ in 0..2 {
            match thread.send(task) {
                Ok(()) => return Ok(()),
                Err(mpsc::SendError(unsent)) => task = unsent,
            }
            *thread = start_large_thread();
        }
        Err(JobLoadError::Thread)
    }

    /// Opening of a frame of a job with this number and plan; for an animated job this copies the scene.
    pub(crate) async fn frame_opening(
        &self,
        reader: ParseReason<'_>,
        job: &Arc<scene::Job>,
        number: i64,
        frame: u32,
        plan: TilePlan,
    ) -> Result<FrameOpening, JobLoadError> {
        let (moves, at) = (job.is_animated(), Arc::clone(job));
        let keys = move || match at.at(frame) {
            Ok(at_frame) => (at_frame.cache_key(), Some(at_frame.scene_hash().to_hex().to_string())),
            Err(_) => (at.cache_key(frame), None),
        };
        let (key, scene) = if moves { self.run(reader, keys).await? } else { keys() };
        let picture_key = key.to_hex().to_string();
        Ok(FrameOpening { job: number, frame, picture_key, scene, tiles: plan.tiles(), samples: plan.samples })
    }

    /// Expected picture of a frame; for an animated job this copies the scene.
    pub(crate) async fn expected_picture(
        &self,
        reader: ParseReason<'_>,
        job: &Arc<scene::Job>,
        frame: u32,
    ) -> Result<Result<ExpectedPicture, scene::FrameError>, JobLoadError> {
        let (moves, job) = (job.is_animated(), Arc::clone(job));
        let expected = move || ExpectedPicture::new(&job, frame);
        if moves { self.run(reader, expected).await } else { Ok(expected()) }
    }

    /// Runs `work` on a thread of its own, when it is the reader's turn.
    pub(crate) async fn run<T: Send + 'static>(
        &self,
        reader: ParseReason<'_>,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, JobLoadError> {
        let place = self.turn(reader).await?;
        run_on_thread(place, work).await
    }

    async fn turn(&self, reader: ParseReason<'_>) -> Result<QueueTurn, JobLoadError> {
        match reader {
            ParseReason::Submitter(name) => enter(&self.submitters, name).await,
            ParseReason::Claim(job) => enter(&self.claims, &job.to_string()).await,
        }
    }

    /// Caches a job; the ones cached longest are dropped.
    pub(crate) fn insert(&self, number: i64, text_bytes: usize, job: Arc<scene::Job>) {
        let mut kept = self.kept.lock().expect("no holder panics");
        kept.push_front(CachedJob { number, text_bytes, job });
        let mut sum_bytes = 0;
        let mut count = 0;
        kept.retain(|job| {
            sum_bytes += job.text_bytes;
            count += 1;
            count == 1 || (count <= MAX_CACHED_JOBS && sum_bytes <= MAX_CACHED_BYTES)
        });
    }

    /// A job of the queue, for a claim: from the cache or from the database.
    pub(crate) async fn get(&self, queue: &Queue, number: i64) -> Result<Arc<scene::Job>, JobLoadError> {
        if let Some(job) = self.find(number) {
            return Ok(job);
        }
        let mut place = self.turn(ParseReason::Claim(number)).await?;
        // Another claim may have parsed the job in the meantime.
        if let Some(job) = self.find(number) {
            return Ok(job);
        }
        let mut text = queue.file_of(number).await?.ok_or(JobLoadError::Gone)?;
        if text.len() > LARGE_FILE_BYTES {
            // Claims that wait keep neither a thread nor the text.
            drop((place, text));
            place = enter(&self.large_claims, &number.to_string()).await?;
            if let Some(job) = self.find(number) {
                return Ok(job);
            }
            text = queue.file_of(number).await?.ok_or(JobLoadError::Gone)?;
        }
        let text_bytes = text.len();
        let job = Arc::new(run_on_thread(place, move || scene::parse(text.as_bytes())).await??);
        self.insert(number, text_bytes, Arc::clone(&job));
        Ok(job)
    }

    fn find(&self, number: i64) -> Option<Arc<scene::Job>> {
        let kept = self.kept.lock().expect("no holder panics");
        kept.iter().find(|kept| kept.number == number).map(|kept| Arc::clone(&kept.job))
    }
}

async fn enter(queue: &Arc<FairQueue>, name: &str) -> Result<QueueTurn, JobLoadError> {
    let entered = queue.enter(name).await;
    entered.map_err(|TooManyWaiting(limit)| JobLoadError::TooManyWaiting { name: name.to_owned(), limit })
}

/// Runs `work` on a thread of its own, which has the place until it has finished, even if its caller is gone.
async fn run_on_thread<T: Send + 'static>(
    place: QueueTurn,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, JobLoadError> {
    let start = |task| parsing_thread().spawn(task).map(drop).map_err(|_| JobLoadError::Thread);
    run_on(place, work, start).await
}

/// Runs `work` on a thread that `start` gives it to.
async fn run_on<T: Send + 'static>(
    place: QueueTurn,
    work: impl FnOnce() -> T + Send + 'static,
    start: impl FnOnce(Task) -> Result<(), JobLoadError>,
) -> Result<T, JobLoadError> {
    let (reply, answer) = oneshot::channel();
    start(Box::new(move || {
        let done = work();
        drop(place);
        drop(reply.send(done));
    }))?;
    answer.await.map_err(|_| JobLoadError::Thread)
}

fn parsing_thread() -> std::thread::Builder {
    std::thread::Builder::new().name("parse".to_owned()).stack_size(STACK_BYTES)
}

/// Starts the thread for large files; if it can't be started, the sender has no receiver.
fn start_large_thread() -> mpsc::Sender<Task> {
    let (sender, tasks) = mpsc::channel::<Task>();
    let run = move || {
        for task in tasks {
            // A panic is logged, and drops the reply: its caller gets an error.
            drop(catch_unwind(AssertUnwindSafe(task)));
        }
    };
    if let Err(error) = parsing_thread().spawn(run) {
        tracing::warn!(%error, "no thread for large job files could be started");
    }
    sender
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Caches jobs with these numbers and sizes; returns the numbers of those that are cached afterwards.
    fn cached(inserted: &[(i64, usize)]) -> Vec<i64> {
        let text = r#"{ "scene": { "camera": { "position": [0, 0, 3], "look_at": [0, 0, 0] },
                        "objects": [{ "shape": { "sphere": { "radius": 1 } } }] },
                        "image": { "width": 8, "height": 8 } }"#;
        let job = scene::parse(text.as_bytes()).expect("a valid job");
        let cache = JobCache::new();
        let jobs: Vec<_> = inserted.iter().map(|&(number, _)| (number, Arc::new(job.clone()))).collect();
        for (&(number, text_bytes), (_, job)) in inserted.iter().zip(&jobs) {
            cache.insert(number, text_bytes, Arc::clone(job));
        }
        let is_cached = |(number, job): &(i64, Arc<scene::Job>)| {
            let found = cache.find(*number);
            assert!(found.as_ref().is_none_or(|found| Arc::ptr_eq(found, job)), "job {number} is another");
            found.is_some().then_some(*number)
        };
        jobs.iter().filter_map(is_cached).collect()
    }

    #[tokio::test]
    async fn large_files_are_parsed_one_at_a_time_and_delay_no_small_ones() {
        let cache = JobCache::new();
        let large = bytes::Bytes::from(vec![b' '; LARGE_FILE_BYTES + 1]);
        let (end, ended) = mpsc::channel::<()>();
        let hold = move |_| assert!(ended.recv().is_err(), "it ends with the test");
        let mut first = Box::pin(cache.parse(ParseReason::Submitter("anna"), large.clone(), hold));
        assert!(futures_util::poll!(&mut first).is_pending());
        let mut second = Box::pin(cache.parse(ParseReason::Submitter("bert"), large.clone(), |_| 2));
        assert!(futures_util::poll!(&mut second).is_pending());
        let waits = cache.large.enter("carl");
        let mut waits = Box::pin(waits);
        assert!(futures_util::poll!(&mut waits).is_pending(), "its place is taken");
        assert_eq!(
            cache.parse(ParseReason::Claim(7), large, |_| 7).await.expect("a thread"),
            7,
            "a claim needs no place"
        );
        drop((end, waits));
        first.await.expect("a thread");
        assert_eq!(second.await.expect("a thread"), 2);
    }

    #[tokio::test]
    async fn claims_do_not_wait_behind_submissions() {
        let cache = Arc::new(JobCache::new());
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let mut ends = Vec::new();
        for _ in 0..=cores {
            let (end, ended) = mpsc::channel::<()>();
            ends.push(end);
            let work = move || assert!(ended.recv().is_err(), "it ends with the test");
            let mut running = Box::pin(cache.run(ParseReason::Submitter("anna"), work));
            assert!(futures_util::poll!(&mut running).is_pending());
            // A client that is gone leaves its file on the thread, which stays occupied.
            drop(running);
        }
        let mut submission = Box::pin(cache.run(ParseReason::Submitter("anna"), || 1));
        assert!(futures_util::poll!(&mut submission).is_pending());
        assert_eq!(cache.run(ParseReason::Claim(7), || 2).await.expect("a thread"), 2);
        assert!(futures_util::poll!(&mut submission).is_pending(), "every thread for submissions is occupied");
        drop(ends);
        assert_eq!(submission.await.expect("a thread"), 1);
    }

    #[test]
    fn the_newest_jobs_are_cached_up_to_a_number_and_a_size() {
        let small: Vec<_> = (1..=9).map(|number| (number, 100)).collect();
        assert_eq!(cached(&small), [2, 3, 4, 5, 6, 7, 8, 9]);
        assert_eq!(cached(&[(1, 5 << 20), (2, 3 << 20)]), [1, 2]);
        assert_eq!(cached(&[(1, 5 << 20), (2, 3 << 20), (3, 1)]), [2, 3]);
        assert_eq!(cached(&[(1, 100), (2, 9 << 20)]), [2], "a single job may be larger");
    }
}
