//! Reads job files: what a submitter wrote is parsed, expanded and planned in processes of its own, which have limits of
//! memory and time, so that no text can end or delay the server.
//!
//! Submitters take turns, and claims have processes of their own. A file that takes long, or much memory, is read again
//! alone, so that it delays no other submitter's but another such file.

mod answer;
mod process;
mod processes;

use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use bytes::Bytes;
use tokio::sync::oneshot;

use answer::{Answer, Question};
pub(crate) use answer::{FrameFacts, JobFacts, Refusal};
pub use process::run;
pub use processes::READER_COMMAND;
use processes::{Cost, Limits, NoAnswer, Processes};

use crate::db::DatabaseError;
use crate::fair_queue::{FairQueue, QueueTurn, TooManyWaiting, WaitingLimits};
use crate::queue::Queue;

/// A file above this size is read alone.
const LARGE_FILE_BYTES: usize = 256 << 10;
/// A debug build reads this many times slower.
const SLOWNESS: u32 = if cfg!(debug_assertions) { 3 } else { 1 };
/// Limits of a file that is read beside others.
const BESIDE_OTHERS: Limits =
    Limits { memory_bytes: 256 << 20, time: Duration::from_millis(300).saturating_mul(SLOWNESS) };
/// Limits of a file that is read alone.
const ALONE: Limits =
    Limits { memory_bytes: 2 << 30, time: Duration::from_secs(MAX_READ_SECONDS).saturating_mul(SLOWNESS) };
/// Maximum time of one core to read a file, in seconds.
const MAX_READ_SECONDS: u64 = 2;
/// Maximum number of processes that are kept while they have nothing to read.
const MAX_IDLE: usize = 16;
/// Maximum number of frames of the queue's jobs that are known without reading their files.
const MAX_KNOWN_FRAMES: usize = 4096;
/// Maximum memory of what is known of them.
const MAX_KNOWN_BYTES: usize = 8 << 20;
/// Maximum number of files that one submitter waits to have read.
const MAX_WAITING: usize = 256;

/// How a file is read.
#[derive(Clone, Copy, Debug)]
enum Lane {
    BesideOthers,
    Alone,
}

/// Reason for which a job is read.
#[derive(Clone, Copy, Debug)]
enum ParseReason<'a> {
    /// A request of this caller.
    Submitter(&'a str),
    /// A claim of work of this submitter's job.
    Claim(&'a str),
}

/// Error when reading a job.
#[derive(Debug, thiserror::Error)]
pub(crate) enum JobLoadError {
    /// The database could not be read.
    #[error(transparent)]
    Store(#[from] DatabaseError),
    /// The file is missing: the job was deleted in the meantime.
    #[error("the job was deleted")]
    Gone,
    /// The file is rejected. Of the queue's jobs: it was accepted once, but this version rejects it.
    #[error("this version rejects the job's file: {0}")]
    Refused(Refusal),
    /// The submitter has too many files waiting.
    #[error("{name} has {limit} jobs waiting to be parsed")]
    TooManyWaiting {
        /// The submitter.
        name: String,
        /// Maximum number of waiting files.
        limit: usize,
    },
    /// No process or thread to read it.
    #[error("no process could read the job: {0}")]
    Broken(std::io::Error),
    /// The process that reads it answered something else.
    #[error("the process that reads jobs is of another release")]
    Unexpected,
}

/// Reads jobs.
#[derive(Debug)]
pub(crate) struct JobReader {
    processes: Processes,
    known: Mutex<KnownFrames>,
    submitters: Arc<FairQueue>,
    claims: Arc<FairQueue>,
    /// One place for all files of submitters that take long.
    alone: Arc<FairQueue>,
    /// One place for all files of claims that take long.
    claims_alone: Arc<FairQueue>,
}

impl JobReader {
    /// Reads with processes of this program: one for each core for submitters, as many for claims, and one of each for files
    /// that take long. Without a program, it reads on threads, without limits.
    pub(crate) fn new(program: Option<PathBuf>) -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            processes: Processes::new(program, (2 * cores).min(MAX_IDLE)),
            known: Mutex::default(),
            submitters: FairQueue::new(cores, WaitingLimits::of_one(MAX_WAITING)),
            claims: FairQueue::new(cores, WaitingLimits::of_one(usize::MAX)),
            alone: FairQueue::new(1, WaitingLimits::of_one(MAX_WAITING)),
            claims_alone: FairQueue::new(1, WaitingLimits::of_one(usize::MAX)),
        }
    }

    /// Reads a job, with the facts for its acceptance if `accept`; `edge_px` is the operator's edge of a tile.
    pub(crate) async fn job(
        &self,
        submitter: &str,
        text: Bytes,
        accept: bool,
        edge_px: Option<u32>,
    ) -> Result<JobFacts, JobLoadError> {
        match self.ask(submitter, Question::Job { accept, edge_px }, text).await? {
            Answer::Job(facts) => Ok(*facts),
            _ => Err(JobLoadError::Unexpected),
        }
    }

    /// Checks that a job can be rendered at a frame; the error is the number of its frames, if it has no such frame.
    pub(crate) async fn check_frame(
        &self,
        submitter: &str,
        text: Bytes,
        frame: u32,
    ) -> Result<Result<(), u32>, JobLoadError> {
        match self.ask(submitter, Question::Frame(frame), text).await? {
            Answer::Fine => Ok(Ok(())),
            Answer::NoFrame(count) => Ok(Err(count)),
            _ => Err(JobLoadError::Unexpected),
        }
    }

    /// A job's text, formatted.
    pub(crate) async fn format(&self, submitter: &str, text: Bytes) -> Result<String, JobLoadError> {
        match self.ask(submitter, Question::Format, text).await? {
            Answer::Text(text) => Ok(text),
            _ => Err(JobLoadError::Unexpected),
        }
    }

    /// A job's text with values at paths; the error says why one cannot be set.
    pub(crate) async fn set(
        &self,
        submitter: &str,
        text: Bytes,
        values: Vec<(String, String)>,
    ) -> Result<Result<String, String>, JobLoadError> {
        match self.ask(submitter, Question::Set(values), text).await? {
            Answer::Text(text) => Ok(Ok(text)),
            Answer::WrongValue(message) => Ok(Err(message)),
            _ => Err(JobLoadError::Unexpected),
        }
    }

    /// Facts of a frame of the queue's job: known, or read from the job's file.
    pub(crate) async fn frame(&self, queue: &Queue, number: i64, frame: u32) -> Result<Arc<FrameFacts>, JobLoadError> {
        if let Some(known) = self.known(number, frame) {
            return Ok(known);
        }
        let submitter = queue.submitter_of(number).await?.ok_or(JobLoadError::Gone)?;
        for lane in [Lane::BesideOthers, Lane::Alone] {
            // A claim that waits keeps no text, and another one may have read the job in the meantime.
            let _place = self.turn(lane, ParseReason::Claim(&submitter)).await?;
            if let Some(known) = self.known(number, frame) {
                return Ok(known);
            }
            let text = Bytes::from(queue.file_of(number).await?.ok_or(JobLoadError::Gone)?);
            match self.ask_in(lane, Question::Frames { first: frame }, text, Some(number)).await? {
                Some(Answer::Frames(frames)) => {
                    self.insert(number, frames);
                    break;
                }
                Some(_) => return Err(JobLoadError::Unexpected),
                None => {}
            }
        }
        self.known(number, frame).ok_or(JobLoadError::Unexpected)
    }

    /// Remembers frames of a job.
    pub(crate) fn insert(&self, number: i64, frames: Vec<FrameFacts>) {
        self.known.lock().expect("no holder panics").insert(number, frames);
    }

    /// Facts of a frame of the queue's job, if they are known.
    pub(crate) fn known(&self, number: i64, frame: u32) -> Option<Arc<FrameFacts>> {
        self.known.lock().expect("no holder panics").frames.get(&(number, frame)).cloned()
    }

    async fn ask(&self, submitter: &str, question: Question, text: Bytes) -> Result<Answer, JobLoadError> {
        for lane in [Lane::BesideOthers, Lane::Alone] {
            let _place = self.turn(lane, ParseReason::Submitter(submitter)).await?;
            if let Some(answer) = self.ask_in(lane, question.clone(), text.clone(), None).await? {
                return Ok(answer);
            }
        }
        Err(JobLoadError::Unexpected)
    }

    /// Asks in a lane; `None` if the file must be read alone.
    async fn ask_in(
        &self,
        lane: Lane,
        question: Question,
        text: Bytes,
        job: Option<i64>,
    ) -> Result<Option<Answer>, JobLoadError> {
        let limits = match lane {
            Lane::BesideOthers if text.len() > LARGE_FILE_BYTES => return Ok(None),
            Lane::BesideOthers => BESIDE_OTHERS,
            Lane::Alone => ALONE,
        };
        match (self.processes.ask(question, text, job, limits).await, lane) {
            (Ok(Answer::Refused(refusal)), _) => Err(JobLoadError::Refused(refusal)),
            (Ok(answer), _) => Ok(Some(answer)),
            (Err(NoAnswer::Broken(error)), _) => Err(JobLoadError::Broken(error)),
            (Err(NoAnswer::TooCostly(_) | NoAnswer::Ended), Lane::BesideOthers) => Ok(None),
            (Err(NoAnswer::TooCostly(cost)), Lane::Alone) => {
                Err(JobLoadError::Refused(Refusal::too_costly(excess(cost))))
            }
            (Err(NoAnswer::Ended), Lane::Alone) => {
                Err(JobLoadError::Broken(std::io::Error::other("each process was killed")))
            }
        }
    }

    async fn turn(&self, lane: Lane, reason: ParseReason<'_>) -> Result<QueueTurn, JobLoadError> {
        match (reason, lane) {
            (ParseReason::Submitter(name), Lane::BesideOthers) => enter(&self.submitters, name).await,
            (ParseReason::Submitter(name), Lane::Alone) => enter(&self.alone, name).await,
            (ParseReason::Claim(name), Lane::BesideOthers) => enter(&self.claims, name).await,
            (ParseReason::Claim(name), Lane::Alone) => enter(&self.claims_alone, name).await,
        }
    }

    /// Runs `work` on a thread of its own, when it is the submitter's turn.
    pub(crate) async fn run<T: Send + 'static>(
        &self,
        submitter: &str,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, JobLoadError> {
        let place = enter(&self.submitters, submitter).await?;
        let (reply, answer) = oneshot::channel();
        let run = move || {
            let done = work();
            // The thread has the place until it has finished, even if its caller is gone.
            drop(place);
            drop(reply.send(done));
        };
        std::thread::Builder::new().name("body".to_owned()).spawn(run).map_err(JobLoadError::Broken)?;
        answer.await.map_err(|_| JobLoadError::Broken(std::io::Error::other("its thread panicked")))
    }
}

/// Error of a file that takes too much, and the fix.
fn excess(cost: Cost) -> String {
    match cost {
        Cost::Time => format!(
            "takes more than {MAX_READ_SECONDS} s to read: use fewer copies, and shorter formulas in them, fewer keys or fewer nodes"
        ),
        Cost::Memory => format!(
            "takes more than {} GiB of memory to read: use fewer copies, uses of shapes, keys or nodes",
            ALONE.memory_bytes >> 30
        ),
        Cost::Unknown => {
            "ended the process that read it, which is a fault of sdfarm: please report it, and use fewer nodes"
                .to_owned()
        }
    }
}

async fn enter(queue: &Arc<FairQueue>, name: &str) -> Result<QueueTurn, JobLoadError> {
    let entered = queue.enter(name).await;
    entered.map_err(|TooManyWaiting(limit)| JobLoadError::TooManyWaiting { name: name.to_owned(), limit })
}

/// Frames of jobs of the queue, up to a number and a size; those that were read first are forgotten first.
#[derive(Debug, Default)]
struct KnownFrames {
    frames: BTreeMap<(i64, u32), Arc<FrameFacts>>,
    order: VecDeque<(i64, u32)>,
    bytes: usize,
}

impl KnownFrames {
    fn insert(&mut self, number: i64, frames: Vec<FrameFacts>) {
        for facts in frames {
            let place = (number, facts.frame);
            self.bytes += facts.bytes();
            match self.frames.insert(place, Arc::new(facts)) {
                Some(old) => self.bytes -= old.bytes(),
                None => self.order.push_back(place),
            }
        }
        // The newest one is kept, however large it is.
        while self.order.len() > 1 && (self.order.len() > MAX_KNOWN_FRAMES || self.bytes > MAX_KNOWN_BYTES) {
            let Some(oldest) = self.order.pop_front() else { break };
            if let Some(facts) = self.frames.remove(&oldest) {
                self.bytes -= facts.bytes();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const JOB: &str = r#"{ "name": "ball", "frames": { "count": 9 },
        "scene": { "camera": { "position": [0, 0, 3], "look_at": [0, 0, 0] },
                   "objects": [{ "shape": { "sphere": { "radius": { "expr": "1 + t" } } } }] },
        "image": { "width": 8, "height": 8 } }"#;

    fn facts(frame: u32, bytes: usize) -> FrameFacts {
        FrameFacts { frame, picture_key: String::new(), scene: None, expected: Err(" ".repeat(bytes)) }
    }

    #[test]
    fn the_newest_frames_are_known_up_to_a_number_and_a_size() {
        let mut known = KnownFrames::default();
        (0..).take(MAX_KNOWN_FRAMES + 2).for_each(|number| known.insert(number, vec![facts(0, 10)]));
        assert_eq!(known.frames.keys().next(), Some(&(2, 0)));
        known.insert(-1, vec![facts(0, 1), facts(0, MAX_KNOWN_BYTES)]);
        assert_eq!(known.frames.keys().collect::<Vec<_>>(), [&(-1, 0)], "a single frame may be larger");
        known.insert(-2, vec![facts(3, 1), facts(4, 1)]);
        assert_eq!(known.frames.keys().collect::<Vec<_>>(), [&(-2, 3), &(-2, 4)]);
        assert_eq!(known.bytes, known.frames.values().map(|facts| facts.bytes()).sum::<usize>());
    }

    #[tokio::test]
    async fn a_job_is_read_with_its_first_frames_if_it_is_to_be_accepted() {
        let reader = JobReader::new(None);
        let text = Bytes::from_static(JOB.as_bytes());
        let asked = reader.job("anna", text.clone(), false, None).await.expect("a valid job");
        assert_eq!((asked.name.as_str(), asked.plan.frames, asked.nodes, asked.frames.len()), ("ball", 9, 0, 0));
        let accepted = reader.job("anna", text.clone(), true, Some(4)).await.expect("a valid job");
        assert_eq!((accepted.plan.edge_px, accepted.nodes), (Some(4), 1));
        let job = scene::parse(JOB.as_bytes()).expect("a valid job");
        assert!(accepted.frames.len() > 1, "they take microseconds");
        for facts in &accepted.frames {
            assert_eq!(facts.picture_key, job.cache_key(facts.frame).to_hex().as_str());
            assert!(facts.scene.is_some() && facts.expected.is_ok(), "{facts:?}");
        }
        assert_eq!(reader.check_frame("anna", text.clone(), 8).await.expect("read"), Ok(()));
        assert_eq!(reader.check_frame("anna", text, 9).await.expect("read"), Err(9));
        let wrong = Bytes::from_static(b"{ \"scene\": 1 }");
        let refused = reader.job("anna", wrong, true, None).await.expect_err("not a job");
        assert!(matches!(&refused, JobLoadError::Refused(refusal) if refusal.is_json && !refusal.errors.is_empty()));
        let refused = reader.format("anna", Bytes::from_static(b"{")).await.expect_err("not JSON");
        assert!(matches!(&refused, JobLoadError::Refused(refusal) if !refusal.is_json));
    }

    #[tokio::test]
    async fn what_a_submitter_occupies_delays_no_claim_and_no_other_place() {
        let reader = JobReader::new(None);
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let mut occupied = Vec::new();
        for _ in 0..cores {
            occupied.push(reader.turn(Lane::BesideOthers, ParseReason::Submitter("anna")).await.expect("a place"));
        }
        let mut waiting = Box::pin(reader.run("anna", || 1));
        assert!(futures_util::poll!(&mut waiting).is_pending());
        drop(
            reader.turn(Lane::BesideOthers, ParseReason::Claim("anna")).await.expect("claims have places of their own"),
        );
        // A file that takes long gives its place back.
        let _alone = enter(&reader.alone, "anna").await.expect("the place");
        let large = Bytes::from(vec![b' '; LARGE_FILE_BYTES + 1]);
        drop(occupied.pop());
        assert_eq!(waiting.await.expect("a thread"), 1);
        let mut slow = Box::pin(reader.format("anna", large));
        assert!(futures_util::poll!(&mut slow).is_pending(), "one is read alone already");
        assert_eq!(reader.run("anna", || 2).await.expect("a thread"), 2, "it waits at no other place");
    }
}
