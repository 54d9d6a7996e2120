//! Parses job files, on threads with enough stack for deeply nested ones, and caches a few.
//!
//! The cache is bounded: waiting jobs are stored in the database only.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use tokio::sync::{Semaphore, oneshot};

use crate::database::DatabaseError;
use crate::delivery_check::ExpectedPicture;
use crate::queue::Queue;

/// Stack size of a parsing thread.
const STACK_BYTES: usize = 16 << 20;
/// Maximum number of cached jobs.
const MAX_CACHED_JOBS: usize = 8;
/// Maximum size of their files in total, unless there is only one.
const MAX_CACHED_BYTES: usize = 8 << 20;

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
    /// No thread to parse it on.
    #[error("no thread could be started to parse the job")]
    Thread,
}

/// Parses and caches jobs.
#[derive(Debug)]
pub(crate) struct JobCache {
    kept: Mutex<VecDeque<CachedJob>>,
    permits: Semaphore,
}

#[derive(Debug)]
struct CachedJob {
    number: i64,
    text_bytes: usize,
    job: Arc<scene::Job>,
}

impl JobCache {
    /// Permits for parsing threads: as many files at a time as there are cores.
    pub(crate) fn new() -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        Self { kept: Mutex::default(), permits: Semaphore::new(cores) }
    }

    /// Parses a job file on its own thread, and calls `work` with the result there.
    pub(crate) async fn parse<T: Send + 'static>(
        &self,
        text: bytes::Bytes,
        work: impl FnOnce(Result<scene::Job, scene::ParseError>) -> T + Send + 'static,
    ) -> Result<T, JobLoadError> {
        self.run_on_parser_thread(move || work(scene::parse(&text))).await
    }

    /// Cache key of a frame's picture; for an animated job this copies the scene.
    pub(crate) async fn picture_key(&self, job: &Arc<scene::Job>, frame: u32) -> Result<String, JobLoadError> {
        let (moves, job) = (job.is_animated(), Arc::clone(job));
        let key = move || job.cache_key(frame).to_hex().to_string();
        if moves { self.run_on_parser_thread(key).await } else { Ok(key()) }
    }

    /// Expected picture of a frame; for an animated job this copies the scene.
    pub(crate) async fn expected_picture(
        &self,
        job: &Arc<scene::Job>,
        frame: u32,
    ) -> Result<Result<ExpectedPicture, scene::FrameError>, JobLoadError> {
        let (moves, job) = (job.is_animated(), Arc::clone(job));
        let expected = move || ExpectedPicture::new(&job, frame);
        if moves { self.run_on_parser_thread(expected).await } else { Ok(expected()) }
    }

    async fn run_on_parser_thread<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, JobLoadError> {
        let _permit = self.permits.acquire().await.map_err(|_| JobLoadError::Thread)?;
        let (reply, answer) = oneshot::channel();
        std::thread::Builder::new()
            .name("parse".to_owned())
            .stack_size(STACK_BYTES)
            .spawn(move || drop(reply.send(work())))
            .map_err(|_| JobLoadError::Thread)?;
        answer.await.map_err(|_| JobLoadError::Thread)
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

    /// A job of the queue, from the cache or from the database.
    pub(crate) async fn get(&self, queue: &Queue, number: i64) -> Result<Arc<scene::Job>, JobLoadError> {
        if let Some(job) = self.find(number) {
            return Ok(job);
        }
        let text = queue.file_of(number).await?.ok_or(JobLoadError::Gone)?;
        let text_bytes = text.len();
        let job = Arc::new(self.parse(text.into(), |parsed| parsed).await??);
        self.insert(number, text_bytes, Arc::clone(&job));
        Ok(job)
    }

    fn find(&self, number: i64) -> Option<Arc<scene::Job>> {
        let kept = self.kept.lock().expect("no holder panics");
        kept.iter().find(|kept| kept.number == number).map(|kept| Arc::clone(&kept.job))
    }
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

    #[test]
    fn the_newest_jobs_are_cached_up_to_a_number_and_a_size() {
        let small: Vec<_> = (1..=9).map(|number| (number, 100)).collect();
        assert_eq!(cached(&small), [2, 3, 4, 5, 6, 7, 8, 9]);
        assert_eq!(cached(&[(1, 5 << 20), (2, 3 << 20)]), [1, 2]);
        assert_eq!(cached(&[(1, 5 << 20), (2, 3 << 20), (3, 1)]), [2, 3]);
        assert_eq!(cached(&[(1, 100), (2, 9 << 20)]), [2], "a single job may be larger");
    }
}
