//! Starts, commands and reaps one worker process.

use std::io::{self, Write};
use std::os::unix::process::ExitStatusExt;
use std::path::PathBuf;
use std::process::{ExitStatus, Stdio};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use proto::worker_protocol::{EXIT_UNUSABLE_DEVICE, TOKEN_ENV_VAR};
use rustix::process::{Pid, Signal, kill_process};
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::process::{ChildStderr, ChildStdin, Command};
use tokio::task::JoinSet;
use tokio::time::Instant;

use super::KILL_DELAY;
use crate::clock::monotonic_now;
use crate::queue::LeaseEnd;

/// Exit status of a Rust program that panicked.
const PANIC_EXIT_CODE: i32 = 101;
/// Maximum length of the stored last log line of a worker.
const MAX_LAST_LINE_CHARS: usize = 300;

/// Settings for starting workers.
#[derive(Debug)]
pub(super) struct WorkerLaunch {
    pub(super) program: PathBuf,
    pub(super) server: String,
    pub(super) devices: Vec<String>,
    pub(super) simd: String,
    pub(super) threads: Option<usize>,
    pub(super) token: String,
    pub(super) variables: Vec<(String, String)>,
}

impl WorkerLaunch {
    /// Device of the worker in a slot of the pool: each slot always has the same device.
    fn device(&self, place: usize) -> &str {
        self.devices.get(place % self.devices.len().max(1)).map_or("auto", String::as_str)
    }
}

/// A running worker process.
#[derive(Debug)]
pub(super) struct WorkerProcess {
    pid: u32,
    label: String,
    slot: usize,
    device: String,
    // Open while the worker should run: it exits when this closes, so that a killed server leaves no orphan.
    input: Option<ChildStdin>,
    started: Instant,
    draining: bool,
    /// Time at which a surplus worker is made to exit, and then killed.
    deadline: Option<Instant>,
}

/// How a worker process exited.
#[derive(Debug)]
pub(super) struct Exit {
    pub(super) pid: u32,
    status: io::Result<ExitStatus>,
    last_line: String,
}

impl WorkerProcess {
    /// Starts a worker in a slot of the pool; its exit is sent to `exits`.
    pub(super) fn launch(
        launch: &WorkerLaunch,
        label: String,
        place: usize,
        workers: usize,
        exits: &mut JoinSet<Exit>,
    ) -> io::Result<Self> {
        let shared = launch.threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));
        let threads = (shared / workers.max(1)).max(1);
        let device = launch.device(place).to_owned();
        let mut child = Command::new(&launch.program)
            .args(proto::fail_point::is_armed().then_some(proto::fail_point::FLAG))
            .args(["worker", "--server", &launch.server, "--pool", "--name", &label])
            .args(["--device", &device, "--simd", &launch.simd, "--threads", &threads.to_string()])
            .env(TOKEN_ENV_VAR, &launch.token)
            .envs(launch.variables.iter().map(|(name, value)| (name, value)))
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .process_group(0)
            .kill_on_drop(true)
            .spawn()?;
        let process = child.id().ok_or_else(|| io::Error::other("it exited at once"))?;
        let input = child.stdin.take();
        let errors = child.stderr.take();
        let name = label.clone();
        exits.spawn(async move {
            let last_line = Arc::new(Mutex::new(String::new()));
            let log = errors.map(|errors| tokio::spawn(forward_stderr(errors, name, Arc::clone(&last_line))));
            let status = child.wait().await;
            if let Some(log) = log {
                // A grandchild may keep the pipe open; the worker's own lines have been read by then.
                drop(tokio::time::timeout(Duration::from_millis(100), log).await);
            }
            let last_line = last_line.lock().expect("no holder panics").clone();
            Exit { pid: process, status, last_line }
        });
        let started = monotonic_now();
        Ok(Self { pid: process, label, slot: place, device, input, started, draining: false, deadline: None })
    }

    pub(super) fn pid(&self) -> u32 {
        self.pid
    }

    pub(super) fn label(&self) -> &str {
        &self.label
    }

    /// Slot in the pool, from 0.
    pub(super) fn slot(&self) -> usize {
        self.slot
    }

    /// Device it renders on.
    pub(super) fn device(&self) -> &str {
        &self.device
    }

    pub(super) fn is_draining(&self) -> bool {
        self.draining
    }

    /// Makes it drain, within `grace`; its exit is then expected.
    pub(super) fn drain(&mut self, grace: Duration) {
        self.draining = true;
        self.deadline = Some(monotonic_now() + grace);
    }

    /// Time at which [`WorkerProcess::end_overdue`] is due.
    pub(super) fn deadline(&self) -> Option<Instant> {
        self.deadline
    }

    /// Makes it exit, and kills it if it was made to exit before.
    pub(super) fn end_overdue(&mut self) {
        if self.input.is_some() {
            tracing::info!(worker = self.label, "a surplus worker has not finished its leases in time; ending it");
            self.close_input();
        } else {
            tracing::warn!(worker = self.label, "killing a worker that did not exit");
            self.kill();
            self.deadline = None;
        }
    }

    pub(super) fn age(&self) -> Duration {
        self.started.elapsed()
    }

    /// Closes its standard input, which makes it exit at once.
    pub(super) fn close_input(&mut self) {
        self.input = None;
        self.deadline = Some(monotonic_now() + KILL_DELAY);
    }

    /// Makes it release its leases and exit.
    pub(super) fn terminate(&self) {
        self.signal(Signal::TERM);
    }

    pub(super) fn kill(&self) {
        self.signal(Signal::KILL);
    }

    fn signal(&self, signal: Signal) {
        let Some(process) = i32::try_from(self.pid).ok().and_then(Pid::from_raw) else { return };
        if let Err(error) = kill_process(process, signal) {
            tracing::debug!(process = self.pid, %error, "the worker has exited already; no signal needed");
        }
    }
}

async fn forward_stderr(errors: ChildStderr, worker: String, last_line: Arc<Mutex<String>>) {
    let mut lines = BufReader::new(errors).lines();
    while let Ok(Some(line)) = lines.next_line().await {
        let message = pass_on_line(&worker, line);
        *last_line.lock().expect("no holder panics") = message.chars().take(MAX_LAST_LINE_CHARS).collect();
    }
}

/// Forwards a log line of a worker, and returns its message.
fn pass_on_line(worker: &str, line: String) -> String {
    let Ok(serde_json::Value::Object(mut fields)) = serde_json::from_str(&line) else {
        tracing::info!(%worker, "{line}");
        return line;
    };
    // Workers log as JSON: their fields become fields of the forwarded line.
    fields.insert("label".to_owned(), worker.into());
    let message = fields.get("message").and_then(|message| message.as_str()).unwrap_or("").to_owned();
    // If standard error is closed, the line is dropped.
    let _ = writeln!(io::stderr().lock(), "{}", serde_json::Value::Object(fields));
    message
}

impl Exit {
    /// Cause to which the exit is attributed.
    pub(super) fn cause(&self, draining: bool) -> LeaseEnd {
        let Ok(status) = &self.status else { return LeaseEnd::Lost };
        let crashed = [Signal::SEGV, Signal::ABORT, Signal::BUS].map(Signal::as_raw);
        if status.code() == Some(PANIC_EXIT_CODE) || status.signal().is_some_and(|signal| crashed.contains(&signal)) {
            LeaseEnd::Crashed
        } else if status.success() || draining {
            LeaseEnd::Released
        } else {
            LeaseEnd::Lost
        }
    }

    /// Whether its device cannot render, so that a restart would not help.
    pub(super) fn is_device_unusable(&self) -> bool {
        self.status.as_ref().is_ok_and(|status| status.code() == Some(EXIT_UNUSABLE_DEVICE.into()))
    }

    /// Description of the exit.
    pub(super) fn message(&self) -> String {
        let how = match &self.status {
            Ok(status) => status.to_string(),
            Err(error) => format!("unknown exit: {error}"),
        };
        if self.last_line.is_empty() {
            format!("the worker process ended ({how})")
        } else {
            format!("the worker process ended ({how}); it last said: {}", self.last_line)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cause(raw_status: i32) -> LeaseEnd {
        let status = Ok(ExitStatus::from_raw(raw_status));
        Exit { pid: 1, status, last_line: String::new() }.cause(false)
    }

    #[test]
    fn a_crash_is_distinguished_from_a_kill_and_an_exit() {
        assert_eq!(cause(11), LeaseEnd::Crashed, "SIGSEGV");
        assert_eq!(cause(6), LeaseEnd::Crashed, "SIGABRT");
        assert_eq!(cause(7), LeaseEnd::Crashed, "SIGBUS");
        assert_eq!(cause(101 << 8), LeaseEnd::Crashed, "a panic");
        assert_eq!(cause(9), LeaseEnd::Lost, "SIGKILL");
        assert_eq!(cause(1 << 8), LeaseEnd::Lost, "exit 1");
        assert_eq!(cause(0), LeaseEnd::Released, "exit 0");
    }
}
