//! Raises the limit of open files, because each connection needs one.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Files reserved for the database, pictures and workers.
const RESERVED_FILES: u64 = 512;

/// Has the system grant as many files as it will, and returns how many connections of those wanted that leaves.
pub(crate) fn connection_limit(wanted: u32) -> usize {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    let raised = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum });
    if let Err(error) = &raised {
        tracing::debug!(%error, "the limit of open files could not be raised");
    }
    // No limit is reported as none.
    let files = if raised.is_ok() { maximum } else { current }.unwrap_or(u64::MAX);
    let room = files.saturating_sub(RESERVED_FILES).max(files / 2);
    let connections = room.min(wanted.into());
    if connections < wanted.into() {
        tracing::warn!(
            connections,
            wanted,
            files,
            "the system grants too few open files for as many connections: raise its limit (ulimit -n, LimitNOFILE)"
        );
    }
    usize::try_from(connections).unwrap_or(usize::MAX)
}
