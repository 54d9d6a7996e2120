//! Runs the soak: restarts the server after each kill, and checks the farm in between.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use anyhow::Context;
use proto::job::JobState;
use proto::{Client, ClientError, JobId};
use server::{DoneTile, IntegrityReport, check_integrity};

use super::processes;
use super::report::SoakReport;
use super::rng::SeededRng;
use super::server::{Launch, POLL_INTERVAL, ServerLog, ServerProcess};
use super::workload::ReferenceJob;
use crate::program::Program;

/// Time limit for a server to become ready.
const READY_LIMIT: Duration = Duration::from_secs(2);
/// Additional time if its connections to a database server are cut.
const CONNECTING_LIMIT: Duration = Duration::from_secs(5);
/// Attempts at the integrity check if its connection is cut.
pub(super) const CHECK_ATTEMPTS: usize = 10;
/// Target number of unfinished jobs in the queue.
const TARGET_QUEUE: usize = 4;
/// Maximum pause before a kill.
const KILL_INTERVAL: Duration = Duration::from_millis(400);
/// Time limit for a fail point to trigger.
const FAIL_POINT_TIMEOUT: Duration = Duration::from_secs(2);
/// Time limit for the remaining jobs at the end.
const LAST_JOBS_TIMEOUT: Duration = Duration::from_mins(5);
/// Workers killed per server process if no number was given.
const WORKERS_A_SERVER: u64 = 3;
/// Workers killed per server process after the last server kill.
const WORKERS_LAST: u64 = 20;
/// Fail points that kill the server, in addition to random instants.
pub(super) const SERVER_POINTS: [&str; 9] = [
    "migrating",
    "migrated",
    "submit_committed",
    "claimed",
    "group_committed",
    "blob_stored",
    "picture_stored",
    "sweeping",
    "database_commit",
];
/// Fail points that kill workers.
const WORKER_POINTS: [&str; 3] = ["blob_put", "picture_put", "stitching"];

/// Settings of a soak.
#[derive(Clone, Debug)]
pub(super) struct SoakPlan {
    /// Address of the database, unless it is a file.
    pub(super) database: Option<String>,
    /// Number of servers on that database.
    pub(super) servers: u32,
    /// Store of several servers.
    pub(super) store: Option<String>,
    /// Whether to kill processes.
    pub(super) kill: bool,
    /// Number of workers to kill.
    pub(super) worker_kills: u32,
    /// Number of times to kill the server.
    pub(super) server_kills: u32,
    /// Time after which to stop.
    pub(super) time: Option<Duration>,
    /// Number of workers of the pool.
    pub(super) workers: u32,
    /// Seed of all random choices.
    pub(super) seed: u64,
}

/// State of a running soak.
struct Soak<'a> {
    program: &'a Program,
    plan: &'a SoakPlan,
    reference_jobs: &'a [ReferenceJob],
    data: &'a Path,
    random: SeededRng,
    log: Arc<ServerLog>,
    start: Instant,
    accepted: BTreeSet<JobId>,
    /// Accepted jobs that are not checked yet, with their task.
    waiting: BTreeMap<JobId, usize>,
    checks: Checks,
    summary: SoakReport,
    next_task: usize,
}

/// Integrity checks, each compared with the last one.
#[derive(Debug, Default)]
pub(super) struct Checks {
    done: BTreeMap<i64, DoneTile>,
}

impl Checks {
    /// Counts a check, and its violations.
    pub(super) fn take(&mut self, found: IntegrityReport, accepted: &BTreeSet<JobId>, summary: &mut SoakReport) {
        summary.integrity_checks += 1;
        for violation in found.violations {
            summary.violation(violation);
        }
        let lost = accepted.difference(&found.jobs).count();
        if lost > 0 {
            summary.violation(format!("{lost} jobs that were accepted with 201 are lost"));
        }
        for (tile, was) in &self.done {
            match found.done.get(tile) {
                None => summary.violation(format!("tile {tile} was done, and no longer is")),
                Some(is) if is != was => summary.violation(format!("tile {tile} was done, and was leased again")),
                Some(_) => {}
            }
        }
        summary.tiles = found.done.len();
        self.done = found.done;
    }
}

/// Submits jobs and kills processes until the plan is fulfilled, then waits for all jobs.
pub(super) async fn soak(
    program: &Program,
    plan: &SoakPlan,
    tasks: &[ReferenceJob],
    data: &Path,
) -> anyhow::Result<SoakReport> {
    let mut soak = Soak {
        program,
        plan,
        reference_jobs: tasks,
        data,
        random: SeededRng::new(plan.seed),
        log: Arc::default(),
        start: Instant::now(),
        accepted: BTreeSet::new(),
        waiting: BTreeMap::new(),
        checks: Checks::default(),
        summary: SoakReport::default(),
        next_task: 0,
    };
    let mut reported = 0;
    while !soak.is_fulfilled() && soak.summary.violations.is_empty() {
        soak.run_server_once().await?;
        soak.count_fail_points();
        let kills = soak.summary.all_server_kills();
        if kills >= reported + 10 {
            reported = kills;
            eprintln!("{} workers and {kills} servers killed", soak.summary.all_worker_kills());
        }
    }
    soak.finish().await?;
    soak.summary.took = soak.start.elapsed();
    Ok(soak.summary)
}

/// Returns whether a job is finished; if so, any picture that differs from the expected one is a violation.
pub(super) async fn check_pictures(
    client: &Client,
    id: JobId,
    expected: &ReferenceJob,
    summary: &mut SoakReport,
) -> Result<bool, ClientError> {
    let job = client.job(id).await?;
    match job.state {
        JobState::Queued | JobState::Running => return Ok(false),
        JobState::Failed | JobState::Cancelled => {
            summary.violation(format!("job {id} is {}: {}", job.state.name(), job.errors.join("; ")));
            return Ok(true);
        }
        JobState::Succeeded => {}
    }
    for (frame, wanted) in expected.pictures.iter().enumerate() {
        let mut picture = Vec::new();
        client.image(id, frame as u32, &mut picture).await?;
        summary.pictures += 1;
        if blake3::hash(&picture) != *wanted {
            summary.violation(format!("frame {frame} of job {id} differs from an undisturbed render"));
        }
    }
    summary.succeeded += 1;
    Ok(true)
}

/// Counts panics and differences in the logs of processes as violations.
pub(super) fn count_log(log: &ServerLog, summary: &mut SoakReport) {
    for (count, what) in [
        (log.panics.load(Ordering::Relaxed), "panics"),
        (log.differences.load(Ordering::Relaxed), "tiles or pictures that differed when rendered again"),
    ] {
        if count > 0 {
            summary.violation(format!("{count} {what}"));
        }
    }
}

/// Whether a server refused a request because it could not reach its database.
fn is_cut_off(error: &ClientError) -> bool {
    matches!(error, ClientError::Problem(problem) if problem.code == "database_unreachable")
}

impl Soak<'_> {
    fn is_fulfilled(&self) -> bool {
        let is_over = self.plan.time.is_some_and(|time| self.start.elapsed() >= time);
        is_over || (self.workers_left() == 0 && self.servers_left() == 0)
    }

    fn workers_left(&self) -> u64 {
        u64::from(self.plan.worker_kills).saturating_sub(self.summary.all_worker_kills())
    }

    fn servers_left(&self) -> u64 {
        u64::from(self.plan.server_kills).saturating_sub(self.summary.all_server_kills())
    }

    /// Runs one server from its start to its end.
    async fn run_server_once(&mut self) -> anyhow::Result<()> {
        let (points, kills_server) = self.choose_points();
        let Some(mut server) = self.start(&points).await? else { return Ok(()) };
        let last = Instant::now() + FAIL_POINT_TIMEOUT;
        for _ in 0..self.kills_per_server() {
            self.submit(&mut server).await?;
            tokio::time::sleep(self.random.pause(KILL_INTERVAL)).await;
            if server.has_ended()? {
                break;
            }
            if let Some(victim) = self.random.pick(server.workers()) {
                processes::kill(victim);
                self.summary.worker_kills += 1;
            }
        }
        self.submit(&mut server).await?;
        if !self.plan.kill {
            tokio::time::sleep(FAIL_POINT_TIMEOUT).await;
            return self.end(server).await;
        }
        tokio::time::sleep(self.random.pause(KILL_INTERVAL)).await;
        while kills_server && Instant::now() < last && !server.has_ended()? {
            tokio::time::sleep(POLL_INTERVAL).await;
        }
        if self.servers_left() == 0 {
            return self.end(server).await;
        }
        if !server.has_ended()? {
            self.summary.server_kills += 1;
        }
        let orphans = server.kill().await?;
        if orphans > 0 {
            self.summary.violation(format!("{orphans} workers outlived their server"));
        }
        Ok(())
    }

    fn kills_per_server(&self) -> u64 {
        match (self.plan.kill, self.servers_left()) {
            (false, _) => 0,
            (true, 0) => self.workers_left().min(WORKERS_LAST),
            (true, servers) if self.plan.time.is_none() => self.workers_left().div_ceil(servers),
            (true, _) => WORKERS_A_SERVER,
        }
    }

    /// Fail points to arm in the next server, and whether they kill the server.
    fn choose_points(&mut self) -> (String, bool) {
        let (points, most, is_server) = match self.random.below(4) {
            0 => (&SERVER_POINTS[..], 8, true),
            1 => (&WORKER_POINTS[..], 4, false),
            _ => return (String::new(), false),
        };
        if !self.plan.kill || (is_server && self.servers_left() == 0) || (!is_server && self.workers_left() == 0) {
            return (String::new(), false);
        }
        // A worker passes the point at least once, because otherwise it would never finish any work.
        let pass = if is_server { 1 } else { 2 } + self.random.below(most);
        (self.random.pick(points).map_or_else(String::new, |point| format!("{point}=kill@{pass}")), is_server)
    }

    /// Starts a server and checks the state left by the last one; `None` if a fail point killed it at its start.
    async fn start(&mut self, fail_points: &str) -> anyhow::Result<Option<ServerProcess>> {
        let launch = Launch {
            program: self.program,
            data: self.data,
            listen: 0,
            database: self.plan.database.as_deref(),
            workers: self.plan.workers,
            flags: &[],
            fail_points,
        };
        let Some(server) = ServerProcess::start(&launch, &self.log).await? else { return Ok(None) };
        self.summary.slowest_ready = self.summary.slowest_ready.max(server.ready);
        self.summary.ready = (self.summary.ready.0 + server.ready, self.summary.ready.1 + 1);
        let limit = READY_LIMIT + if self.plan.database.is_some() { CONNECTING_LIMIT } else { Duration::ZERO };
        if server.ready > limit {
            self.summary.violation(format!("a server needed {:?} to become ready", server.ready));
        }
        self.audit().await?;
        Ok(Some(server))
    }

    async fn audit(&mut self) -> anyhow::Result<()> {
        let mut found = check_integrity(self.data).await;
        for _ in 1..CHECK_ATTEMPTS {
            if found.is_ok() || self.plan.database.is_none() {
                break;
            }
            found = check_integrity(self.data).await;
        }
        self.checks.take(found?, &self.accepted, &mut self.summary);
        Ok(())
    }

    /// Checks the finished jobs, and refills the queue. A server that is killed meanwhile is no
    /// violation.
    async fn submit(&mut self, server: &mut ServerProcess) -> anyhow::Result<()> {
        server.refresh_workers();
        for (id, task) in self.waiting.clone() {
            match check_pictures(&server.client, id, &self.reference_jobs[task], &mut self.summary).await {
                Ok(true) => drop(self.waiting.remove(&id)),
                Ok(false) => {}
                Err(error) if is_cut_off(&error) => return Ok(()),
                Err(ClientError::Problem(problem)) => self.summary.violation(format!("job {id}: {}", problem.detail)),
                Err(_) => return Ok(()),
            }
        }
        while self.waiting.len() < TARGET_QUEUE {
            let task = self.next_task % self.reference_jobs.len();
            self.next_task += 1;
            match server.client.submit(self.reference_jobs[task].text.clone(), true).await {
                Ok(job) => {
                    self.summary.accepted += 1;
                    self.accepted.insert(job.id);
                    self.waiting.insert(job.id, task);
                }
                Err(error) if is_cut_off(&error) => {
                    self.summary.unanswered += 1;
                    return Ok(());
                }
                Err(ClientError::Problem(problem)) => {
                    self.summary.violation(format!("a valid job was rejected: {}", problem.detail));
                    return Ok(());
                }
                Err(_) => {
                    self.summary.unanswered += 1;
                    return Ok(());
                }
            }
        }
        Ok(())
    }

    async fn end(&mut self, server: ServerProcess) -> anyhow::Result<()> {
        if !server.terminate().await? {
            self.summary.violation("a server did not shut down gracefully after SIGTERM".to_owned());
        }
        Ok(())
    }

    fn count_fail_points(&mut self) {
        self.summary.workers_hit = self.log.workers_hit.load(Ordering::Relaxed);
        self.summary.servers_hit = self.log.servers_hit.load(Ordering::Relaxed);
    }

    /// Finishes all accepted jobs, on an undisturbed server.
    async fn finish(&mut self) -> anyhow::Result<()> {
        let mut server = self.start("").await?.context("a server exited right after its start")?;
        let start = Instant::now();
        while !self.waiting.is_empty() && start.elapsed() < LAST_JOBS_TIMEOUT {
            for (id, task) in self.waiting.clone() {
                match check_pictures(&server.client, id, &self.reference_jobs[task], &mut self.summary).await {
                    Ok(true) => drop(self.waiting.remove(&id)),
                    Ok(false) => {}
                    Err(error) if is_cut_off(&error) => {}
                    Err(error) => return Err(error.into()),
                }
            }
            anyhow::ensure!(!server.has_ended()?, "the last server exited unexpectedly");
            tokio::time::sleep(POLL_INTERVAL).await;
        }
        if !self.waiting.is_empty() {
            self.summary.violation(format!("{} jobs did not finish within {LAST_JOBS_TIMEOUT:?}", self.waiting.len()));
        }
        self.audit().await?;
        self.end(server).await?;
        count_log(&self.log, &mut self.summary);
        self.count_fail_points();
        Ok(())
    }
}
