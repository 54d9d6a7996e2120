//! Fail points: named places where a process can be made to exit, fail or wait, so that a test can hit the
//! instant between two steps that random kills rarely hit.
//!
//! They are in every build, so that tests run the binary that operators run; a disarmed point costs the load
//! of one atomic. Only the program's own hidden flag arms them, once: the environment variable alone does
//! nothing. This module does not depend on the code around its points.

use std::fmt;
use std::str::FromStr;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Environment variable with the armed points and their actions, read only if the hidden flag is given.
pub const ENV_VAR: &str = "SDFARM_FAIL_POINTS";
/// The hidden flag.
pub const FLAG: &str = "--allow-fail-points";
/// Prefix of the line that a process writes to standard error when a point is triggered.
pub const LOG_PREFIX: &str = "fail point";

macro_rules! points {
    ($($(#[doc = $doc:literal])+ $point:ident = $name:literal,)+) => {
        /// A named place in the program.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum FailPoint { $($(#[doc = $doc])+ $point,)+ }

        impl FailPoint {
            /// Every point.
            pub const ALL: &[Self] = &[$(Self::$point),+];

            /// Its name in [`ENV_VAR`].
            pub fn name(self) -> &'static str {
                match self { $(Self::$point => $name,)+ }
            }
        }
    };
}

points! {
    /// Server: the database is open, its migrations have not run.
    Migrating = "migrating",
    /// Server: the migrations have run, the previous server's state has not been repaired.
    Migrated = "migrated",
    /// Server: a job is committed, its 201 has not been sent.
    SubmitCommitted = "submit_committed",
    /// Server: a batch is leased and committed, its worker has no response.
    Claimed = "claimed",
    /// Server: a group is committed, no caller has its response.
    GroupCommitted = "group_committed",
    /// Server: a remote tile's blob is in the store, its worker has no response.
    BlobStored = "blob_stored",
    /// Server: a remote picture is fsynced, no row names it.
    PictureStored = "picture_stored",
    /// Server: orphaned bytes have been found, and not yet deleted.
    Sweeping = "sweeping",
    /// Server: a database operation begins.
    DatabaseWrite = "database_write",
    /// Server: a group of operations is about to be committed.
    DatabaseCommit = "database_commit",
    /// Server: a message about a change is about to go to the others.
    Telling = "telling",
    /// Server, or a worker of its pool: bytes are about to be stored.
    StorePut = "store_put",
    /// Server, or a worker of its pool: stored bytes are about to be read.
    StoreGet = "store_get",
    /// Worker: tiles are about to be rendered, and a delay ignores that they are cancelled.
    Rendering = "rendering",
    /// Worker: a blob is stored, its tile has not been reported.
    BlobPut = "blob_put",
    /// Worker: a picture is stored, it has not been reported.
    PicturePut = "picture_put",
    /// Worker: a frame's blobs are fetched, its picture has not been encoded.
    Stitching = "stitching",
}

/// Action of a triggered point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FailAction {
    /// The process kills itself, as `kill -9` would.
    Kill,
    /// The step fails.
    Err,
    /// The step takes longer.
    Slow(Duration),
}

/// Passes at which a point triggers, from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Passes {
    Every,
    Only(u64),
    /// Every multiple of this number.
    EveryNth(u64),
}

/// Armed fail point.
#[derive(Debug)]
struct ArmedFailPoint {
    point: FailPoint,
    action: FailAction,
    /// Passes at which it triggers.
    when: Passes,
    passes: AtomicU64,
}

/// Error injected by a triggered fail point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{LOG_PREFIX} {} triggered", .0.name())]
pub struct FailPointError(pub FailPoint);

/// Error returned when [`ENV_VAR`] is not a list of fail points.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{part:?} is not a fail point: write NAME=kill, NAME=error or NAME=slow:MILLISECONDS, and @N to trigger at pass N only, or /N at every Nth; names are {}",
    names()
)]
pub struct ParseFailPointsError {
    /// The invalid part.
    part: String,
}

fn names() -> String {
    FailPoint::ALL.iter().map(|point| point.name()).collect::<Vec<_>>().join(", ")
}

static ARMED: OnceLock<Vec<ArmedFailPoint>> = OnceLock::new();

/// Arms the points of a list such as `submit_committed=kill@3,store_put=slow:50`, for the rest of the process's life.
pub fn arm(list: &str) -> Result<(), ParseFailPointsError> {
    let parts = list.split(',').map(str::trim).filter(|part| !part.is_empty());
    let traps = parts.map(str::parse).collect::<Result<Vec<ArmedFailPoint>, _>>()?;
    // A second call would mean a second flag, which the command line rejects.
    let _ = ARMED.set(traps);
    Ok(())
}

/// Whether points are armed in this process; child processes inherit them.
pub fn is_armed() -> bool {
    ARMED.get().is_some()
}

/// Passes a point.
pub fn trigger(point: FailPoint) -> Result<(), FailPointError> {
    match ARMED.get() {
        None => Ok(()),
        Some(traps) => traps.iter().filter(|trap| trap.point == point).try_for_each(ArmedFailPoint::trigger),
    }
}

/// Passes a point in code that cannot fail: only a kill or a delay takes effect.
pub fn trigger_infallible(point: FailPoint) {
    // An injected error would have no caller to handle it.
    let _ = trigger(point);
}

impl ArmedFailPoint {
    fn trigger(&self) -> Result<(), FailPointError> {
        let pass = self.passes.fetch_add(1, Ordering::Relaxed) + 1;
        let triggers = match self.when {
            Passes::Every => true,
            Passes::Only(wanted) => pass == wanted,
            Passes::EveryNth(number) => pass.is_multiple_of(number),
        };
        if !triggers {
            return Ok(());
        }
        eprintln!("{LOG_PREFIX} {} triggered at pass {pass}: {}", self.point.name(), self.action);
        match self.action {
            FailAction::Kill => loop {
                // Whatever `kill` returns, the process must not continue.
                let _ = rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::KILL);
            },
            FailAction::Err => Err(FailPointError(self.point)),
            FailAction::Slow(delay) => {
                std::thread::sleep(delay);
                Ok(())
            }
        }
    }
}

impl fmt::Display for FailAction {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Kill => formatter.write_str("kill"),
            Self::Err => formatter.write_str("error"),
            Self::Slow(delay) => write!(formatter, "slow:{}", delay.as_millis()),
        }
    }
}

impl FromStr for ArmedFailPoint {
    type Err = ParseFailPointsError;

    fn from_str(part: &str) -> Result<Self, ParseFailPointsError> {
        let wrong = || ParseFailPointsError { part: part.to_owned() };
        let (name, rest) = part.split_once('=').ok_or_else(wrong)?;
        let number = |text: &str| text.parse::<u64>().ok().filter(|number| *number > 0).ok_or_else(wrong);
        let (action, when) = match (rest.split_once('@'), rest.split_once('/')) {
            (Some((action, pass)), _) => (action, Passes::Only(number(pass)?)),
            (None, Some((action, step))) => (action, Passes::EveryNth(number(step)?)),
            (None, None) => (rest, Passes::Every),
        };
        let action = match action.split_once(':') {
            None if action == "kill" => FailAction::Kill,
            None if action == "error" => FailAction::Err,
            Some(("slow", delay_ms)) => FailAction::Slow(Duration::from_millis(delay_ms.parse().map_err(|_| wrong())?)),
            _ => return Err(wrong()),
        };
        let point = FailPoint::ALL.iter().find(|point| point.name() == name).copied().ok_or_else(wrong)?;
        Ok(Self { point, action, when, passes: AtomicU64::new(0) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_action_parses_to_what_it_prints() {
        for text in ["kill", "error", "slow:50"] {
            let trap: ArmedFailPoint = format!("claimed={text}@7").parse().expect("valid");
            let reported = (trap.point, trap.when, trap.action.to_string());
            assert_eq!(reported, (FailPoint::Claimed, Passes::Only(7), text.to_owned()));
        }
    }

    #[test]
    fn invalid_points_are_rejected_with_the_valid_names() {
        for bad in [
            "claimed",
            "claimed=",
            "nowhere=kill",
            "claimed=kill@x",
            "claimed=slow",
            "claimed=slow:x",
            "=kill",
            "claimed=kill/0",
        ] {
            let refused = bad.parse::<ArmedFailPoint>().expect_err(bad).to_string();
            assert!(refused.contains("submit_committed"), "{refused}");
        }
    }

    #[test]
    fn a_fail_point_triggers_only_at_its_pass() {
        let trap: ArmedFailPoint = "store_put=error@2".parse().expect("valid");
        let struck: Vec<bool> = (0..4).map(|_| trap.trigger().is_err()).collect();
        assert_eq!(struck, [false, true, false, false]);
        let trap: ArmedFailPoint = "store_put=error/2".parse().expect("valid");
        let struck: Vec<bool> = (0..4).map(|_| trap.trigger().is_err()).collect();
        assert_eq!(struck, [false, true, false, true]);
    }
}
