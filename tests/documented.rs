//! Runs the shell examples of docs/api.md as they are printed, in order, against a new farm.
//! Only the address of the farm is replaced. The table below must contain every line of an example with its output.

use std::path::Path;
use std::process::Command;

use serde_json::json;

use crate::jobs;
use crate::skip::skip;
use crate::support::{Farm, PROGRAM, clean, finish, root, text};

/// Address of the farm on the page.
const ADDRESS: &str = "http://127.0.0.1:8080";
/// Separates the outputs of two lines.
const MARK: &str = "==== next line ====";

/// Start of each line, and a part of its output.
const LINES: &[(&str, &[&str])] = &[
    ("farm=", &[]),
    ("curl -s --json @job.json -H 'Idempotency-Key: shot-12-take-3'", &["\"state\":\"", "\"frames\":{"]),
    ("gzip -c job.json | curl -s --json @-", &["\"id\":\"", "\"state\":\""]),
    ("curl -s --json @job.json -H 'Prefer: wait=30'", &["\"state\":\"succeeded\""]),
    ("id=$(sdfarm submit job.json --wait --server $farm)", &[]),
    ("curl -s -H 'Prefer: wait=60' \"$farm/v1/jobs/$id\"", &["\"state\":\"succeeded\"", "\"paused\":false"]),
    ("curl -s \"$farm/v1/jobs?match=latest\"", &["\"id\":\"", "\"next_cursor\":null"]),
    ("curl -s \"$farm/v1/jobs?match=1f6e07ab\"", &["\"jobs\":[]"]),
    ("curl -s \"$farm/v1/jobs?match=csg\"", &["\"jobs\":[]"]),
    ("curl -s $farm/v1/jobs/$id/file -o job.json", &[]),
    ("curl -s $farm/v1/jobs/$id/resubmit -X POST", &["\"id\":\"", "\"state\":\""]),
    ("sdfarm resubmit latest --patch", &["-"]),
    ("first=$(sdfarm submit job.json --record --wait", &[]),
    ("sdfarm submit job.json --set 'scene.materials.clay", &[" of 2 tiles are those of "]),
    ("curl -s --json @job.json \"$farm/v1/jobs?based_on=$first\"", &["\"recorded\":true"]),
    ("curl -sN \"$farm/v1/jobs/$id/events\"", &["event: state", "event: frame", "\"state\":\"succeeded\""]),
    ("curl -sN --max-time 1 \"$farm/v1/events\"", &["event: hello", "event: farm"]),
    (
        "curl -s \"$farm/v1/jobs/$id/frames?limit=1000\"",
        &["\"number\":1", "\"state\":\"stored\"", "\"next_cursor\":null"],
    ),
    ("curl -s -o first.png \"$farm/v1/jobs/$id/image\"", &[]),
    ("curl -sOJ \"$farm/v1/jobs/$id/frames.zip\"", &[]),
    ("sdfarm fetch $id -o frames/ --server $farm", &["wrote 2 pictures to frames/"]),
    ("curl -s --json @job.json \"$farm/v1/jobs?webhook=", &["\"id\":\"", "\"state\":\""]),
    ("id=$(sdfarm submit job.json --webhook", &[]),
    ("curl -s \"$farm/v1/jobs/$id/webhooks\"", &["\"deliveries\":["]),
];

/// Files that the examples write.
const FILES: [&str; 5] = ["first.png", "quick.zip", "frames/quick.0000.png", "frames/quick.0001.png", "job.json"];

/// Returns the lines of the page's shell examples.
fn examples() -> Vec<String> {
    let page = std::fs::read_to_string(root().join("docs/api.md")).expect("the page exists");
    let mut lines = Vec::new();
    let mut is_shell = false;
    for line in page.lines() {
        if line.starts_with("```") {
            is_shell = line == "```sh";
        } else if is_shell {
            lines.push(line.to_owned());
        }
    }
    lines
}

/// Creates a shell that runs the program under test as `sdfarm`, in a folder with `job.json`.
fn shell(folder: &Path) -> Command {
    let programs = folder.join("bin");
    std::fs::create_dir_all(&programs).expect("a folder");
    std::os::unix::fs::symlink(PROGRAM, programs.join("sdfarm")).expect("a link");
    let path = std::env::var_os("PATH").unwrap_or_default();
    let path = std::env::join_paths([programs].into_iter().chain(std::env::split_paths(&path))).expect("plain paths");
    let mut command = Command::new("bash");
    clean(&mut command).env("PATH", path).current_dir(folder);
    command
}

#[test]
fn examples_of_the_api_page_print_the_documented_output() {
    let curl = Command::new("curl").arg("--version").output().ok().map(|output| text(&output.stdout));
    let Some(minor) = curl.as_ref().and_then(|said| said.split(['.', ' ']).nth(2)?.parse::<u32>().ok()) else {
        return skip("curl", "curl is not installed; the examples of docs/api.md are not run");
    };
    if minor < 82 && curl.is_some_and(|said| said.starts_with("curl 7.")) {
        return skip("curl-json", "this curl has no --json; the examples of docs/api.md are not run");
    }
    let farm = Farm::start(&["--workers", "1"]);
    let folder = tempfile::tempdir().expect("a folder");
    let mut job = jobs::quick();
    job["name"] = json!("quick");
    job["frames"] = json!({ "count": 2 });
    std::fs::write(folder.path().join("job.json"), job.to_string()).expect("written");

    let lines = examples();
    // A rejected request ends the script and prints the problem.
    let mut script = "set -eo pipefail\ncurl() { command curl --fail-with-body \"$@\"; }\n".to_owned();
    for line in &lines {
        script += &line.replace(ADDRESS, &farm.address);
        script += "\necho; echo '";
        script += MARK;
        script += "'\n";
    }
    let output = finish(
        {
            let mut command = shell(folder.path());
            command.args(["-c", &format!("exec 2>&1\n{script}")]);
            command
        },
        b"",
    );
    let printed = text(&output.stdout);
    assert!(output.status.success(), "{printed}\n{}", farm.log());
    let printed: Vec<&str> = printed.split(MARK).collect();
    assert_eq!(printed.len(), lines.len() + 1, "{printed:?}");
    for (line, printed) in lines.iter().zip(printed) {
        let (_, wanted) = LINES
            .iter()
            .find(|(start, _)| line.starts_with(start))
            .unwrap_or_else(|| panic!("the table has no output for this line of docs/api.md: {line}"));
        for wanted in *wanted {
            assert!(printed.contains(wanted), "{line}\nprints no {wanted}:\n{printed}");
        }
    }
    for (start, _) in LINES {
        assert!(lines.iter().any(|line| line.starts_with(start)), "docs/api.md has no example that begins {start}");
    }
    for name in FILES {
        assert!(folder.path().join(name).is_file(), "{name} was not saved");
    }
    let first = std::fs::read(folder.path().join("first.png")).expect("saved");
    assert!(first == std::fs::read(folder.path().join("frames/quick.0000.png")).expect("saved"));
}
