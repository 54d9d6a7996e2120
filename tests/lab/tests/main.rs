//! Process-level tests of `sdfarm-lab`. Its soaks with kills are in `tests/kills.rs`, because they need a real sdfarm.

#[path = "../../fake_cuda.rs"]
mod fake_cuda;

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::process::{Command, Output};

use serde_json::{Value, json};

fn lab(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sdfarm-lab"));
    command.args(arguments);
    command
}

fn run(mut command: Command) -> Output {
    command.output().expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn succeed(command: Command) -> String {
    let output = run(command);
    assert!(output.status.success(), "{}", text(&output.stderr));
    text(&output.stdout)
}

#[test]
fn soak_with_contradictory_flags_is_rejected() {
    let output = run(lab(&["soak", "--minutes", "1", "--workers", "1", "--worker-kills", "1"]));
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
}

#[test]
fn missing_sdfarm_is_reported() {
    let folder = tempfile::tempdir().expect("a folder");
    let alone = folder.path().join("lab");
    fs::copy(env!("CARGO_BIN_EXE_sdfarm-lab"), &alone).expect("copied");
    let mut command = Command::new(alone);
    command.args(["queue", "--jobs", "1"]);
    let output = run(command);
    assert!(!output.status.success() && text(&output.stderr).contains("--sdfarm"), "{}", text(&output.stderr));
}

#[test]
fn simulate_prints_the_scenarios_that_are_named() {
    let table = succeed(lab(&["simulate", "--scenario", "heavy-frame-2-gpus"]));
    assert!(table.lines().skip(1).all(|line| line.starts_with("heavy-frame-2-gpus")) && table.lines().count() > 1);
    let output = run(lab(&["simulate", "--scenario", "absent"]));
    assert!(!output.status.success() && text(&output.stderr).contains("absent"));
}

#[test]
fn setup_measures_each_step() {
    let report = succeed(lab(&["setup", "csg", "--runs", "1", "--json"]));
    let report: Value = serde_json::from_str(&report).expect("JSON");
    for step in ["parse_us", "at_us", "program_us", "key_us"] {
        assert!(report[step]["median"].as_f64().is_some_and(|us| us > 0.0), "{step}: {report}");
    }
}

#[test]
fn straight_says_how_to_get_a_compiler() {
    let mut command = lab(&["straight", "csg", "--seconds", "1"]);
    command.env("CXX", "no-such-compiler");
    let output = run(command);
    let (table, notes) = (text(&output.stdout), text(&output.stderr));
    assert!(output.status.success(), "{notes}");
    // Without vector instructions there is nothing to compare with.
    if table.lines().any(|line| line.starts_with("csg") && line.contains("avx")) {
        assert!(notes.contains("apt-get install g++"), "{notes}");
    } else {
        assert!(notes.contains("skipped: "), "{notes}");
    }
}

#[test]
fn paper_prints_measured_and_published_rows() {
    let arguments = ["paper", "--cpu", "--runs", "1", "--resolutions"];
    let output = run(lab(&[&arguments[..], &["16,32", "--json"]].concat()));
    let printed = text(&output.stderr);
    assert!(output.status.success() && printed.contains("GPU is skipped"), "{printed}");
    let table: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let rows = table["rows"].as_array().expect("rows");
    assert_eq!(rows.len(), 10, "two resolutions with five block dimensions each");
    for row in rows {
        let ratio = row["serial_ms"].as_f64().expect("ms") / row["simd_ms"].as_f64().expect("ms");
        assert!(ratio > 0.0 && (row["simd_speed_up"].as_f64().expect("ratio") / ratio - 1.0).abs() < 1e-9, "{row}");
        assert!(row["gpu"].is_null() && row["published"].is_null(), "this size was not published: {row}");
    }
    let table = succeed(lab(&[&arguments[..], &["256", "--block", "8x8"]].concat()));
    let rows: Vec<&str> = table.lines().filter(|line| line.starts_with("256² 8x8")).collect();
    assert_eq!(rows.len(), 2, "a measured and a published row: {table}");
    assert!(rows[1].contains("1092") && rows[1].contains("4.40"), "{table}");
    let output = run(lab(&["paper", "--resolutions", "1"]));
    assert!(output.status.code() == Some(2) && text(&output.stderr).contains("16"), "{}", text(&output.stderr));
}

/// Stand-in for Nsight Compute: it reports one launch with the requested block dimensions.
const NCU: &str = r#"#!/bin/sh
while [ $# -gt 0 ]; do
    case "$1" in --log-file) log=$2 ;; --block) block=$2 ;; esac
    shift
done
echo '"ID","Block Size","Grid Size","Metric Name","Metric Value"' > "$log"
for figure in sm__warps_active.avg.pct_of_peak_sustained_active,40.5 smsp__thread_inst_executed_per_inst_executed.ratio,21.7; do
    echo "\"0\",\"(${block%x*}, ${block#*x}, 1)\",\"(64, 1, 1)\",\"${figure%,*}\",\"${figure#*,}\"" >> "$log"
done
"#;

#[test]
fn paper_reports_a_gpu_and_profiler_counters() {
    let folder = tempfile::tempdir().expect("a folder");
    let (profiler, cache) = (folder.path().join("ncu"), folder.path().join("cache"));
    let arguments = ["paper", "--gpu", "0", "--runs", "1", "--block", "8x8", "--resolutions", "16,17", "--json"];
    let cache = ["--cache", cache.to_str().expect("plain"), "--sdfarm", "sdfarm"];
    let mut path = vec![folder.path().to_owned()];
    path.extend(std::env::split_paths(&std::env::var_os("PATH").expect("there is one")));
    let rows = |script: &str| {
        fs::write(&profiler, script).expect("written");
        fs::set_permissions(&profiler, fs::Permissions::from_mode(0o755)).expect("may be run");
        let mut command = fake_cuda::on_machine_with_gpu(lab(&[&arguments[..], &cache].concat()));
        command.env("PATH", std::env::join_paths(&path).expect("plain"));
        let output = run(command);
        let printed = text(&output.stderr);
        assert!(output.status.success(), "{printed}");
        let table: Value = serde_json::from_slice(&output.stdout).expect("JSON");
        assert_eq!(table["gpu"], "Fake GPU");
        (table["rows"].as_array().expect("rows").clone(), printed)
    };
    let (without, printed) = rows("#!/bin/sh\nexit 9\n");
    assert!(printed.contains("ncu counted nothing") && printed.matches("ncu").count() == 1, "run once: {printed}");
    let (with, _) = rows(NCU);
    assert_eq!((with.len(), without.len()), (2, 2));
    for (with, without) in with.iter().zip(&without) {
        let gpu = &with["gpu"];
        assert!(gpu["kernel_ms"].as_f64().is_some_and(|ms| ms > 0.0) && gpu["registers"] == json!(64), "{gpu}");
        assert_eq!(gpu["theoretical_occupancy_percent"], json!(50.0));
        assert_eq!((&gpu["achieved_occupancy_percent"], &gpu["active_lanes"]), (&json!(40.5), &json!(21.7)));
        assert!(gpu["branch_efficiency_percent"].is_null(), "it was not reported: {gpu}");
        assert!(without["gpu"]["achieved_occupancy_percent"].is_null(), "{without}");
    }
}
