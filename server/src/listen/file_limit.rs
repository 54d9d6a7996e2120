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
    let connections = room(files).min(wanted.into());
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

/// Number of connections for which a limit of open files leaves room: at least half of it.
fn room(files: u64) -> u64 {
    files.saturating_sub(RESERVED_FILES).max(files / 2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn some_files_are_reserved_but_at_most_half() {
        for (files, connections) in [(0, 0), (100, 50), (1023, 511), (1024, 512), (1025, 513), (20_000, 19_488)] {
            assert_eq!(room(files), connections, "{files} files");
        }
        assert_eq!(connection_limit(1), 1);
    }
}
