//! Alerts, conditions that need an operator: derived from what the services know when it is asked for, and every half minute, so that the time
//! at which each alert began is known.
//!
//! Nothing in the farm depends on it. `sdfarm status` and the page show it.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use proto::WorkerId;
use proto::alert::{AlertSeverity, AlertView};
use proto::pool::{WorkerState, WorkerView};
use tokio_util::sync::CancellationToken;

use crate::blobs::BlobStore;
use crate::clock::rfc3339;
use crate::counters::ServerCounters;
use crate::db::DatabaseError;
use crate::host::{DISK_CURE, Room};
use crate::pool::Pool;
use crate::queue::Queue;
use crate::space_reserve::SpaceReserve;
use crate::telemetry::Telemetry;

/// Interval at which alerts are looked for.
const INTERVAL: Duration = Duration::from_secs(30);
/// Maximum number of workers that a message names.
const NAMED: usize = 5;

/// An alert without its beginning.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Found {
    code: &'static str,
    severity: AlertSeverity,
    message: String,
    cure: String,
}

impl Found {
    fn warning(code: &'static str, message: String, cure: &str) -> Self {
        Self { code, severity: AlertSeverity::Warning, message, cure: cure.to_owned() }
    }

    fn critical(code: &'static str, message: String, cure: &str) -> Self {
        Self { code, severity: AlertSeverity::Critical, message, cure: cure.to_owned() }
    }
}

/// Finds what needs an operator.
#[derive(Debug)]
pub(crate) struct Alerts {
    /// Has the jobs and workers.
    pub(crate) queue: Queue,
    /// Pictures and blobs.
    pub(crate) content: Arc<BlobStore>,
    /// Has the counts, and the disk.
    pub(crate) telemetry: Arc<Telemetry>,
    /// Local workers.
    pub(crate) pool: Arc<Pool>,
    /// Space set aside for a full disk.
    pub(crate) reserve: Arc<SpaceReserve>,
    /// Counters since the start.
    pub(crate) counters: Arc<ServerCounters>,
    /// Times at which the alerts of the last look were first found, by code.
    pub(crate) since: Mutex<BTreeMap<&'static str, i64>>,
}

impl Alerts {
    /// Looks for alerts until the farm shuts down.
    pub(crate) async fn run(&self, end: CancellationToken) {
        loop {
            tokio::select! {
                () = end.cancelled() => return,
                () = tokio::time::sleep(INTERVAL) => {}
            }
            self.current().await;
        }
    }

    /// Conditions that need an operator now, critical ones first.
    pub(crate) async fn current(&self) -> Vec<AlertView> {
        let mut found = self.of_store().await;
        match self.of_database().await {
            Ok(more) => found.extend(more),
            Err(error) => found.push(Found::critical(
                "database_unreachable",
                format!("the database cannot be used: {error}"),
                "start its server, or correct the network; if the database is damaged, run `sdfarm doctor`",
            )),
        }
        found.sort_by_key(|alert| alert.severity);
        let now_ms = self.queue.wall_ms();
        let mut since = self.since.lock().expect("no holder panics");
        since.retain(|code, _| found.iter().any(|alert| alert.code == *code));
        found
            .into_iter()
            .map(|Found { code, severity, message, cure }| {
                let since = rfc3339(*since.entry(code).or_insert(now_ms));
                AlertView { code: code.to_owned(), severity, message, cure, since }
            })
            .collect()
    }

    /// Alerts of the store and of this server's disk.
    async fn of_store(&self) -> Vec<Found> {
        let mut found = Vec::new();
        let disk = self.telemetry.disk();
        let left = format!(
            "{} MiB of {} MiB are free on the data folder's disk",
            disk.free_bytes >> 20,
            disk.total_bytes >> 20
        );
        if self.reserve.is_released() || disk.room() == Room::None {
            found.push(Found::critical("disk_full", left, DISK_CURE));
        } else if disk.room() == Room::Low {
            found.push(Found::warning("disk_low", left, DISK_CURE));
        }
        if let Err(error) = self.content.check_usable().await {
            let cure = "correct the store's permissions and network; work continues when it can be used again";
            found.push(Found::critical("store_unreachable", format!("the store cannot be used: {error}"), cure));
        }
        if self.counters.nondeterministic.load(Ordering::Relaxed) > 0 {
            let cure = "run `sdfarm selftest` on the machines that the log names at `nondeterministic_tile`";
            let message = "two workers have rendered the same tile differently since this server's start".to_owned();
            found.push(Found::warning("tiles_differ", message, cure));
        }
        found
    }

    /// Alerts that the database shows.
    async fn of_database(&self) -> Result<Vec<Found>, DatabaseError> {
        let mut found = Vec::new();
        if self.queue.is_paused().await? {
            let message = "the farm is paused".to_owned();
            found.push(Found::warning("farm_paused", message, "`sdfarm resume` continues it"));
        }
        let jobs: u64 = self.telemetry.demand().await?.loads.iter().map(|load| load.jobs).sum();
        let failing = self.queue.failing_workers().await?;
        found.extend(of_workers(&self.queue.workers().await?.workers, &failing, jobs, self.pool.target_size()));
        let webhooks = self.queue.failing_webhooks().await?;
        if let Some(target) = webhooks.target {
            let message = format!(
                "webhook messages cannot be delivered, such as to {target}: {} will be tried again, {} of the last day were given up",
                webhooks.waiting, webhooks.given_up
            );
            let cure = "correct the receiver, or the addresses with which jobs are submitted";
            found.push(Found::warning("webhooks_failing", message, cure));
        }
        Ok(found)
    }
}

/// Alerts of workers: those on which tiles of unfinished jobs fail, of this number of jobs that could be rendered, and of local
/// workers that there should be.
fn of_workers(workers: &[WorkerView], failing: &BTreeSet<WorkerId>, jobs: u64, pool_size: u32) -> Vec<Found> {
    let mut found = Vec::new();
    let is_able = |worker: &&WorkerView| matches!(worker.state, WorkerState::Ready | WorkerState::Starting);
    if jobs > 0 && !workers.iter().any(|worker| is_able(&worker)) {
        let message = format!("no worker takes work, and there {}", there_are(jobs, "unfinished job"));
        let cure = "start one: `sdfarm pool 1` on the server's machine, or `sdfarm worker --server ADDRESS` on another";
        found.push(Found::critical("no_worker", message, cure));
    }
    let local = workers.iter().filter(|worker| worker.pool).filter(is_able).count();
    if local < pool_size as usize {
        let message = format!("{local} of {pool_size} local workers run");
        found.push(Found::warning("pool_short", message, "look in the server's log for why they ended"));
    }
    let quarantined: Vec<_> = workers.iter().filter(|worker| worker.quarantined).collect();
    if !quarantined.is_empty() {
        let message = format!("quarantined, and without work: {}", names(&quarantined));
        let cure = "correct their machines, then `sdfarm workers release ID`, or restart them";
        found.push(Found::warning("workers_quarantined", message, cure));
    }
    let failing: Vec<_> = workers.iter().filter(|worker| failing.contains(&worker.id) && !worker.quarantined).collect();
    if let Some(error) = failing.iter().find_map(|worker| worker.last_error.as_deref()) {
        let message = format!("tiles fail on {}: {error}", names(&failing));
        let cure = "correct the machine or the scene; `sdfarm workers quarantine ID` keeps work from a worker";
        found.push(Found::warning("workers_failing", message, cure));
    }
    found
}

/// Names of workers, with the number of those that are left out.
fn names(workers: &[&WorkerView]) -> String {
    let listed: Vec<&str> = workers.iter().take(NAMED).map(|worker| worker.name.as_str()).collect();
    let more = workers.len().saturating_sub(NAMED);
    if more == 0 { listed.join(", ") } else { format!("{} and {more} more", listed.join(", ")) }
}

fn there_are(count: u64, noun: &str) -> String {
    if count == 1 { format!("is 1 {noun}") } else { format!("are {count} {noun}s") }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn worker(name: &str, state: WorkerState, errors: u64) -> WorkerView {
        WorkerView {
            id: WorkerId::new(),
            name: name.to_owned(),
            device: "cpu".to_owned(),
            state,
            rays_per_second: None,
            leases: 0,
            pool: false,
            registered_at: String::new(),
            last_seen_at: String::new(),
            quarantined: state == WorkerState::Quarantined,
            draining: state == WorkerState::Draining,
            errors,
            last_error: (errors > 0).then(|| "the device is hot".to_owned()),
            holds: Vec::new(),
        }
    }

    fn failing(workers: &[WorkerView]) -> BTreeSet<WorkerId> {
        workers.iter().filter(|worker| worker.errors > 0).map(|worker| worker.id).collect()
    }

    fn codes(found: &[Found]) -> Vec<&'static str> {
        found.iter().map(|alert| alert.code).collect()
    }

    #[test]
    fn work_without_a_worker_is_critical_and_idleness_is_not() {
        let idle = [worker("a", WorkerState::Draining, 0)];
        assert_eq!(of_workers(&idle, &BTreeSet::new(), 0, 0), []);
        let found = of_workers(&idle, &BTreeSet::new(), 2, 0);
        assert_eq!((codes(&found), found[0].severity), (vec!["no_worker"], AlertSeverity::Critical));
        assert_eq!(found[0].message, "no worker takes work, and there are 2 unfinished jobs");
        for state in [WorkerState::Ready, WorkerState::Starting] {
            assert_eq!(of_workers(&[worker("a", state, 0)], &BTreeSet::new(), 2, 0), []);
        }
    }

    #[test]
    fn workers_that_are_missing_quarantined_or_fail_are_told() {
        let mut workers = vec![worker("hot", WorkerState::Ready, 3), worker("well", WorkerState::Ready, 0)];
        assert_eq!(codes(&of_workers(&workers, &failing(&workers), 1, 1)), ["pool_short", "workers_failing"]);
        workers[1].pool = true;
        let found = of_workers(&workers, &failing(&workers), 1, 1);
        assert_eq!(
            found.iter().map(|alert| &*alert.message).collect::<Vec<_>>(),
            ["tiles fail on hot: the device is hot"]
        );
        workers.extend((0..7).map(|index| worker(&format!("q{index}"), WorkerState::Quarantined, 9)));
        let found = of_workers(&workers, &failing(&workers), 1, 1);
        assert_eq!(codes(&found), ["workers_quarantined", "workers_failing"]);
        assert_eq!(found[0].message, "quarantined, and without work: q0, q1, q2, q3, q4 and 2 more");
    }
}
