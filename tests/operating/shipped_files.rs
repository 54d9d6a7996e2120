//! Tests the files shipped for operators (alerts, board, units): the names in them exist and are documented.

use std::collections::BTreeSet;
use std::fs;
use std::process::Command;

use serde_json::Value;

use crate::skip::skip;
use crate::support::{PROGRAM, root, text};

fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Metrics in `docs/operations.md`, as Prometheus stores them; a test of the server compares that list with the code.
fn metrics() -> BTreeSet<String> {
    let page = read("docs/operations.md");
    let mut names = BTreeSet::new();
    for line in page.lines() {
        let cells: Vec<&str> = line.strip_prefix("| `").map(|line| line.split(" | ").collect()).unwrap_or_default();
        let [name, kind, ..] = cells[..] else { continue };
        let name = name.split(['`', '{']).next().expect("a name").to_owned();
        match kind {
            "histogram" => names.extend(["bucket", "sum", "count"].map(|part| format!("{name}_{part}"))),
            "counter" | "gauge" | "info" => drop(names.insert(name)),
            _ => {}
        }
    }
    assert!(names.len() > 30, "{names:?}");
    names
}

/// Metrics in an expression.
fn asked(expression: &str) -> impl Iterator<Item = &str> {
    let words = expression.split(|letter: char| !letter.is_ascii_alphanumeric() && letter != '_');
    words.filter(|word| word.starts_with("sdfarm_") || word.starts_with("process_"))
}

#[test]
fn alerts_use_known_metrics_and_have_runbooks_and_tests() {
    let (rules, tests, page) =
        (read("docker/prometheus/alerts.yml"), read("docker/prometheus/alerts_test.yml"), read("docs/operations.md"));
    let (known, mut names) = (metrics(), Vec::new());
    for line in rules.lines() {
        let unknown: Vec<&str> = asked(line).filter(|name| !known.contains(*name)).collect();
        assert!(unknown.is_empty(), "{unknown:?} in {line}");
        names.extend(line.trim().strip_prefix("- alert: ").map(str::to_owned));
    }
    assert!(names.len() >= 20, "{names:?}");
    for name in names {
        assert!(page.contains(&format!("\n### {name}\n")), "docs/operations.md has no runbook for {name}");
        let fires = format!("alertname: {name}\n");
        assert!(tests.contains(&fires), "no test sees {name} fire");
    }
}

#[test]
fn board_uses_known_metrics() {
    let board: Value = serde_json::from_str(&read("docker/grafana/sdfarm.json")).expect("JSON");
    let known = metrics();
    let (mut ids, mut shown) = (BTreeSet::new(), BTreeSet::new());
    for panel in board["panels"].as_array().expect("panels") {
        assert!(ids.insert(panel["id"].as_u64().expect("an id")), "{panel}");
        let place = &panel["gridPos"];
        let end = place["x"].as_u64().expect("a place") + place["w"].as_u64().expect("a width");
        assert!(end <= 24, "{} is wider than the board", panel["title"]);
        if panel["type"] == "row" {
            continue;
        }
        for target in panel["targets"].as_array().expect("targets") {
            let expression = target["expr"].as_str().expect("an expression");
            let names: Vec<&str> = asked(expression).collect();
            for name in &names {
                assert!(known.contains(*name), "{name} in {expression}");
                shown.insert((*name).to_owned());
            }
            assert!(!names.is_empty() || expression.starts_with("up{"), "{expression}");
        }
    }
    let base = |name: &str| {
        ["_bucket", "_sum", "_count"].iter().find_map(|part| name.strip_suffix(part)).unwrap_or(name).to_owned()
    };
    let shown: BTreeSet<String> = shown.iter().map(|name| base(name)).collect();
    let hidden: Vec<String> = known.iter().map(|name| base(name)).filter(|name| !shown.contains(name)).collect();
    assert!(hidden.is_empty(), "the board does not show {hidden:?}");
}

#[test]
fn systemd_accepts_the_units() {
    if Command::new("systemd-analyze").arg("--version").output().is_err() {
        return skip("systemd", "systemd-analyze is not installed; the units are not checked");
    }
    let folder = tempfile::tempdir().expect("a folder");
    for unit in ["sdfarm.service", "sdfarm-worker.service"] {
        let own = read(&format!("docker/systemd/{unit}")).replace("/usr/local/bin/sdfarm", PROGRAM);
        let path = folder.path().join(unit);
        fs::write(&path, own).expect("writes");
        let output = Command::new("systemd-analyze").arg("verify").arg("--man=no").arg(&path).output().expect("runs");
        let said = text(&output.stderr);
        assert!(output.status.success() && !said.contains(unit), "{said}");
    }
}
