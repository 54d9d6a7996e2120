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
    /// Jobs that succeeded with the expected pictures.
    pub(super) succeeded: usize,
    /// Pictures compared with undisturbed ones.
    pub(super) pictures: usize,
    /// Events received by followers, if there are several servers.
    pub(super) followed: usize,
    /// Number of integrity checks.
    pub(super) integrity_checks: u32,
    /// Done tiles compared between two integrity checks.
    pub(super) tiles: usize,
    /// Longest time from a start to the first 200 of `/readyz`.
    pub(super) slowest_ready: Duration,
    /// Sum of those times, and their number.
    pub(super) ready: (Duration, u32),
    /// Total duration.
    pub(super) took: Duration,
    /// Violations.
    pub(super) violations: Vec<String>,
}

impl SoakReport {
    /// Records a violation, unless it is already recorded.
    pub(super) fn violation(&mut self, violation: String) {
        if !self.violations.contains(&violation) {
            self.violations.push(violation);
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
        row("workers killed", format!("{} ({} at fail points)", self.all_worker_kills(), self.workers_hit));
        row("server killed", format!("{} ({} at fail points)", self.all_server_kills(), self.servers_hit));
        row("jobs accepted, jobs succeeded", format!("{}, {}", self.accepted, self.succeeded));
        row("jobs whose response was lost with the server", self.unanswered.to_string());
        row("pictures identical to undisturbed renders", self.pictures.to_string());
        if self.followed > 0 {
            row("events followed from server to server", self.followed.to_string());
        }
        row("integrity checks of database and pictures", self.integrity_checks.to_string());
        row("done tiles, none rendered again", self.tiles.to_string());
        row("server ready after a start, mean and maximum", format!("{:.0?}, {:.0?}", mean, self.slowest_ready));
        row("time", format!("{:.0?}", self.took));
        row("violations", self.violations.len().to_string());
        table.trim_end().to_owned()
    }
}
