//! The local pool: runs the requested number of worker processes as children of this server.
//!
//! When a worker process exits, its leases end at once and another one starts in its slot, on the same device.
//! A surplus worker finishes its leases first, if that takes no longer than the grace period. A slot whose device cannot render stays empty until the pool is
//! resized.

mod worker_process;

use std::collections::BTreeSet;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use tokio::sync::{mpsc, watch};
use tokio::task::{JoinHandle, JoinSet};
use tokio::time::Instant;

use crate::clock::monotonic_now;
use crate::config::Config;
use crate::queue::{LeaseEnd, Queue};
use worker_process::{Exit, WorkerLaunch, WorkerProcess};

/// A worker process that exits sooner than this has failed to start.
const EARLY_EXIT: Duration = Duration::from_secs(1);
/// This many failed starts in a row are retried without delay.
const EARLY_EXITS_BEFORE_BACK_OFF: u32 = 3;
/// First delay after more failed starts; it doubles from there.
const BACK_OFF: Duration = Duration::from_millis(250);
/// Maximum delay.
const MAX_BACK_OFF: Duration = Duration::from_secs(30);
/// Part of the grace period that is left for releasing unfinished leases.
const RELEASE_TIMEOUT: Duration = Duration::from_secs(2);
/// Time after that before a worker process is killed.
const KILL_DELAY: Duration = Duration::from_secs(1);

/// Handle of the pool.
#[derive(Debug)]
pub(crate) struct Pool {
    target_size: watch::Sender<u32>,
    labels_by_pid: watch::Receiver<Vec<(u32, String)>>,
    token: String,
    supervisor: std::sync::Mutex<Option<SupervisorChannels>>,
}

/// Channels of the supervisor, stored until it starts.
#[derive(Debug)]
struct SupervisorChannels {
    target_size: watch::Receiver<u32>,
    labels_by_pid: watch::Sender<Vec<(u32, String)>>,
}

/// Supervisor task.
#[derive(Debug)]
pub(crate) struct SupervisorHandle {
    end: mpsc::Sender<Duration>,
    task: JoinHandle<()>,
}

impl Pool {
    /// Pool of this many workers; none is started yet.
    pub(crate) fn new(workers: u32) -> Self {
        let (wanted, wanted_seen) = watch::channel(workers);
        let (processes, processes_seen) = watch::channel(Vec::new());
        let token = format!("{}{}", uuid::Uuid::new_v4().simple(), uuid::Uuid::new_v4().simple());
        let waiting = SupervisorChannels { target_size: wanted_seen, labels_by_pid: processes };
        Self {
            target_size: wanted,
            labels_by_pid: processes_seen,
            token,
            supervisor: std::sync::Mutex::new(Some(waiting)),
        }
    }

    /// Starts the supervisor, once.
    pub(crate) fn start(&self, config: &Config, address: SocketAddr, queue: Queue) -> SupervisorHandle {
        let waiting = self.supervisor.lock().expect("no holder panics").take().expect("a pool is started once");
        let (end, ending) = mpsc::channel(1);
        let launch = WorkerLaunch {
            program: config.worker_program.clone(),
            server: format!("http://{}", loopback_if_unspecified(address)),
            devices: config.devices.clone(),
            simd: config.simd.clone(),
            threads: config.threads,
            token: self.token.clone(),
            variables: config.worker_env.clone(),
        };
        let supervisor = Supervisor {
            launch,
            queue,
            target_size: waiting.target_size,
            labels_by_pid: waiting.labels_by_pid,
            children: Vec::new(),
            disabled_slots: BTreeSet::new(),
            exits: JoinSet::new(),
            grace: config.shutdown_grace,
            labels: 0,
            early_exits: 0,
            backed_off_until: None,
        };
        SupervisorHandle { end, task: tokio::spawn(supervisor.run(ending)) }
    }

    /// Sets the target number of workers.
    pub(crate) fn resize(&self, workers: u32) {
        self.target_size.send_replace(workers);
    }

    /// Target number of workers.
    pub(crate) fn target_size(&self) -> u32 {
        *self.target_size.borrow()
    }

    /// Token with which pool workers authenticate.
    pub(crate) fn token(&self) -> &str {
        &self.token
    }

    /// Label of this server's worker with the given process id.
    pub(crate) fn label(&self, process: u32) -> Option<String> {
        self.labels_by_pid.borrow().iter().find(|(id, _)| *id == process).map(|(_, label)| label.clone())
    }
}

impl SupervisorHandle {
    /// Shuts the pool down: its workers may continue their leases for `grace`.
    pub(crate) async fn end(self, grace: Duration) {
        if self.end.send(grace).await.is_err() {
            tracing::error!("the pool's supervisor ended early");
        }
        if let Err(error) = self.task.await {
            tracing::error!(%error, "the pool's supervisor panicked");
        }
    }
}

/// Address at which a pool worker reaches a server that may listen on all interfaces.
fn loopback_if_unspecified(address: SocketAddr) -> SocketAddr {
    let mut address = address;
    if address.ip().is_unspecified() {
        let loopback =
            if address.is_ipv4() { std::net::Ipv4Addr::LOCALHOST.into() } else { std::net::Ipv6Addr::LOCALHOST.into() };
        address.set_ip(loopback);
    }
    address
}

struct Supervisor {
    launch: WorkerLaunch,
    queue: Queue,
    target_size: watch::Receiver<u32>,
    labels_by_pid: watch::Sender<Vec<(u32, String)>>,
    children: Vec<WorkerProcess>,
    disabled_slots: BTreeSet<usize>,
    exits: JoinSet<Exit>,
    /// How long a surplus worker may continue its leases.
    grace: Duration,
    labels: u32,
    early_exits: u32,
    backed_off_until: Option<Instant>,
}

impl Supervisor {
    async fn run(mut self, mut ending: mpsc::Receiver<Duration>) {
        let grace = loop {
            let wanted = *self.target_size.borrow();
            self.reconcile(wanted as usize).await;
            let held = self.backed_off_until;
            let overdue = self.children.iter().filter_map(WorkerProcess::deadline).min();
            tokio::select! {
                grace = ending.recv() => break grace.unwrap_or_default(),
                changed = self.target_size.changed() => {
                    if changed.is_err() {
                        break Duration::ZERO;
                    }
                    self.backed_off_until = None;
                    self.disabled_slots.clear();
                }
                Some(exit) = self.exits.join_next() => self.on_exit(exit).await,
                () = sleep_until(held), if held.is_some() => self.backed_off_until = None,
                () = sleep_until(overdue), if overdue.is_some() => self.end_overdue(),
            }
        };
        self.end(grace).await;
    }

    /// Drains surplus workers, those in the last slots, and starts missing ones.
    async fn reconcile(&mut self, wanted: usize) {
        for index in 0..self.children.len() {
            if self.children[index].slot() >= wanted && !self.children[index].is_draining() {
                self.drain(index).await;
            }
        }
        for place in 0..wanted {
            if self.backed_off_until.is_some() {
                return;
            }
            let held = self.children.iter().any(|child| child.slot() == place && !child.is_draining());
            if !held && !self.disabled_slots.contains(&place) {
                self.launch(place, wanted);
            }
        }
    }

    fn launch(&mut self, place: usize, wanted: usize) {
        self.labels += 1;
        let label = format!("pool-{}", self.labels);
        match WorkerProcess::launch(&self.launch, label.clone(), place, wanted, &mut self.exits) {
            Ok(child) => {
                tracing::info!(worker = %label, process = child.pid(), device = child.device(), "worker started");
                self.children.push(child);
                self.publish_labels();
            }
            Err(error) => {
                let program: PathBuf = self.launch.program.clone();
                tracing::error!(
                    program = %program.display(), %error,
                    "cannot start the worker program: check that the file exists and is executable"
                );
                self.early_exits = self.early_exits.max(EARLY_EXITS_BEFORE_BACK_OFF);
                self.back_off();
            }
        }
    }

    fn publish_labels(&self) {
        let processes = self.children.iter().map(|child| (child.pid(), child.label().to_owned())).collect();
        self.labels_by_pid.send_replace(processes);
    }

    async fn drain(&mut self, index: usize) {
        let process = self.children[index].pid();
        let known = match self.queue.drain(process).await {
            Ok(known) => known,
            Err(error) => {
                tracing::error!(%error, process, "could not drain a worker");
                false
            }
        };
        self.children[index].drain(self.grace);
        if !known {
            self.children[index].close_input();
        }
    }

    /// Ends surplus workers that have not exited in time. Their leases end when they are reaped.
    fn end_overdue(&mut self) {
        let now = monotonic_now();
        for child in &mut self.children {
            if child.deadline().is_some_and(|deadline| deadline <= now) {
                child.end_overdue();
            }
        }
    }

    async fn on_exit(&mut self, exit: Result<Exit, tokio::task::JoinError>) {
        let exit = match exit {
            Ok(exit) => exit,
            Err(error) => {
                tracing::error!(%error, "waiting for a worker panicked");
                return;
            }
        };
        let Some(index) = self.children.iter().position(|child| child.pid() == exit.pid) else { return };
        let child = self.children.remove(index);
        self.publish_labels();
        let cause = exit.cause(child.is_draining());
        let message = exit.message();
        let unfit = exit.is_device_unusable() && !child.is_draining();
        if unfit {
            tracing::error!(
                worker = child.label(), device = child.device(), %message,
                "a worker's device cannot render: its slot stays empty until the pool is resized (sdfarm pool N)"
            );
        } else if cause == LeaseEnd::Released {
            tracing::info!(worker = child.label(), process = exit.pid, "worker exited");
        } else {
            tracing::warn!(worker = child.label(), process = exit.pid, %message, "worker failed");
        }
        if let Err(error) = self.queue.worker_exited(exit.pid, cause, message).await {
            tracing::error!(%error, process = exit.pid, "could not end an exited worker's leases; they will expire");
        }
        if unfit {
            self.disabled_slots.insert(child.slot());
        } else if !child.is_draining() {
            self.early_exits = if child.age() < EARLY_EXIT { self.early_exits + 1 } else { 0 };
            self.back_off();
        }
    }

    /// After several failed starts in a row, the next start is delayed.
    fn back_off(&mut self) {
        let Some(steps) = self.early_exits.checked_sub(EARLY_EXITS_BEFORE_BACK_OFF) else { return };
        let wait = (BACK_OFF * (1 << steps.min(10))).min(MAX_BACK_OFF);
        tracing::error!(
            ?wait,
            "pool workers exit right after starting: fix the cause in their messages above; next start is delayed"
        );
        self.backed_off_until = Some(monotonic_now() + wait);
    }

    /// Drains all workers; those that do not exit in time must release their leases, and are killed if they do
    /// not.
    async fn end(mut self, grace: Duration) {
        let start = monotonic_now();
        for index in 0..self.children.len() {
            if !self.children[index].is_draining() {
                self.drain(index).await;
            }
        }
        self.reap_until(start + grace.saturating_sub(RELEASE_TIMEOUT)).await;
        for child in &self.children {
            tracing::info!(worker = child.label(), "asking a worker to release its leases");
            child.terminate();
        }
        self.reap_until(start + grace).await;
        for child in &mut self.children {
            child.close_input();
        }
        self.reap_until(start + grace + KILL_DELAY).await;
        for child in &self.children {
            tracing::warn!(worker = child.label(), "killing a worker that did not exit");
            child.kill();
        }
        while let Some(exit) = self.exits.join_next().await {
            self.on_exit(exit).await;
        }
    }

    async fn reap_until(&mut self, deadline: Instant) {
        while !self.children.is_empty() {
            match tokio::time::timeout_at(deadline, self.exits.join_next()).await {
                Ok(Some(exit)) => self.on_exit(exit).await,
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
