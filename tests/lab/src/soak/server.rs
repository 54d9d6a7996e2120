//! Starts, observes, and kills the server under test, which is a separate process.

use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStderr, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, mpsc};
use std::time::{Duration, Instant};

use anyhow::Context;
use proto::{Client, fail_point};

use super::{probe, processes};
use crate::program::Program;

/// Time limit for a server to become ready.
const START_TIMEOUT: Duration = Duration::from_secs(30);
/// Poll interval.
pub(super) const POLL_INTERVAL: Duration = Duration::from_millis(2);
/// Time limit for children of a killed server to exit.
const ORPHAN_TIMEOUT: Duration = Duration::from_secs(5);

/// Standard error of the soak's servers.
#[derive(Debug, Default)]
pub(super) struct ServerLog {
    /// Panics.
    pub(super) panics: AtomicU64,
    /// Tiles or pictures that differed when rendered again.
    pub(super) differences: AtomicU64,
    /// Workers that a fail point killed.
    pub(super) workers_hit: AtomicU64,
    /// Servers that a fail point killed.
    pub(super) servers_hit: AtomicU64,
}

/// A running server.
#[derive(Debug)]
pub(super) struct ServerProcess {
    child: KillOnDrop,
    workers: Vec<u32>,
    /// `http://127.0.0.1:PORT`.
    pub(super) address: String,
    /// Client of the server.
    pub(super) client: Client,
    /// From its start to its first `ready`.
    pub(super) ready: Duration,
}

/// How to start a server.
#[derive(Debug)]
pub(super) struct Launch<'a> {
    /// The program.
    pub(super) program: &'a Program,
    /// Its data folder.
    pub(super) data: &'a Path,
    /// Port to listen on; 0 is any.
    pub(super) listen: u16,
    /// Address of its database, unless it is a file.
    pub(super) database: Option<&'a str>,
    /// Workers of its pool.
    pub(super) workers: u32,
    /// Additional flags.
    pub(super) flags: &'a [&'a str],
    /// Armed fail points of the server or its workers; "" for none.
    pub(super) fail_points: &'a str,
}

impl ServerProcess {
    /// Starts a server and waits until it is ready; `None` if a fail point killed it first.
    pub(super) async fn start(launch: &Launch<'_>, said: &Arc<ServerLog>) -> anyhow::Result<Option<Self>> {
        let start = Instant::now();
        let mut child = KillOnDrop(spawn(launch)?);
        listen_to(&mut child.0, &launch.data.join("soak.log"), said)?;
        let Some(address) = address(&mut child.0)? else {
            child.0.wait().context("could not wait for the server")?;
            return Ok(None);
        };
        let client = Client::new(&address)?;
        let mut server = Self { child, workers: Vec::new(), address, client, ready: Duration::ZERO };
        while probe::status(&server.address, "/readyz").await != Some(200) {
            if server.has_ended()? {
                return Ok(None);
            }
            anyhow::ensure!(
                start.elapsed() < START_TIMEOUT,
                "the server was not ready after {} s",
                START_TIMEOUT.as_secs()
            );
            tokio::time::sleep(POLL_INTERVAL).await;
        }
        server.ready = start.elapsed();
        Ok(Some(server))
    }

    /// Process id of the server.
    pub(super) fn process(&self) -> u32 {
        self.child.0.id()
    }

    /// Process ids of its workers, as of the last refresh.
    pub(super) fn workers(&self) -> &[u32] {
        &self.workers
    }

    /// Refreshes its workers: a dead server has none, even if one is still running.
    pub(super) fn refresh_workers(&mut self) {
        let workers = processes::children(self.process());
        if !workers.is_empty() {
            self.workers = workers;
        }
    }

    /// Whether the server has exited.
    pub(super) fn has_ended(&mut self) -> anyhow::Result<bool> {
        Ok(self.child.0.try_wait().context("could not check the server's state")?.is_some())
    }

    /// Kills the server if it still runs; returns how many of its workers outlived it for too long.
    pub(super) async fn kill(mut self) -> anyhow::Result<usize> {
        self.refresh_workers();
        // The process id of an exited child may belong to another process by now.
        if !self.has_ended()? {
            processes::kill(self.process());
        }
        self.child.0.wait().context("could not wait for the server")?;
        Ok(orphans(&self.workers).await)
    }

    /// Sends SIGTERM to the server; returns whether it shut down gracefully.
    pub(super) async fn terminate(mut self) -> anyhow::Result<bool> {
        let process = i32::try_from(self.process()).ok().and_then(rustix::process::Pid::from_raw);
        let process = process.context("the server has no process id")?;
        rustix::process::kill_process(process, rustix::process::Signal::TERM).context("could not send SIGTERM")?;
        let start = Instant::now();
        while start.elapsed() < START_TIMEOUT {
            if let Some(status) = self.child.0.try_wait().context("could not check the server's state")? {
                return Ok(status.success());
            }
            tokio::time::sleep(POLL_INTERVAL).await;
        }
        Ok(false)
    }
}

/// Child process that is killed on drop.
#[derive(Debug)]
pub(super) struct KillOnDrop(pub(super) Child);

impl Drop for KillOnDrop {
    fn drop(&mut self) {
        // Both fail only if it has exited already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn spawn(launch: &Launch<'_>) -> anyhow::Result<Child> {
    let mut command = launch.program.command()?;
    command.args(["serve", "--listen", &format!("127.0.0.1:{}", launch.listen)]);
    command.args(["--device", "cpu", "--tile", "64", "--data"]).arg(launch.data);
    command.args(["--workers", &launch.workers.to_string()]).args(launch.flags);
    command.envs(launch.database.map(|address| ("SDFARM_DATABASE", address)));
    if !launch.fail_points.is_empty() {
        command.arg(fail_point::FLAG).env(fail_point::ENV_VAR, launch.fail_points);
    }
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command.spawn().context("could not start a server")
}

/// Address that the server prints; `None` if it exits before.
fn address(child: &mut Child) -> anyhow::Result<Option<String>> {
    let mut output = BufReader::new(child.stdout.take().context("the server has no standard output")?);
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || {
        let mut line = String::new();
        // The end of the output is an empty line, which contains no address.
        let _ = output.read_line(&mut line);
        let _ = sender.send(line);
        let _ = std::io::copy(&mut output, &mut std::io::sink());
    });
    let line = receiver.recv_timeout(START_TIMEOUT).context("the server printed no address")?;
    Ok(line.split_whitespace().find(|word| word.starts_with("http://")).map(str::to_owned))
}

/// Appends the standard error of a process to a log, and counts what it says.
pub(super) fn listen_to(child: &mut Child, log: &Path, said: &Arc<ServerLog>) -> anyhow::Result<()> {
    let errors = child.stderr.take().context("the process has no standard error")?;
    let log =
        File::options().create(true).append(true).open(log).context("could not open the log in the data folder")?;
    let said = Arc::clone(said);
    std::thread::spawn(move || listen(errors, log, &said));
    Ok(())
}

fn listen(errors: ChildStderr, mut log: File, said: &ServerLog) {
    for line in BufReader::new(errors).lines().map_while(Result::ok) {
        // Counting continues if the log cannot be written.
        let _ = writeln!(log, "{line}");
        let count = |counter: &AtomicU64| counter.fetch_add(1, Ordering::Relaxed);
        if line.contains("panicked at") {
            count(&said.panics);
        }
        if line.contains("nondeterministic_") {
            count(&said.differences);
        }
        if line.contains(fail_point::LOG_PREFIX) && line.contains(": kill") && !line.contains("it last said") {
            count(if line.starts_with(fail_point::LOG_PREFIX) { &said.servers_hit } else { &said.workers_hit });
        }
    }
}

/// Number of these processes that survive the time limit.
async fn orphans(workers: &[u32]) -> usize {
    let start = Instant::now();
    loop {
        let alive = workers.iter().filter(|&&worker| processes::is_alive(worker)).count();
        if alive == 0 || start.elapsed() > ORPHAN_TIMEOUT {
            return alive;
        }
        tokio::time::sleep(POLL_INTERVAL).await;
    }
}
