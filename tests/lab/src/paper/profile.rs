//! Runs sdfarm under NVIDIA's Nsight Compute (`ncu`) to measure a kernel's occupancy and divergence.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde::Serialize;
use worker::cuda::BlockDim;

use crate::program::Program;

/// Name of the render kernel.
const KERNEL: &str = "render";
const OCCUPANCY: &str = "sm__warps_active.avg.pct_of_peak_sustained_active";
const UNIFORM: &str = "smsp__sass_average_branch_targets_threads_uniform.pct";
const LANES: &str = "smsp__thread_inst_executed_per_inst_executed.ratio";

/// Counters of a kernel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct StepProfile {
    /// Active fraction of the GPU's warps, in percent.
    pub(super) achieved_occupancy_percent: Option<f64>,
    /// Fraction of branches that all threads of a warp take alike, in percent.
    pub(super) branch_efficiency_percent: Option<f64>,
    /// Threads of a warp's 32 that an instruction works for.
    pub(super) active_lanes: Option<f64>,
}

/// Profiles the first launch of a frame, which follows the self-test's launches.
pub(super) fn profile(
    program: &Program,
    job: &Path,
    device: &str,
    block: BlockDim,
    cache: Option<&Path>,
) -> Result<StepProfile, String> {
    let folder = job.parent().unwrap_or(Path::new("."));
    let (log, picture): (PathBuf, PathBuf) = (folder.join("ncu.csv"), folder.join("profiled.png"));
    let program = program.file().map_err(|error| format!("{error:#}"))?;
    let mut command = Command::new("ncu");
    command.args(["--csv", "--print-units", "base", "--kernel-name", KERNEL]);
    command.args(["--metrics", &[OCCUPANCY, UNIFORM, LANES].join(",")]).arg("--log-file").arg(&log);
    command.arg(program).arg("render").arg(job).arg("-o").arg(&picture);
    command.args(["--device", device, "--block", &block.to_string()]);
    if let Some(cache) = cache {
        command.arg("--cache").arg(cache);
    }
    let output = command.stdin(Stdio::null()).output().map_err(|error| format!("ncu could not be run: {error}"))?;
    let log = std::fs::read_to_string(&log).unwrap_or_default();
    let counted = read(&log, block);
    if counted == StepProfile::default() {
        let message = log.lines().find(|line| line.contains("==ERROR==")).map(str::to_owned);
        let why = message.unwrap_or_else(|| format!("it exited with {}", output.status));
        return Err(format!("ncu counted nothing: {why}"));
    }
    Ok(counted)
}

/// Returns the figures of the launch with the most blocks of these dimensions; of several, the first.
fn read(log: &str, block: BlockDim) -> StepProfile {
    let mut rows = log.lines().skip_while(|line| !line.starts_with("\"ID\"")).map(fields);
    let heads = rows.next().unwrap_or_default();
    let place = |name: &str| heads.iter().position(|head| *head == name);
    let (Some(id), Some(shape), Some(grid), Some(metric), Some(value)) =
        (place("ID"), place("Block Size"), place("Grid Size"), place("Metric Name"), place("Metric Value"))
    else {
        return StepProfile::default();
    };
    let rows: Vec<Vec<&str>> = rows
        .filter(|row| row.len() == heads.len() && numbers(row[shape])[..2] == [block.columns, block.rows])
        .collect();
    let blocks = |row: &[&str]| numbers(row[grid]).iter().product::<u32>();
    // `max_by_key` returns the last of equal elements, so the rows are reversed.
    let Some(launch) = rows.iter().rev().max_by_key(|row| blocks(row)).map(|row| row[id]) else {
        return StepProfile::default();
    };
    let figure = |name: &str| {
        let row = rows.iter().find(|row| row[id] == launch && row[metric] == name)?;
        row[value].replace(',', "").parse().ok()
    };
    StepProfile {
        achieved_occupancy_percent: figure(OCCUPANCY),
        branch_efficiency_percent: figure(UNIFORM),
        active_lanes: figure(LANES),
    }
}

/// Splits a line into its quoted fields.
fn fields(line: &str) -> Vec<&str> {
    line.trim().trim_start_matches('"').trim_end_matches('"').split("\",\"").collect()
}

/// Parses the three numbers of `(64, 1, 1)`; 0 for a missing one.
fn numbers(text: &str) -> [u32; 3] {
    let mut numbers = text.trim_matches(['(', ')']).split(',').map(|number| number.trim().parse().unwrap_or(0));
    [(); 3].map(|()| numbers.next().unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOG: &str = r#"==PROF== Connected to process 71 (/usr/bin/sdfarm)
==PROF== Profiling "render": 0%....50%....100% - 4 passes
"ID","Process ID","Process Name","Host Name","Kernel Name","Context","Stream","Block Size","Grid Size","Device","CC","Section Name","Metric Name","Metric Unit","Metric Value"
"0","71","sdfarm","127.0.0.1","render","1","13","(8, 8, 1)","(128, 1, 1)","0","9.0","Command line profiler metrics","sm__warps_active.avg.pct_of_peak_sustained_active","%","3.10"
"1","71","sdfarm","127.0.0.1","render","1","13","(8, 8, 1)","(1024, 1, 1)","0","9.0","Command line profiler metrics","sm__warps_active.avg.pct_of_peak_sustained_active","%","41.25"
"1","71","sdfarm","127.0.0.1","render","1","13","(8, 8, 1)","(1024, 1, 1)","0","9.0","Command line profiler metrics","smsp__sass_average_branch_targets_threads_uniform.pct","%","97.50"
"1","71","sdfarm","127.0.0.1","render","1","13","(8, 8, 1)","(1024, 1, 1)","0","9.0","Command line profiler metrics","smsp__thread_inst_executed_per_inst_executed.ratio","","n/a"
"2","71","sdfarm","127.0.0.1","render","1","13","(8, 8, 1)","(1024, 1, 1)","0","9.0","Command line profiler metrics","sm__warps_active.avg.pct_of_peak_sustained_active","%","50.00"
"#;

    #[test]
    fn figures_of_the_largest_launch_are_read() {
        let got = read(LOG, BlockDim { columns: 8, rows: 8 });
        let want = StepProfile {
            achieved_occupancy_percent: Some(41.25),
            branch_efficiency_percent: Some(97.5),
            active_lanes: None,
        };
        assert_eq!(got, want);
    }

    #[test]
    fn log_without_figures_or_of_other_blocks_gives_none() {
        assert_eq!(read("==ERROR== ERR_NVGPUCTRPERM", BlockDim { columns: 8, rows: 8 }), StepProfile::default());
        assert_eq!(read(LOG, BlockDim { columns: 16, rows: 16 }), StepProfile::default());
    }
}
