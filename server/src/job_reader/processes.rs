//! The processes that read job files, each for one file at a time: started on demand, kept while idle, and ended when a
//! file takes more than it may.

use std::io;
use std::os::unix::process::ExitStatusExt;
use std::path::PathBuf;
use std::process::{ExitStatus, Stdio};
use std::sync::Mutex;
use std::time::Duration;

use bytes::Bytes;
use tokio::io::{AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::process::{Child, ChildStdin, ChildStdout, Command};
use tokio::sync::oneshot;

use super::answer::{Answer, LastJob, Question};
use super::process::{Request, STACK_BYTES, length};

/// First argument that selects the process in the worker program.
pub const READER_COMMAND: &str = "job-reader";
/// Interval between two looks at the time that a process has used.
const LOOK_INTERVAL: Duration = Duration::from_millis(50);
/// New processes that are started for one question, if all are killed.
const MAX_ATTEMPTS: u32 = 5;
/// Clock ticks per second of `/proc`, the same on all of Linux.
const TICKS_PER_SECOND: u64 = 100;

/// Limits of the answer to a question.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Limits {
    /// Memory, in bytes.
    pub(super) memory_bytes: u64,
    /// Time of one core.
    pub(super) time: Duration,
}

/// Why there is no answer.
#[derive(Debug)]
pub(super) enum NoAnswer {
    /// It took more than it may.
    TooCostly(Cost),
    /// The process was ending, or was killed.
    Ended,
    /// The process could not be started, or its pipes failed.
    Broken(io::Error),
}

/// Resource that a question took too much of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cost {
    Time,
    Memory,
    /// The process ended otherwise.
    Unknown,
}

/// Processes, or threads of this one if there is no program to start.
#[derive(Debug)]
pub(super) struct Processes {
    program: Option<PathBuf>,
    idle: Mutex<Vec<Process>>,
    max_idle: usize,
}

#[derive(Debug)]
struct Process {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
    /// Number of the job that it read last, of a claim.
    job: Option<i64>,
}

impl Processes {
    /// Up to `max_idle` processes are kept while they have nothing to read.
    pub(super) fn new(program: Option<PathBuf>, max_idle: usize) -> Self {
        Self { program, idle: Mutex::default(), max_idle }
    }

    /// Asks about a file; `job` is its number if it is one of the queue. If the caller is dropped, the process ends.
    pub(super) async fn ask(
        &self,
        question: Question,
        text: Bytes,
        job: Option<i64>,
        limits: Limits,
    ) -> Result<Answer, NoAnswer> {
        let Some(program) = &self.program else { return on_thread(question, text).await };
        let request = Request { question, memory_bytes: limits.memory_bytes, seconds: limits.time.as_secs() };
        let request = serde_json::to_vec(&request).map_err(|error| NoAnswer::Broken(error.into()))?;
        let mut attempts = 0;
        loop {
            let idle = self.take(job);
            attempts += u32::from(idle.is_none());
            let mut process = idle.map_or_else(|| Process::start(program), Ok).map_err(NoAnswer::Broken)?;
            match process.answer(&request, &text, limits.time).await {
                Ok(answer) => {
                    self.keep(process, job);
                    return Ok(answer);
                }
                Err(NoAnswer::Ended) if attempts < MAX_ATTEMPTS => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// An idle process: the one that has read this job last, or any.
    fn take(&self, job: Option<i64>) -> Option<Process> {
        let mut idle = self.idle.lock().expect("no holder panics");
        let same = job.and_then(|job| idle.iter().position(|process| process.job == Some(job)));
        let free = || idle.iter().position(|process| process.job.is_none());
        let place = same.or_else(free).or_else(|| idle.len().checked_sub(1))?;
        Some(idle.remove(place))
    }

    /// Keeps a process; the one that has been idle longest ends.
    fn keep(&self, mut process: Process, job: Option<i64>) {
        process.job = job;
        let mut idle = self.idle.lock().expect("no holder panics");
        idle.push(process);
        if idle.len() > self.max_idle {
            drop(idle.remove(0));
        }
    }
}

impl Process {
    fn start(program: &PathBuf) -> io::Result<Self> {
        let mut child = Command::new(program)
            .arg(READER_COMMAND)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .process_group(0)
            .kill_on_drop(true)
            .spawn()?;
        let lost = || io::Error::other("its pipes are missing");
        let (input, output) = (child.stdin.take().ok_or_else(lost)?, child.stdout.take().ok_or_else(lost)?);
        Ok(Self { child, input, output: BufReader::new(output), job: None })
    }

    async fn answer(&mut self, request: &[u8], text: &[u8], limit: Duration) -> Result<Answer, NoAnswer> {
        let mut start = None;
        let exchanged = {
            let exchange = exchange(&mut self.input, &mut self.output, request, text);
            tokio::pin!(exchange);
            loop {
                if let Ok(exchanged) = tokio::time::timeout(LOOK_INTERVAL, &mut exchange).await {
                    break exchanged;
                }
                // Until the first look, it may have used a core all the time.
                let used = time_of(self.child.id());
                let start = *start.get_or_insert(used.saturating_sub(LOOK_INTERVAL));
                if used.saturating_sub(start) > limit {
                    return Err(NoAnswer::TooCostly(Cost::Time));
                }
            }
        };
        if let Ok(answer) = exchanged {
            return Ok(answer);
        }
        // It has closed its pipes.
        self.child.start_kill().map_err(NoAnswer::Broken)?;
        let status = self.child.wait().await.map_err(NoAnswer::Broken)?;
        Err(no_answer(status))
    }
}

async fn exchange(
    input: &mut ChildStdin,
    output: &mut BufReader<ChildStdout>,
    request: &[u8],
    text: &[u8],
) -> io::Result<Answer> {
    let mut head = Vec::with_capacity(request.len() + 8);
    head.extend(length(request)?);
    head.extend(request);
    head.extend(length(text)?);
    input.write_all(&head).await?;
    input.write_all(text).await?;
    input.flush().await?;
    let answer_bytes = output.read_u32_le().await?;
    let mut answer = vec![0; answer_bytes as usize];
    output.read_exact(&mut answer).await?;
    Ok(serde_json::from_slice(&answer)?)
}

/// Why a process has ended without an answer.
fn no_answer(status: ExitStatus) -> NoAnswer {
    const ABORTED: i32 = 6;
    const KILLED: i32 = 9;
    const CPU_LIMIT: i32 = 24;
    NoAnswer::TooCostly(match status.signal() {
        Some(KILLED) => return NoAnswer::Ended,
        None if status.success() => return NoAnswer::Ended,
        Some(ABORTED) => Cost::Memory,
        Some(CPU_LIMIT) => Cost::Time,
        Some(_) | None => Cost::Unknown,
    })
}

/// Time that a process has used on all cores; zero if it has ended.
fn time_of(process: Option<u32>) -> Duration {
    let state = process.and_then(|id| std::fs::read_to_string(format!("/proc/{id}/stat")).ok()).unwrap_or_default();
    // The name, in parentheses, may have spaces. After it come the fields from the third on.
    let fields = state.rsplit_once(") ").map_or("", |(_, fields)| fields);
    let ticks: u64 = fields.split(' ').skip(11).take(2).filter_map(|ticks| ticks.parse::<u64>().ok()).sum();
    Duration::from_millis(ticks * 1000 / TICKS_PER_SECOND)
}

/// Answers on a thread of this process, without limits.
async fn on_thread(question: Question, text: Bytes) -> Result<Answer, NoAnswer> {
    let (reply, answer) = oneshot::channel();
    let thread = std::thread::Builder::new().name("reader".to_owned()).stack_size(STACK_BYTES);
    let work = move || drop(reply.send(LastJob::default().answer(&question, &text)));
    thread.spawn(work).map_err(NoAnswer::Broken)?;
    answer.await.map_err(|_| NoAnswer::TooCostly(Cost::Unknown))
}
