//! `sdfarm preview-helper`: the server's helper process. It reads a request in one line, writes the response to
//! standard output, and exits when standard input closes.

use std::io::{BufRead, BufReader, Read};

use anyhow::Context;
use proto::preview_helper::HelperRequest;
use rustix::process::{Resource, Rlimit, nice, setrlimit};

use crate::preview_helper;
use crate::terminal::write_bytes;

/// Maximum bytes of the request line; a job file in it is written as a JSON string.
const MAX_LINE_BYTES: u64 = 64 << 20;
/// Stack size of the working thread, because it parses deeply nested job files.
const STACK_BYTES: usize = 32 << 20;
/// Limit of the address space for drawing.
const MAX_HELPER_BYTES: u64 = 4 << 30;
/// A sample yields to everything except the pool's own workers.
const SAMPLE_NICENESS: i32 = 10;
/// A picture for a client that waits for it yields to everything except the pool's workers and samples.
const LIVE_NICENESS: i32 = 5;
/// A drawing yields to everything, also to the pool's workers: at the lowest priority, it takes a few percent of a
/// busy machine.
const DRAWING_NICENESS: i32 = 19;
/// A program is made in milliseconds, while a scene is dragged.
const PROGRAM_NICENESS: i32 = 0;

/// Handles the request.
pub(crate) fn run() -> anyhow::Result<()> {
    let mut input = BufReader::new(std::io::stdin());
    let mut line = Vec::new();
    input.by_ref().take(MAX_LINE_BYTES).read_until(b'\n', &mut line).context("could not read the request")?;
    let sketch: HelperRequest = serde_json::from_slice(&line).context("could not parse the request")?;
    set_limits(&sketch)?;
    std::thread::spawn(move || {
        // A killed server leaves no helper behind: its end of the pipe closes.
        drop(std::io::copy(&mut input, &mut std::io::sink()));
        std::process::exit(1);
    });
    let work = std::thread::Builder::new().name("preview-helper".to_owned()).stack_size(STACK_BYTES);
    let answer = work.spawn(move || preview_helper::handle(&sketch)).context("could not start a thread")?;
    write_bytes(&answer.join().map_err(|_| anyhow::anyhow!("drawing panicked"))??)
}

/// Lowers this helper's priority, and limits its memory.
fn set_limits(sketch: &HelperRequest) -> anyhow::Result<()> {
    let (niceness, most_bytes) = match sketch {
        HelperRequest::Preview { .. } | HelperRequest::Thumbnail { .. } => (DRAWING_NICENESS, Some(MAX_HELPER_BYTES)),
        HelperRequest::Draw { .. }
        | HelperRequest::Pick { .. }
        | HelperRequest::ReadLayers { .. }
        | HelperRequest::DrawLayer { .. }
        | HelperRequest::ReadPixel { .. } => (LIVE_NICENESS, Some(MAX_HELPER_BYTES)),
        HelperRequest::Shader { .. } => (PROGRAM_NICENESS, Some(MAX_HELPER_BYTES)),
        HelperRequest::MeasureCost { .. } | HelperRequest::Price { .. } | HelperRequest::Verify { .. } => {
            (SAMPLE_NICENESS, None)
        }
    };
    nice(niceness).context("could not lower this process's priority")?;
    match most_bytes {
        Some(bytes) => {
            let limit = Rlimit { current: Some(bytes), maximum: Some(bytes) };
            setrlimit(Resource::As, limit).context("could not limit memory")
        }
        None => Ok(()),
    }
}
