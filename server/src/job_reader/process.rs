//! The process that reads job files for a server: it gets a question and a text on standard input, answers on standard
//! output, and ends when its input does.
//!
//! A submitter's text can at worst end this process.

use std::io::{self, BufReader, BufWriter, Read, Write};

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};

use super::answer::{LastJob, Question};

/// Stack size of the thread that reads, which nests as deep as a file.
pub(super) const STACK_BYTES: usize = 16 << 20;
/// A process that has more memory after an answer ends, also if that is the job that it keeps.
const MAX_IDLE_BYTES: u64 = 128 << 20;
/// Seconds of its time after which a process ends by itself, beyond the limit at which the server ends it.
const GRACE_SECONDS: u64 = 2;

/// A question, and what its answer may take.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Request {
    pub(super) question: Question,
    /// Memory, in bytes.
    pub(super) memory_bytes: u64,
    /// Time of one core, in seconds.
    pub(super) seconds: u64,
}

/// Answers questions until standard input ends.
///
/// # Errors
/// Fails if standard input or output does.
pub fn run() -> io::Result<()> {
    let thread = std::thread::Builder::new().name("reader".to_owned()).stack_size(STACK_BYTES);
    thread.spawn(answer_all)?.join().map_err(|_| io::Error::other("reading panicked"))?
}

fn answer_all() -> io::Result<()> {
    let (mut input, mut output) = (BufReader::new(io::stdin()), BufWriter::new(io::stdout()));
    let mut last = LastJob::default();
    while let Some(request) = read_part(&mut input)? {
        let request: Request = serde_json::from_slice(&request)?;
        let text = read_part(&mut input)?.ok_or(io::ErrorKind::UnexpectedEof)?;
        limit(&request)?;
        let answer = last.answer(&request.question, &text);
        drop(text);
        write_part(&mut output, &serde_json::to_vec(&answer)?)?;
        output.flush()?;
        if resident_bytes() > MAX_IDLE_BYTES {
            break;
        }
    }
    Ok(())
}

/// Reads the length of a part, and the part; `None` at the end of the input.
fn read_part(input: &mut impl Read) -> io::Result<Option<Vec<u8>>> {
    let mut length = [0; 4];
    match input.read_exact(&mut length) {
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(None),
        read => read?,
    }
    let mut part = vec![0; u32::from_le_bytes(length) as usize];
    input.read_exact(&mut part)?;
    Ok(Some(part))
}

fn write_part(output: &mut impl Write, part: &[u8]) -> io::Result<()> {
    output.write_all(&length(part)?)?;
    output.write_all(part)
}

/// Length of a part, as it stands before it.
pub(super) fn length(part: &[u8]) -> io::Result<[u8; 4]> {
    u32::try_from(part.len()).map(u32::to_le_bytes).map_err(io::Error::other)
}

/// Limits the memory of this process, and its time from now on.
fn limit(request: &Request) -> io::Result<()> {
    let used_seconds = clock_gettime(ClockId::ProcessCPUTime).tv_sec.unsigned_abs();
    let limits =
        [(Resource::Data, request.memory_bytes), (Resource::Cpu, used_seconds + request.seconds + GRACE_SECONDS)];
    for (resource, most) in limits {
        let maximum = getrlimit(resource).maximum;
        let current = Some(maximum.map_or(most, |maximum| maximum.min(most)));
        setrlimit(resource, Rlimit { current, maximum })?;
    }
    Ok(())
}

/// Memory of this process, in bytes; 0 if the system does not report it.
fn resident_bytes() -> u64 {
    let sizes = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let pages = sizes.split_whitespace().nth(1).and_then(|pages| pages.parse::<u64>().ok());
    pages.unwrap_or(0) * rustix::param::page_size() as u64
}
