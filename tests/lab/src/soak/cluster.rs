//! Soaks a farm of several servers on one database and one store: kills servers and workers at random, starts others in
//! their places, and follows the events of every job from server to server.

use std::collections::{BTreeMap, BTreeSet};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use anyhow::Context;
use proto::{Client, ClientError, JobId};
use server::check_integrity;
use tokio::task::JoinSet;

use super::kills::{self, Checks, SoakPlan};
use super::report::SoakReport;
use super::rng::SeededRng;
use super::server::{KillOnDrop, Launch, POLL_INTERVAL, ServerLog, ServerProcess, listen_to};
use super::workload::ReferenceJob;
use crate::program::Program;

/// Target number of unfinished jobs in the queue.
const TARGET_QUEUE: usize = 6;
/// Maximum pause before a kill.
const KILL_INTERVAL: Duration = Duration::from_millis(400);
/// Kills between two integrity checks.
const KILLS_A_CHECK: u64 = 10;
/// Time limit for the remaining jobs at the end.
const LAST_JOBS_TIMEOUT: Duration = Duration::from_mins(5);
/// Delay before a follower asks the next server.
const FOLLOW_AGAIN: Duration = Duration::from_millis(50);
/// Secret of these servers, which listen on loopback only.
const SECRET: &str = "the secret of the servers of a soak";

/// Events that a follower received, by their ids.
type Followed = (JobId, Vec<String>);

/// State of a running soak.
struct ClusterSoak<'a> {
    program: &'a Program,
    plan: &'a SoakPlan,
    reference_jobs: &'a [ReferenceJob],
    folder: &'a Path,
    random: SeededRng,
    log: Arc<ServerLog>,
    ports: Vec<u16>,
    clients: Arc<[Client]>,
    servers: Vec<Option<ServerProcess>>,
    workers: Vec<KillOnDrop>,
    accepted: BTreeSet<JobId>,
    waiting: BTreeMap<JobId, usize>,
    followers: JoinSet<anyhow::Result<Followed>>,
    checks: Checks,
    summary: SoakReport,
    next_task: usize,
}

/// Submits jobs and kills processes until the plan is fulfilled, then waits for all jobs.
pub(super) async fn soak(
    program: &Program,
    plan: &SoakPlan,
    tasks: &[ReferenceJob],
    folder: &Path,
) -> anyhow::Result<SoakReport> {
    let start = Instant::now();
    let ports = free_ports(plan.servers as usize)?;
    let clients: Result<Vec<Client>, _> = ports.iter().map(|port| Client::new(&address(*port))).collect();
    let mut soak = ClusterSoak {
        program,
        plan,
        reference_jobs: tasks,
        folder,
        random: SeededRng::new(plan.seed),
        log: Arc::default(),
        clients: clients?.into(),
        servers: ports.iter().map(|_| None).collect(),
        ports,
        workers: Vec::new(),
        accepted: BTreeSet::new(),
        waiting: BTreeMap::new(),
        followers: JoinSet::new(),
        checks: Checks::default(),
        summary: SoakReport::default(),
        next_task: 0,
    };
    soak.start_missing(false).await?;
    for _ in 0..plan.workers {
        let worker = soak.spawn_worker()?;
        soak.workers.push(worker);
    }
    let mut checked = 0;
    while !soak.is_fulfilled(start) && soak.summary.violations.is_empty() {
        soak.start_missing(true).await?;
        soak.submit().await;
        tokio::time::sleep(soak.random.pause(KILL_INTERVAL)).await;
        soak.kill_one().await?;
        let kills = soak.summary.all_server_kills() + soak.summary.all_worker_kills();
        if kills >= checked + KILLS_A_CHECK {
            checked = kills;
            soak.check_database().await?;
            eprintln!(
                "{} workers and {} servers killed, {} jobs succeeded",
                soak.summary.all_worker_kills(),
                soak.summary.all_server_kills(),
                soak.summary.succeeded
            );
        }
    }
    soak.finish().await?;
    soak.summary.took = start.elapsed();
    Ok(soak.summary)
}

/// Ports that are free now.
fn free_ports(count: usize) -> anyhow::Result<Vec<u16>> {
    // All are bound at the same time, so that they differ.
    let listeners: std::io::Result<Vec<_>> = (0..count).map(|_| TcpListener::bind(("127.0.0.1", 0))).collect();
    let ports = listeners.and_then(|bound| bound.iter().map(|listener| Ok(listener.local_addr()?.port())).collect());
    ports.context("could not find free ports")
}

fn address(port: u16) -> String {
    format!("http://127.0.0.1:{port}")
}

impl ClusterSoak<'_> {
    fn is_fulfilled(&self, start: Instant) -> bool {
        match self.plan.time {
            Some(time) => start.elapsed() >= time,
            None => self.workers_left() == 0 && self.servers_left() == 0,
        }
    }

    fn workers_left(&self) -> u64 {
        u64::from(self.plan.worker_kills).saturating_sub(self.summary.all_worker_kills())
    }

    fn servers_left(&self) -> u64 {
        u64::from(self.plan.server_kills).saturating_sub(self.summary.all_server_kills())
    }

    fn data(&self, slot: usize) -> PathBuf {
        self.folder.join(format!("server-{slot}"))
    }

    /// Starts a server in each empty place; `disturbed` ones have fail points, and tell the others only half of what
    /// they should.
    async fn start_missing(&mut self, disturbed: bool) -> anyhow::Result<()> {
        for slot in 0..self.servers.len() {
            let is_running = match &mut self.servers[slot] {
                Some(server) => !server.has_ended()?,
                None => false,
            };
            if is_running {
                continue;
            }
            self.servers[slot] = None;
            let data = self.data(slot);
            std::fs::create_dir_all(&data).with_context(|| format!("could not create {}", data.display()))?;
            let mut fail_points = Vec::new();
            if disturbed {
                fail_points.push("telling=error/2".to_owned());
                if self.servers_left() > 0 && self.random.below(3) == 0 {
                    let point = self.random.pick(&kills::SERVER_POINTS).unwrap_or_default();
                    fail_points.push(format!("{point}=kill@{}", 1 + self.random.below(40)));
                }
            }
            let store = self.plan.store.clone().context("several servers need a store: pass --store")?;
            let launch = Launch {
                program: self.program,
                data: &data,
                listen: self.ports[slot],
                database: self.plan.database.as_deref(),
                workers: 1,
                flags: &["--store", &store, "--cluster-secret", SECRET, "--lease-seconds", "10"],
                fail_points: &fail_points.join(","),
            };
            if let Some(server) = ServerProcess::start(&launch, &self.log).await? {
                self.summary.slowest_ready = self.summary.slowest_ready.max(server.ready);
                self.summary.ready = (self.summary.ready.0 + server.ready, self.summary.ready.1 + 1);
                self.servers[slot] = Some(server);
            }
        }
        self.count_fail_points();
        Ok(())
    }

    fn spawn_worker(&self) -> anyhow::Result<KillOnDrop> {
        let addresses: Vec<String> = self.ports.iter().map(|port| address(*port)).collect();
        let mut command = self.program.command()?;
        command.args(["worker", "--device", "cpu", "--threads", "1", "--server", &addresses.join(",")]);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        let mut child: Child = command.spawn().context("could not start a worker")?;
        listen_to(&mut child, &self.folder.join("workers.log"), &self.log)?;
        Ok(KillOnDrop(child))
    }

    /// Kills a worker or a server, and starts another worker.
    async fn kill_one(&mut self) -> anyhow::Result<()> {
        let all = self.workers_left() + self.servers_left();
        if self.random.below(all) < self.servers_left() {
            let slot = self.random.below(self.servers.len() as u64) as usize;
            if let Some(mut server) = self.servers[slot].take() {
                self.summary.server_kills += u32::from(!server.has_ended()?);
                let orphans = server.kill().await?;
                if orphans > 0 {
                    self.summary.violation(format!("{orphans} workers outlived their server"));
                }
            }
        } else if !self.workers.is_empty() {
            let victim = self.random.below(self.workers.len() as u64) as usize;
            // Dropping kills it.
            self.workers[victim] = self.spawn_worker()?;
            self.summary.worker_kills += 1;
        }
        Ok(())
    }

    /// Client of a server that runs.
    fn client(&mut self) -> Client {
        let running: Vec<usize> = (0..self.servers.len()).filter(|slot| self.servers[*slot].is_some()).collect();
        let slot = self.random.pick(&running).unwrap_or_default();
        self.clients[slot].clone()
    }

    /// Checks finished jobs, and refills the queue. Servers that are killed or cut off meanwhile are no violation.
    async fn submit(&mut self) {
        for (id, task) in self.waiting.clone() {
            let client = self.client();
            match kills::check_pictures(&client, id, &self.reference_jobs[task], &mut self.summary).await {
                Ok(true) => drop(self.waiting.remove(&id)),
                Ok(false) => {}
                Err(error) => self.take_error(&format!("job {id}"), &error),
            }
        }
        while self.waiting.len() < TARGET_QUEUE {
            let task = self.next_task % self.reference_jobs.len();
            self.next_task += 1;
            let client = self.client();
            match client.submit(self.reference_jobs[task].text.clone(), true).await {
                Ok(job) => {
                    self.summary.accepted += 1;
                    self.accepted.insert(job.id);
                    self.waiting.insert(job.id, task);
                    self.followers.spawn(follow(Arc::clone(&self.clients), job.id, self.next_task));
                }
                Err(error) => {
                    self.summary.unanswered += 1;
                    self.take_error("a valid job", &error);
                    return;
                }
            }
        }
    }

    fn take_error(&mut self, subject: &str, error: &ClientError) {
        if let ClientError::Problem(problem) = error
            && problem.status < 500
        {
            self.summary.violation(format!("{subject}: {}", problem.detail));
        }
    }

    async fn check_database(&mut self) -> anyhow::Result<()> {
        let data = self.data(0);
        let mut found = check_integrity(&data).await;
        for _ in 1..kills::CHECK_ATTEMPTS {
            if found.is_ok() {
                break;
            }
            tokio::time::sleep(POLL_INTERVAL).await;
            found = check_integrity(&data).await;
        }
        self.checks.take(found?, &self.accepted, &mut self.summary);
        Ok(())
    }

    fn count_fail_points(&mut self) {
        self.summary.workers_hit = self.log.workers_hit.load(Ordering::Relaxed);
        self.summary.servers_hit = self.log.servers_hit.load(Ordering::Relaxed);
    }

    /// Finishes all accepted jobs with every server running, and checks what followers received.
    async fn finish(&mut self) -> anyhow::Result<()> {
        let start = Instant::now();
        while !self.waiting.is_empty() && start.elapsed() < LAST_JOBS_TIMEOUT {
            self.start_missing(false).await?;
            for (id, task) in self.waiting.clone() {
                let client = self.client();
                match kills::check_pictures(&client, id, &self.reference_jobs[task], &mut self.summary).await {
                    Ok(true) => drop(self.waiting.remove(&id)),
                    Ok(false) => {}
                    Err(error) => self.take_error(&format!("job {id}"), &error),
                }
            }
            tokio::time::sleep(POLL_INTERVAL * 10).await;
        }
        if !self.waiting.is_empty() {
            self.summary.violation(format!("{} jobs did not finish within {LAST_JOBS_TIMEOUT:?}", self.waiting.len()));
        }
        self.start_missing(false).await?;
        self.check_followers().await?;
        self.check_database().await?;
        self.workers.clear();
        for server in self.servers.drain(..).flatten() {
            if !server.terminate().await? {
                self.summary.violation("a server did not shut down gracefully after SIGTERM".to_owned());
            }
        }
        kills::count_log(&self.log, &mut self.summary);
        self.count_fail_points();
        Ok(())
    }

    /// Compares the events that each follower received with those that a server lists afterwards.
    async fn check_followers(&mut self) -> anyhow::Result<()> {
        while let Some(followed) = tokio::time::timeout(LAST_JOBS_TIMEOUT, self.followers.join_next()).await? {
            let (id, received) = followed.context("a follower panicked")??;
            let clients: Arc<[Client]> = Arc::clone(&self.clients);
            let (_, listed) = follow(clients, id, 0).await?;
            self.summary.followed += received.len();
            if received != listed {
                self.summary.violation(format!(
                    "a follower of job {id} received {} events, and there are {}",
                    received.len(),
                    listed.len()
                ));
            }
        }
        Ok(())
    }
}

/// Follows a job to its end, from the next server whenever one cannot be reached.
async fn follow(clients: Arc<[Client]>, id: JobId, first: usize) -> anyhow::Result<Followed> {
    let mut received: Vec<String> = Vec::new();
    for turn in first.. {
        let client = &clients[turn % clients.len()];
        let after = received.last().cloned();
        match client.events(id, after.as_deref()).await {
            Ok(None) => break,
            Ok(Some(mut stream)) => {
                while let Ok(Some(_)) = stream.next().await {
                    received.push(stream.last_id().context("an event has no id")?.to_owned());
                }
            }
            Err(ClientError::Problem(problem)) if problem.status < 500 => anyhow::bail!("{}", problem.detail),
            Err(_) => {}
        }
        tokio::time::sleep(FOLLOW_AGAIN).await;
    }
    Ok((id, received))
}
