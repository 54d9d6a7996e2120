//! Helper processes that draw previews and measure samples: the server touches no pixel and evaluates no scene,
//! so that no scene can crash or stall it.
//!
//! A helper process is started on demand, a few at a time, with a time limit; it exits when its standard
//! input closes, so a killed server leaves none behind.

use std::collections::VecDeque;
use std::io;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime};

use bytes::Bytes;
use proto::JobId;
use proto::preview_helper::{self, CostSample, HelperRequest};
use serde::de::DeserializeOwned;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::process::{Child, Command};

use crate::blobs::{ContentError, LocalCopies};
use crate::clock::monotonic_now;
use crate::fair_queue::{FairQueue, QueueTurn, WaitingLimits};

/// Maximum number of helper processes.
const MAX_CHILDREN: usize = 2;
/// Requests that may wait for a helper.
const WAITING: WaitingLimits = WaitingLimits { of_one: 16, of_all: 64 };
/// Maximum number of helper processes for clients that edit a job and wait for its picture. Apart from the others, so
/// that no preview or estimate of the queue delays a keystroke.
const MAX_LIVE_CHILDREN: usize = 2;
/// Requests of editing clients that may wait: a client drops its request when it sends the next.
const LIVE_WAITING: WaitingLimits = WaitingLimits { of_one: 4, of_all: 64 };
/// Maximum wait for a helper: longer than one runs, so that no submitter's slow previews keep another from its turn.
const MAX_WAIT: Duration = TIME_LIMIT.saturating_add(Duration::from_secs(5));
/// Estimates wait in turn with the submitters of previews, under a name that no key has.
const ESTIMATES: &str = " estimates";
/// Time limit of a helper process.
pub(crate) const TIME_LIMIT: Duration = Duration::from_secs(20);
/// Maximum size of a response.
const MAX_ANSWER_BYTES: u64 = 64 << 20;
/// Maximum number of bytes stored of a helper's standard error.
const MAX_STDERR_BYTES: u64 = 2 << 10;
/// Maximum number of cached pictures.
const MAX_CACHED_PICTURES: usize = 32;
/// Maximum size of the cached pictures in total, unless there is only one.
const MAX_CACHED_BYTES: usize = 16 << 20;
/// Maximum number of coarse passes kept in the folder.
const MAX_COARSE_FILES: usize = 256;
/// Name of the folder of coarse passes.
const FOLDER: &str = "previews";

/// Error that prevents a preview or a sample.
#[derive(Debug, thiserror::Error)]
pub(crate) enum HelperError {
    /// Too many requests.
    #[error("too many previews and estimates are requested: retry in a few seconds")]
    Busy,
    /// It took too long.
    #[error("the preview or estimate timed out after {} s", TIME_LIMIT.as_secs())]
    TimedOut,
    /// The helper could not be started.
    #[error("could not start the preview helper: {0}")]
    Start(io::Error),
    /// The stored files that it should read could not be fetched.
    #[error(transparent)]
    Fetch(#[from] ContentError),
    /// The helper failed.
    #[error("the preview helper failed: {0}")]
    Failed(String),
}

/// Starts helper processes.
#[derive(Debug)]
pub(crate) struct PreviewHelper {
    program: PathBuf,
    folder: PathBuf,
    turns: Arc<FairQueue>,
    live_turns: Arc<FairQueue>,
    kept: Mutex<VecDeque<(String, Bytes)>>,
}

impl PreviewHelper {
    /// Opens the folder of coarse passes and empties it; they are rendered again on demand.
    pub(crate) fn open(data: &Path, program: &Path) -> io::Result<Self> {
        let folder = data.join(FOLDER);
        match std::fs::remove_dir_all(&folder) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            Ok(()) | Err(_) => {}
        }
        std::fs::create_dir_all(&folder)?;
        let turns = FairQueue::new(MAX_CHILDREN, WAITING);
        let live_turns = FairQueue::new(MAX_LIVE_CHILDREN, LIVE_WAITING);
        Ok(Self { program: program.to_owned(), folder, turns, live_turns, kept: Mutex::default() })
    }

    /// Path of a frame's coarse pass.
    pub(crate) fn coarse(&self, job: JobId, frame: u32) -> PathBuf {
        self.folder.join(format!("{job}-{frame}"))
    }

    /// Folder for copies of stored files that a helper reads; emptied at the next start.
    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Picture with this entity tag, from the cache or drawn in the turn of its submitter, when the request is made: the
    /// files that it names exist until the helper has ended.
    pub(crate) async fn picture(
        &self,
        submitter: &str,
        tag: &str,
        request: impl Future<Output = Result<(HelperRequest, LocalCopies), HelperError>>,
    ) -> Result<Bytes, HelperError> {
        if let Some(kept) = self.find(tag) {
            return Ok(kept);
        }
        let turn = turn(&self.turns, submitter).await?;
        // Another request may have drawn the picture in the meantime.
        if let Some(kept) = self.find(tag) {
            return Ok(kept);
        }
        let made = tokio::time::timeout(TIME_LIMIT, request).await;
        let (request, copies) = made.map_err(|_| HelperError::TimedOut).flatten()?;
        let picture = Bytes::from(self.run(&request).await?);
        drop((copies, turn));
        self.keep(tag, &picture);
        Ok(picture)
    }

    /// Response to a request that is made in the turn of its submitter, and never cached.
    pub(crate) async fn answer(
        &self,
        submitter: &str,
        request: impl Future<Output = Result<(HelperRequest, LocalCopies), HelperError>>,
    ) -> Result<Vec<u8>, HelperError> {
        let _turn = turn(&self.turns, submitter).await?;
        let made = tokio::time::timeout(TIME_LIMIT, request).await;
        let (request, _copies) = made.map_err(|_| HelperError::TimedOut).flatten()?;
        self.run(&request).await
    }

    /// JSON of a [`proto::preview_helper::ShaderView`], made in the turn of its submitter.
    pub(crate) async fn shader(&self, submitter: &str, request: &HelperRequest) -> Result<Bytes, HelperError> {
        let _turn = turn(&self.turns, submitter).await?;
        Ok(Bytes::from(self.run(request).await?))
    }

    /// Measures a sample of a job.
    pub(crate) async fn sample(&self, request: &HelperRequest) -> Result<CostSample, HelperError> {
        self.measure(request).await
    }

    /// Measures a job in the turn of estimates.
    pub(crate) async fn measure<T: DeserializeOwned>(&self, request: &HelperRequest) -> Result<T, HelperError> {
        let _turn = turn(&self.turns, ESTIMATES).await?;
        let answer = self.run(request).await?;
        serde_json::from_slice(&answer).map_err(|error| HelperError::Failed(error.to_string()))
    }

    /// Answers a client that edits a job, and the time of the helper. If the client is gone, which drops this future,
    /// the helper is killed: what a fast typist no longer waits for takes no turn of others.
    pub(crate) async fn live(
        &self,
        submitter: &str,
        request: &HelperRequest,
    ) -> Result<(Vec<u8>, Duration), HelperError> {
        let _turn = turn(&self.live_turns, submitter).await?;
        let start = monotonic_now();
        let answer = self.run(request).await?;
        Ok((answer, start.elapsed()))
    }

    /// Runs a helper; it is killed if the caller is dropped or the time is up.
    async fn run(&self, request: &HelperRequest) -> Result<Vec<u8>, HelperError> {
        let mut child = Command::new(&self.program)
            .arg(preview_helper::HELPER_COMMAND)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .process_group(0)
            .kill_on_drop(true)
            .spawn()
            .map_err(HelperError::Start)?;
        let mut line = serde_json::to_vec(request).map_err(|error| HelperError::Failed(error.to_string()))?;
        line.push(b'\n');
        match tokio::time::timeout(TIME_LIMIT, answer(&mut child, &line)).await {
            Ok(answer) => answer,
            Err(_) => Err(HelperError::TimedOut),
        }
    }

    fn find(&self, tag: &str) -> Option<Bytes> {
        let kept = self.kept.lock().expect("no holder panics");
        kept.iter().find(|(known, _)| known == tag).map(|(_, picture)| picture.clone())
    }

    fn keep(&self, tag: &str, picture: &Bytes) {
        let mut kept = self.kept.lock().expect("no holder panics");
        kept.push_front((tag.to_owned(), picture.clone()));
        let mut sum_bytes = 0;
        let mut count = 0;
        kept.retain(|(_, picture)| {
            sum_bytes += picture.len();
            count += 1;
            count == 1 || (count <= MAX_CACHED_PICTURES && sum_bytes <= MAX_CACHED_BYTES)
        });
    }

    /// Forgets what was drawn from a stored picture.
    pub(crate) fn forget(&self, hash: &str) {
        self.kept.lock().expect("no holder panics").retain(|(tag, _)| !tag.contains(hash));
    }

    /// Removes the oldest coarse passes beyond the maximum.
    pub(crate) fn prune_coarse(&self) -> io::Result<()> {
        let mut files = Vec::new();
        for entry in std::fs::read_dir(&self.folder)? {
            let entry = entry?;
            if entry.file_type()?.is_dir() {
                // Copies that a helper is reading.
                continue;
            }
            files.push((entry.metadata()?.modified().unwrap_or(SystemTime::UNIX_EPOCH), entry.path()));
        }
        files.sort();
        for (_, path) in files.iter().take(files.len().saturating_sub(MAX_COARSE_FILES)) {
            std::fs::remove_file(path)?;
        }
        Ok(())
    }
}

async fn turn(turns: &Arc<FairQueue>, submitter: &str) -> Result<QueueTurn, HelperError> {
    match tokio::time::timeout(MAX_WAIT, turns.enter(submitter)).await {
        Ok(Ok(place)) => Ok(place),
        Ok(Err(_)) | Err(_) => Err(HelperError::Busy),
    }
}

/// Sends a request to a helper and reads its response. Standard input stays open as long as the helper should
/// run.
async fn answer(child: &mut Child, line: &[u8]) -> Result<Vec<u8>, HelperError> {
    let lost = || HelperError::Start(io::Error::other("its pipes are missing"));
    let mut input = child.stdin.take().ok_or_else(lost)?;
    let output = child.stdout.take().ok_or_else(lost)?;
    let errors = child.stderr.take().ok_or_else(lost)?;
    let write = async {
        // A helper that rejects its input reports the reason itself.
        drop(input.write_all(line).await);
    };
    let read = async {
        let mut bytes = Vec::new();
        output.take(MAX_ANSWER_BYTES).read_to_end(&mut bytes).await.map(|_| bytes)
    };
    let listen = async {
        let mut words = Vec::new();
        errors.take(MAX_STDERR_BYTES).read_to_end(&mut words).await.map(|_| words)
    };
    let ((), bytes, words) = tokio::join!(write, read, listen);
    let failed = |error: io::Error| HelperError::Failed(error.to_string());
    let (bytes, words) = (bytes.map_err(failed)?, words.map_err(failed)?);
    let status = child.wait().await.map_err(failed)?;
    drop(input);
    if status.success() {
        return Ok(bytes);
    }
    let words = String::from_utf8_lossy(&words);
    let last = words.lines().last().unwrap_or("").trim();
    Err(HelperError::Failed(if last.is_empty() { status.to_string() } else { format!("{last} ({status})") }))
}
