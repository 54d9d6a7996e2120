//! The local pool: keeps the requested number of worker processes running as children of this server.
//!
//! When a child exits, its leases end at once and another child starts in its slot, on the same device. A
//! surplus child finishes its leases first. A slot whose device cannot render stays empty until the pool is
//! resized.

mod worker_process;

use std::collections::BTreeSet;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use tokio::sync::{mpsc, watch};
use tokio::task::{JoinHandle, JoinSet};
use tokio::time::Instant;

use crate::clock::instant;
use crate::config::Config;
use crate::queue::{Cause, Queue};
use worker_process::{Child, Exit, Launch};

/// A child that exits sooner than this has failed to start.
const EARLY: Duration = Duration::from_secs(1);
/// This many failed starts in a row are retried without delay.
const EARLY_DEATHS_FREE: u32 = 3;
/// The first wait after more of them; it doubles from there.
const BACK_OFF: Duration = Duration::from_millis(250);
/// The longest wait.
const MAX_BACK_OFF: Duration = Duration::from_secs(30);
/// Part of the grace period for releasing leases that would not finish in time.
const HAND_BACK: Duration = Duration::from_secs(2);
/// Time a child has after that before it is killed.
const LAST_WORDS: Duration = Duration::from_secs(1);

/// Handle of the pool.
#[derive(Debug)]
pub(crate) struct Pool {
    wanted: watch::Sender<u32>,
    processes: watch::Receiver<Vec<(u32, String)>>,
    token: String,
    supervisor: std::sync::Mutex<Option<Waiting>>,
}

/// Channels for the supervisor, kept until it starts.
#[derive(Debug)]
struct Waiting {
    wanted: watch::Receiver<u32>,
    processes: watch::Sender<Vec<(u32, String)>>,
}

/// The running supervisor.
#[derive(Debug)]
pub(crate) struct Supervision {
    end: mpsc::Sender<Duration>,
    task: JoinHandle<()>,
}

impl Pool {
    /// Pool of this many workers, none of them started yet.
    pub(crate) fn new(workers: u32) -> Self {
        let (wanted, wanted_seen) = watch::channel(workers);
        let (processes, processes_seen) = watch::channel(Vec::new());
        let token = format!("{}{}", uuid::Uuid::new_v4().simple(), uuid::Uuid::new_v4().simple());
        let waiting = Waiting { wanted: wanted_seen, processes };
        Self { wanted, processes: processes_seen, token, supervisor: std::sync::Mutex::new(Some(waiting)) }
    }

    /// Starts the supervisor, once.
    pub(crate) fn start(&self, config: &Config, address: SocketAddr, queue: Queue) -> Supervision {
        let waiting = self.supervisor.lock().expect("no holder panics").take().expect("a pool is started once");
        let (end, ending) = mpsc::channel(1);
        let launch = Launch {
            program: config.worker_program.clone(),
            server: format!("http://{}", reachable(address)),
            devices: config.devices.clone(),
            simd: config.simd.clone(),
            threads: config.threads,
            token: self.token.clone(),
            variables: config.worker_variables.clone(),
        };
        let supervisor = Supervisor {
            launch,
            queue,
            wanted: waiting.wanted,
            processes: waiting.processes,
            children: Vec::new(),
            retired: BTreeSet::new(),
            exits: JoinSet::new(),
            labels: 0,
            early_deaths: 0,
            hold_until: None,
        };
        Supervision { end, task: tokio::spawn(supervisor.run(ending)) }
    }

    /// Requests this many workers.
    pub(crate) fn resize(&self, workers: u32) {
        self.wanted.send_replace(workers);
    }

    /// Workers asked for.
    pub(crate) fn wanted(&self) -> u32 {
        *self.wanted.borrow()
    }

    /// The secret that children prove themselves with.
    pub(crate) fn token(&self) -> &str {
        &self.token
    }

    /// The label of a child of this server, by its process id.
    pub(crate) fn label(&self, process: u32) -> Option<String> {
        self.processes.borrow().iter().find(|(id, _)| *id == process).map(|(_, label)| label.clone())
    }
}

impl Supervision {
    /// Ends the pool: its workers may continue their leases for `grace`.
    pub(crate) async fn end(self, grace: Duration) {
        if self.end.send(grace).await.is_err() {
            tracing::error!("the pool's supervisor ended early");
        }
        if let Err(error) = self.task.await {
            tracing::error!(%error, "the pool's supervisor panicked");
        }
    }
}

/// Address at which a child reaches a server that may listen on all interfaces.
fn reachable(address: SocketAddr) -> SocketAddr {
    let mut address = address;
    if address.ip().is_unspecified() {
        let loopback =
            if address.is_ipv4() { std::net::Ipv4Addr::LOCALHOST.into() } else { std::net::Ipv6Addr::LOCALHOST.into() };
        address.set_ip(loopback);
    }
    address
}

struct Supervisor {
    launch: Launch,
    queue: Queue,
    wanted: watch::Receiver<u32>,
    processes: watch::Sender<Vec<(u32, String)>>,
    children: Vec<Child>,
    retired: BTreeSet<usize>,
    exits: JoinSet<Exit>,
    labels: u32,
    early_deaths: u32,
    hold_until: Option<Instant>,
}

impl Supervisor {
    async fn run(mut self, mut ending: mpsc::Receiver<Duration>) {
        let grace = loop {
            let wanted = *self.wanted.borrow();
            self.adjust(wanted as usize).await;
            let held = self.hold_until;
            tokio::select! {
                grace = ending.recv() => break grace.unwrap_or_default(),
                changed = self.wanted.changed() => {
                    if changed.is_err() {
                        break Duration::ZERO;
                    }
                    self.hold_until = None;
                    self.retired.clear();
                }
                Some(exit) = self.exits.join_next() => self.reaped(exit).await,
                () = sleep_until(held), if held.is_some() => self.hold_until = None,
            }
        };
        self.end(grace).await;
    }

    /// Drains who is too much, those in the last places, and starts who is missing.
    async fn adjust(&mut self, wanted: usize) {
        for index in 0..self.children.len() {
            if self.children[index].place() >= wanted && !self.children[index].is_draining() {
                self.drain(index).await;
            }
        }
        for place in 0..wanted {
            if self.hold_until.is_some() {
                return;
            }
            let held = self.children.iter().any(|child| child.place() == place && !child.is_draining());
            if !held && !self.retired.contains(&place) {
                self.launch(place, wanted);
            }
        }
    }

    fn launch(&mut self, place: usize, wanted: usize) {
        self.labels += 1;
        let label = format!("pool-{}", self.labels);
        match Child::launch(&self.launch, label.clone(), place, wanted, &mut self.exits) {
            Ok(child) => {
                tracing::info!(worker = %label, process = child.process(), device = child.device(), "started a worker");
                self.children.push(child);
                self.announce();
            }
            Err(error) => {
                let program: PathBuf = self.launch.program.clone();
                tracing::error!(
                    program = %program.display(), %error,
                    "the worker program can't be started: check that it is there and may be run"
                );
                self.early_deaths = self.early_deaths.max(EARLY_DEATHS_FREE);
                self.hold();
            }
        }
    }

    fn announce(&self) {
        let processes = self.children.iter().map(|child| (child.process(), child.label().to_owned())).collect();
        self.processes.send_replace(processes);
    }

    async fn drain(&mut self, index: usize) {
        let process = self.children[index].process();
        let known = match self.queue.drain(process).await {
            Ok(known) => known,
            Err(error) => {
                tracing::error!(%error, process, "a worker could not be told to drain");
                false
            }
        };
        self.children[index].drain();
        if !known {
            self.children[index].close_input();
        }
    }

    async fn reaped(&mut self, exit: Result<Exit, tokio::task::JoinError>) {
        let exit = match exit {
            Ok(exit) => exit,
            Err(error) => {
                tracing::error!(%error, "the wait for a worker panicked");
                return;
            }
        };
        let Some(index) = self.children.iter().position(|child| child.process() == exit.process) else { return };
        let child = self.children.remove(index);
        self.announce();
        let cause = exit.cause(child.is_draining());
        let message = exit.message();
        let unfit = exit.is_unfit() && !child.is_draining();
        if unfit {
            tracing::error!(
                worker = child.label(), device = child.device(), %message,
                "a worker's device can't render: its place in the pool stays empty until the pool is sized anew (sdfarm pool N)"
            );
        } else if cause == Cause::Interrupted {
            tracing::info!(worker = child.label(), process = exit.process, "a worker ended");
        } else {
            tracing::warn!(worker = child.label(), process = exit.process, %message, "a worker died");
        }
        if let Err(error) = self.queue.reaped(exit.process, cause, message).await {
            tracing::error!(%error, process = exit.process, "a dead worker's leases could not be ended; they will run out");
        }
        if unfit {
            self.retired.insert(child.place());
        } else if !child.is_draining() {
            self.early_deaths = if child.age() < EARLY { self.early_deaths + 1 } else { 0 };
            self.hold();
        }
    }

    /// After too many early deaths in a row the next start waits.
    fn hold(&mut self) {
        let Some(steps) = self.early_deaths.checked_sub(EARLY_DEATHS_FREE) else { return };
        let wait = (BACK_OFF * (1 << steps.min(10))).min(MAX_BACK_OFF);
        tracing::error!(
            ?wait,
            "pool workers exit right after starting: fix the cause in their messages above; next start is delayed"
        );
        self.hold_until = Some(instant() + wait);
    }

    /// Drains all workers; those that do not exit in time must release their leases, and are then killed.
    async fn end(mut self, grace: Duration) {
        let start = instant();
        for index in 0..self.children.len() {
            if !self.children[index].is_draining() {
                self.drain(index).await;
            }
        }
        self.reap_until(start + grace.saturating_sub(HAND_BACK)).await;
        for child in &self.children {
            tracing::info!(worker = child.label(), "a worker is told to hand back what it holds");
            child.terminate();
        }
        self.reap_until(start + grace).await;
        for child in &mut self.children {
            child.close_input();
        }
        self.reap_until(start + grace + LAST_WORDS).await;
        for child in &self.children {
            tracing::warn!(worker = child.label(), "a worker does not end; it is killed");
            child.kill();
        }
        while let Some(exit) = self.exits.join_next().await {
            self.reaped(exit).await;
        }
    }

    async fn reap_until(&mut self, deadline: Instant) {
        while !self.children.is_empty() {
            match tokio::time::timeout_at(deadline, self.exits.join_next()).await {
                Ok(Some(exit)) => self.reaped(exit).await,
                Ok(None) | Err(_) => return,
            }
        }
    }
}

async fn sleep_until(deadline: Option<Instant>) {
    if let Some(deadline) = deadline {
        tokio::time::sleep_until(deadline).await;
    }
}
