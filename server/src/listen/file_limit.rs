//! Raises the limit of open files, because each connection needs one.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Files reserved for the database, pictures and workers.
const RESERVED_FILES: u64 = 512;

/// Raises the limit as far as the system allows, and returns how many of the requested connections it leaves
/// room for.
pub(crate) fn connection_limit(wanted: u32) -> usize {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    let raised = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum });
    if let Err(error) = &raised {
        tracing::debug!(%error, "could not raise the limit of open files");
    }
    // An unlimited number is reported as `None`.
    let files = if raised.is_ok() { maximum } else { current }.unwrap_or(u64::MAX);
    let room = files.saturating_sub(RESERVED_FILES).max(files / 2);
    let connections = room.min(wanted.into());
    if connections < wanted.into() {
        tracing::warn!(
            connections,
            wanted,
            files,
            "the limit of open files is too low for this many connections: raise it (ulimit -n, LimitNOFILE)"
        );
    }
    usize::try_from(connections).unwrap_or(usize::MAX)
}
