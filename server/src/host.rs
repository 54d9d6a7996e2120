//! Figures of the operating system about this process, its disk and its files.
//!
//! A figure that the system does not provide is `None`.

use std::fs;
use std::path::Path;

/// Unit of the times in `/proc/self/stat`: 1/100 s on every Linux.
const TICKS_PER_SECOND: f64 = 100.0;

/// Figures of this process.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Process {
    /// Resident memory, in bytes.
    pub(crate) resident_bytes: u64,
    /// CPU time, in seconds.
    pub(crate) cpu_seconds: f64,
    /// Number of open files and connections.
    pub(crate) open_files: u64,
    /// Maximum number of open files.
    pub(crate) max_files: u64,
}

/// Space on the disk of a folder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Disk {
    /// Free bytes for ordinary users.
    pub(crate) free_bytes: u64,
    /// Total bytes.
    pub(crate) total_bytes: u64,
}

/// Room on a disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Room {
    /// It suffices.
    Enough,
    /// It does not suffice for long.
    Low,
    /// There is none: the farm stops.
    None,
}

/// Free disk space below which there is little room.
const LOW_DISK_BYTES: u64 = 5 << 30;
/// Free disk space below which there is no room.
const NO_DISK_BYTES: u64 = 500 << 20;
/// Cure of a full disk.
pub(crate) const DISK_CURE: &str = "free space, or move the data folder to a larger disk";

impl Disk {
    /// Room that is left.
    pub(crate) fn room(self) -> Room {
        if self.free_bytes < NO_DISK_BYTES {
            Room::None
        } else if self.free_bytes < LOW_DISK_BYTES {
            Room::Low
        } else {
            Room::Enough
        }
    }
}

/// Reads the figures of this process.
pub(crate) fn process() -> Process {
    let stat = fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    Process {
        resident_bytes: resident_kib(&status).unwrap_or(0) << 10,
        cpu_seconds: cpu_ticks(&stat).unwrap_or(0) as f64 / TICKS_PER_SECOND,
        open_files: fs::read_dir("/proc/self/fd").map_or(0, |files| files.count() as u64),
        max_files: rustix::process::getrlimit(rustix::process::Resource::Nofile).current.unwrap_or(u64::MAX),
    }
}

/// Time in user and kernel mode: fields 14 and 15, counted after the name, which may contain any character.
fn cpu_ticks(stat: &str) -> Option<u64> {
    let (_, after_name) = stat.rsplit_once(')')?;
    let mut fields = after_name.split_whitespace().skip(11);
    Some(fields.next()?.parse::<u64>().ok()? + fields.next()?.parse::<u64>().ok()?)
}

fn resident_kib(status: &str) -> Option<u64> {
    status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?.trim().strip_suffix("kB")?.trim().parse().ok()
}

/// Reads the figures of a folder's disk.
pub(crate) fn disk(folder: &Path) -> Disk {
    rustix::fs::statvfs(folder).map_or(Disk::default(), |disk| Disk {
        free_bytes: disk.f_bavail * disk.f_frsize,
        total_bytes: disk.f_blocks * disk.f_frsize,
    })
}

/// Size of a file; 0 if it is missing.
pub(crate) fn file_bytes(file: &Path) -> u64 {
    fs::metadata(file).map_or(0, |metadata| metadata.len())
}

/// Total size of a folder's files.
pub(crate) fn folder_bytes(folder: &Path) -> u64 {
    let Ok(entries) = fs::read_dir(folder) else { return 0 };
    entries.flatten().filter_map(|entry| entry.metadata().ok()).map(|metadata| metadata.len()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cpu_time_is_parsed_after_the_process_name() {
        let stat = "7 (a) b) (c) S 1 7 7 0 -1 4194560 100 0 0 0 250 50 0 0 20 0 1 0 5 6 7";
        assert_eq!(cpu_ticks(stat), Some(300));
        assert_eq!(cpu_ticks("7 (sdfarm"), None);
    }

    #[test]
    fn figures_of_this_process_are_available() {
        let process = process();
        assert!(process.resident_bytes > 1 << 20 && process.open_files > 2, "{process:?}");
        let disk = disk(&std::env::temp_dir());
        assert!(disk.free_bytes <= disk.total_bytes && disk.total_bytes > 0, "{disk:?}");
    }
}
