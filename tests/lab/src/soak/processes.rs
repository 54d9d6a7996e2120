//! Finds, checks, and kills processes of the system.

use std::fs;

use rustix::process::{Pid, Signal, kill_process};

/// Kills a process like `kill -9`; no error if it has already exited.
pub(super) fn kill(process: u32) {
    if let Some(process) = i32::try_from(process).ok().and_then(Pid::from_raw) {
        // It may have exited since its id was read.
        let _ = kill_process(process, Signal::KILL);
    }
}

/// Whether a process exists and is not a zombie.
pub(super) fn is_alive(process: u32) -> bool {
    field(process, 0).is_some_and(|state| state != "Z" && state != "X")
}

/// Live child processes of this process.
pub(super) fn children(parent: u32) -> Vec<u32> {
    let parent = parent.to_string();
    let processes = fs::read_dir("/proc").into_iter().flatten().flatten();
    let ids = processes.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    ids.filter(|&process| field(process, 1).is_some_and(|of| of == parent) && is_alive(process)).collect()
}

/// Resident memory of a process, in bytes.
pub(super) fn resident_bytes(process: u32) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kibibytes| kibibytes * 1024)
}

/// A field of `/proc/ID/stat` after the name: 0 the state, 1 the parent.
fn field(process: u32, field: usize) -> Option<String> {
    let stat = fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    let (_, after_name) = stat.rsplit_once(')')?;
    after_name.split_whitespace().nth(field).map(str::to_owned)
}
