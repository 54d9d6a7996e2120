//! Counters of a soak, and the table that it prints.

use std::fmt::Write;
use std::time::Duration;

/// Counters of a soak.
#[derive(Debug, Default)]
pub(super) struct SoakReport {
    /// Workers killed from outside.
    pub(super) worker_kills: u32,
    /// Workers that a fail point killed.
    pub(super) workers_hit: u64,
    /// Times the server was killed from outside.
    pub(super) server_kills: u32,
    /// Times a fail point killed the server.
    pub(super) servers_hit: u64,
    /// Jobs answered with 201.
    pub(super) accepted: usize,
    /// Jobs whose response was lost with the server; they may exist or not.
    pub(super) unanswered: usize,
    /// Jobs that finished as they should.
    pub(super) succeeded: usize,
    /// Pictures compared with undisturbed ones.
    pub(super) pictures: usize,
    /// Number of integrity checks.
    pub(super) integrity_checks: u32,
    /// Done tiles that were watched from one audit to the next.
    pub(super) tiles: usize,
    /// The longest from a start to the first answer of `/readyz`.
    pub(super) slowest_ready: Duration,
    /// The sum of those times, and how many.
    pub(super) ready: (Duration, u32),
    /// Total duration.
    pub(super) took: Duration,
    /// Violations.
    pub(super) violations: Vec<String>,
}

impl SoakReport {
    /// Notes what must not be, once.
    pub(super) fn violation(&mut self, breach: String) {
        if !self.violations.contains(&breach) {
            self.violations.push(breach);
        }
    }

    /// All kills of workers.
    pub(super) fn all_worker_kills(&self) -> u64 {
        u64::from(self.worker_kills) + self.workers_hit
    }

    /// All kills of the server.
    pub(super) fn all_server_kills(&self) -> u64 {
        u64::from(self.server_kills) + self.servers_hit
    }

    /// The table.
    pub(super) fn table(&self) -> String {
        let mean = self.ready.0.checked_div(self.ready.1).unwrap_or_default();
        let mut table = String::new();
        let mut row = |name: &str, value: String| {
            writeln!(table, "{name:<42} {value}").expect("writing to a string");
        };
        row("workers killed", format!("{} ({} at named points)", self.all_worker_kills(), self.workers_hit));
        row("server killed", format!("{} ({} at named points)", self.all_server_kills(), self.servers_hit));
        row("jobs accepted, all kept and succeeded", format!("{}, {}", self.accepted, self.succeeded));
        row("jobs whose answer died with the server", self.unanswered.to_string());
        row("pictures, byte for byte as undisturbed", self.pictures.to_string());
        row("audits of database and pictures", self.integrity_checks.to_string());
        row("done tiles, none rendered again", self.tiles.to_string());
        row("server ready after a start, mean and most", format!("{:.0?}, {:.0?}", mean, self.slowest_ready));
        row("time", format!("{:.0?}", self.took));
        row("breaches", self.violations.len().to_string());
        table.trim_end().to_owned()
    }
}
