//! Shows progress on standard error: a bar on a terminal, otherwise a plain line every 5 s.

use std::io::IsTerminal;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use crate::terminal::{escape_line, print_note};

/// Time between plain lines; work that finishes sooner prints none.
const LINE_INTERVAL: Duration = Duration::from_secs(5);
const BAR: &str = "{msg} [{bar:32}] {percent:>3} %  {elapsed} elapsed, {eta} left";

/// Progress display for users.
#[derive(Debug)]
pub(crate) struct Progress {
    shown: ProgressDisplay,
    done: AtomicU64,
    total: u64,
}

#[derive(Debug)]
enum ProgressDisplay {
    Bar(ProgressBar),
    Lines { label: String, last: Mutex<Instant> },
    Nothing,
}

impl Progress {
    /// Shows progress toward `total` units, under a label.
    pub(crate) fn new(label: &str, total: u64) -> Self {
        let label = escape_line(label).into_owned();
        let shown = if std::io::stderr().is_terminal() {
            let style = ProgressStyle::with_template(BAR).expect("the template above is one").progress_chars("=> ");
            ProgressDisplay::Bar(ProgressBar::new(total).with_style(style).with_message(label))
        } else {
            ProgressDisplay::Lines { label, last: Mutex::new(Instant::now()) }
        };
        Self { shown, done: AtomicU64::new(0), total }
    }

    /// Counts units without displaying anything.
    pub(crate) fn silent() -> Self {
        Self { shown: ProgressDisplay::Nothing, done: AtomicU64::new(0), total: 0 }
    }

    /// Adds finished units.
    pub(crate) fn add(&self, units: u64) {
        let done = self.done.fetch_add(units, Ordering::Relaxed) + units;
        self.show(done);
    }

    /// Sets the total of finished units.
    pub(crate) fn set(&self, units: u64) {
        self.done.store(units, Ordering::Relaxed);
        self.show(units);
    }

    /// Clears the bar.
    pub(crate) fn finish(&self) {
        match &self.shown {
            ProgressDisplay::Bar(bar) => bar.finish_and_clear(),
            ProgressDisplay::Lines { .. } | ProgressDisplay::Nothing => {}
        }
    }

    fn show(&self, done: u64) {
        match &self.shown {
            ProgressDisplay::Bar(bar) => bar.set_position(done),
            ProgressDisplay::Lines { label, last } => {
                // If the lock is taken, its holder prints the line.
                let Ok(mut last) = last.try_lock() else { return };
                if last.elapsed() >= LINE_INTERVAL {
                    *last = Instant::now();
                    print_note(&format!("{label}: {} %", done.saturating_mul(100) / self.total.max(1)));
                }
            }
            ProgressDisplay::Nothing => {}
        }
    }
}
