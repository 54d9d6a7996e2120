//! Overload test: more jobs than a farm can take, for minutes. It must reject the excess with a Retry-After, stay
//! healthy and small, and recover soon afterwards.

use std::fmt::Write;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context;
use proto::job::JobState;
use serde_json::json;

use super::probe;
use super::processes::resident_bytes;
use super::server::{Launch, ServerLog, ServerProcess};
use super::workload::ReferenceJob;
use crate::program::Program;

/// Clients that submit jobs regardless of the responses.
const CLIENTS: usize = 32;
/// Submitted jobs as a multiple of the farm's capacity: somewhat more than ten.
const EXCESS: u64 = 12;
/// Pause of each client before its next job, once the multiple is reached and before; much less than Retry-After says.
const CLIENT_INTERVAL: Duration = Duration::from_millis(100);
const EXCESS_DELAY: Duration = Duration::from_millis(10);
/// Maximum number of unfinished jobs of the farm.
const MAX_QUEUED_JOBS: &str = "200";
/// Time after which memory is first measured, because the first jobs fill caches.
const WARM_UP: Duration = Duration::from_secs(10);
/// Interval between two health checks.
const HEALTH_INTERVAL: Duration = Duration::from_millis(50);
/// Time limit of a health check; a slower one is a violation.
const HEALTH_LIMIT: Duration = Duration::from_millis(50);
/// Maximum growth of memory, in percent.
const GROWTH_LIMIT_PERCENT: u64 = 20;
/// Time limit for a job submitted after the overload.
const RECOVERY_LIMIT: Duration = Duration::from_secs(30);

/// Counters of an overload.
#[derive(Debug, Default)]
struct Counts {
    taken: AtomicU64,
    refused: AtomicU64,
    /// Rejections without a Retry-After.
    without_retry_after: AtomicU64,
    other: AtomicU64,
    is_over: AtomicBool,
}

/// Result of an overload.
#[derive(Debug, Default)]
pub(super) struct OverloadReport {
    rows: Vec<(&'static str, String)>,
    /// Violations.
    pub(super) violations: Vec<String>,
}

impl OverloadReport {
    /// The table.
    pub(super) fn table(&self) -> String {
        let mut table = String::new();
        for (name, value) in &self.rows {
            writeln!(table, "{name:<42} {value}").expect("writing to a string");
        }
        write!(table, "{:<42} {}", "violations", self.violations.len()).expect("writing to a string");
        table
    }

    fn expect(&mut self, is_so: bool, violation: String) {
        if !is_so {
            self.violations.push(violation);
        }
    }
}

/// Overloads a temporary farm for some time.
pub(super) async fn overload(
    program: &Program,
    tasks: &[ReferenceJob],
    data: &Path,
    time: Duration,
) -> anyhow::Result<OverloadReport> {
    let said = Arc::<ServerLog>::default();
    let flags = ["--max-queued-jobs", MAX_QUEUED_JOBS];
    let launch = Launch { program, data, listen: 0, database: None, workers: 1, flags: &flags, fail_points: "" };
    let server = ServerProcess::start(&launch, &said).await?.context("the server exited right after its start")?;
    eprintln!("{CLIENTS} clients submit jobs for {time:?}");
    let counts = Arc::<Counts>::default();
    let task = tasks.first().context("there are tasks")?;
    let clients: Vec<_> = (0..CLIENTS)
        .map(|_| tokio::spawn(submit(server.address.clone(), task.text.clone(), Arc::clone(&counts))))
        .collect();
    let (health, memory) = watch(&server, time).await?;
    counts.is_over.store(true, Ordering::Relaxed);
    for client in clients {
        client.await.context("a client panicked")?;
    }
    let mut report = OverloadReport::default();
    let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
    let (taken, refused) = (count(&counts.taken), count(&counts.refused));
    report.rows.push(("jobs accepted, rejected with 429", format!("{taken}, {refused}")));
    report.rows.push(("jobs with other responses", count(&counts.other).to_string()));
    report.expect(refused > 9 * taken, format!("{refused} rejected, {taken} accepted: no tenfold overload"));
    report.expect(
        count(&counts.without_retry_after) == 0,
        format!("{} rejections without Retry-After", count(&counts.without_retry_after)),
    );
    report.expect(count(&counts.other) == 0, format!("{} responses other than 201 and 429", count(&counts.other)));
    check_health(&mut report, health);
    let (start, end) = memory;
    report.rows.push(("memory at start and end, MiB", format!("{}, {}", start >> 20, end >> 20)));
    let limit = start + start * GROWTH_LIMIT_PERCENT / 100;
    report.expect(end <= limit, format!("memory grew from {} to {} MiB", start >> 20, end >> 20));
    recover(&server, task, &mut report).await?;
    report.expect(said.panics.load(Ordering::Relaxed) == 0, "the farm panicked".to_owned());
    report.expect(server.terminate().await?, "the farm did not shut down gracefully".to_owned());
    Ok(report)
}

async fn submit(address: String, text: Vec<u8>, counts: Arc<Counts>) {
    while !counts.is_over.load(Ordering::Relaxed) {
        let counter = match probe::post(&address, "/v1/jobs", &text).await {
            Some((201, _)) => &counts.taken,
            Some((429, has_time)) => {
                if !has_time {
                    counts.without_retry_after.fetch_add(1, Ordering::Relaxed);
                }
                &counts.refused
            }
            Some(_) | None => &counts.other,
        };
        counter.fetch_add(1, Ordering::Relaxed);
        let is_enough = counts.refused.load(Ordering::Relaxed) >= EXCESS * counts.taken.load(Ordering::Relaxed);
        tokio::time::sleep(if is_enough { CLIENT_INTERVAL } else { EXCESS_DELAY }).await;
    }
}

/// Durations of health checks during the overload, and the memory after its start and at its end.
async fn watch(server: &ServerProcess, time: Duration) -> anyhow::Result<(Vec<Duration>, (u64, u64))> {
    let start = Instant::now();
    let mut health = Vec::new();
    let mut first = None;
    while start.elapsed() < time {
        let asked = Instant::now();
        let status = probe::status(&server.address, "/livez").await;
        anyhow::ensure!(status == Some(200), "/livez responded {status:?}");
        health.push(asked.elapsed());
        if first.is_none() && start.elapsed() >= WARM_UP.min(time / 4) {
            first = resident_bytes(server.process());
        }
        tokio::time::sleep(HEALTH_INTERVAL).await;
    }
    let last = resident_bytes(server.process()).context("could not read the server's memory use")?;
    Ok((health, (first.unwrap_or(last), last)))
}

fn check_health(report: &mut OverloadReport, mut health: Vec<Duration>) {
    health.sort();
    let at = |percent: usize| health.get((health.len() * percent / 100).min(health.len() - 1)).copied();
    let (median, p99, most) =
        (at(50).unwrap_or_default(), at(99).unwrap_or_default(), health.last().copied().unwrap_or_default());
    report.rows.push(("health check: median, p99, maximum", format!("{median:.1?}, {p99:.1?}, {most:.1?}")));
    report.expect(p99 < HEALTH_LIMIT, format!("a health check took {p99:?} (p99)"));
}

/// Checks that the farm accepts a job after the overload, and finishes it before the queued ones.
async fn recover(server: &ServerProcess, task: &ReferenceJob, report: &mut OverloadReport) -> anyhow::Result<()> {
    let start = Instant::now();
    let mut job: serde_json::Value = serde_json::from_slice(&task.text).context("a job file is not JSON")?;
    job["priority"] = json!(100);
    let text = job.to_string().into_bytes();
    let id = loop {
        match server.client.submit(text.clone(), true).await {
            Ok(job) => break job.id,
            Err(error) => anyhow::ensure!(start.elapsed() < RECOVERY_LIMIT, "no job is accepted any more: {error}"),
        }
        tokio::time::sleep(HEALTH_INTERVAL).await;
    };
    while server.client.job(id).await?.state != JobState::Succeeded && start.elapsed() < RECOVERY_LIMIT {
        tokio::time::sleep(HEALTH_INTERVAL).await;
    }
    report.rows.push(("a job accepted and finished afterwards", format!("{:.1?}", start.elapsed())));
    report.expect(start.elapsed() < RECOVERY_LIMIT, format!("no job was finished within {RECOVERY_LIMIT:?}"));
    Ok(())
}
