//! Makes the n-th write fail: there must be no panic, and the job must finish. Every test run uses a few n; long runs
//! use
//! every n, until a run passes without a failure.

use std::path::Path;

use proto::fail_point;
use serde_json::Value;

use crate::faults::remote::Remote;
use crate::jobs;
use crate::support::{Farm, eventually, finish, rendered_here, sdfarm, text};

/// More passes than any job needs.
const MOST: u64 = 400;
const FLAGS: [&str; 4] = ["--tile", "96", "--lease-seconds", "3"];
const POOL: [&str; 2] = ["--workers", "2"];

/// Workers of the farm: pool workers write to the server's folders, remote ones through the server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum By {
    Pool,
    Remotes,
}

impl By {
    fn start(self, command: std::process::Command, folder: &Path) -> (Farm, Option<[Remote; 2]>) {
        let workers = if self == Self::Pool { POOL } else { ["--workers", "0"] };
        let farm = Farm::start_by(command, folder, &[&workers[..], &FLAGS].concat());
        let remotes = (self == Self::Remotes).then(|| Remote::pair(&farm));
        (farm, remotes)
    }
}

fn command(point: &str, pass: u64) -> std::process::Command {
    let mut command = sdfarm(&[fail_point::FLAG, "serve"]);
    command.env(fail_point::ENV_VAR, format!("{point}=error@{pass}"));
    command
}

/// Whether a server starts if its n-th write fails. If not, it must exit with a message.
fn starts(folder: &Path, point: &str, pass: u64) -> bool {
    let data = folder.join("probe");
    let mut probe = command(point, pass);
    probe.args(["--listen", "127.0.0.1:0", "--data"]).arg(&data).args(["--workers", "0"]);
    // Without logs, standard error has only the error message.
    probe.env("SDFARM_LOG", "off");
    let mut child = probe
        .stdin(std::process::Stdio::null())
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut line = String::new();
    let mut out = std::io::BufReader::new(child.stdout.take().expect("piped"));
    std::io::BufRead::read_line(&mut out, &mut line).expect("readable");
    if line.contains("http://") {
        child.kill().expect("a child process");
        child.wait().expect("a child process");
        return true;
    }
    let output = child.wait_with_output().expect("a child process");
    let printed = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{point}@{pass}: {printed}");
    assert!(printed.contains("error: ") && !printed.contains("panicked"), "{point}@{pass}: {printed}");
    false
}

/// Submits a job until it is accepted, and requests its picture until it is stored; each rejection must be a problem.
fn insist(farm: &Farm, job: &Value) -> (String, Vec<u8>) {
    let ask = |method: &str, path: &str, body: &str, status: u16| {
        eventually(path, || {
            let answer = farm.send(method, path, &[("content-type", "application/json")], body.as_bytes().to_vec());
            if answer.status == status {
                return Some(answer);
            }
            let is_passing = answer.status >= 500 || answer.json()["code"] == "picture_not_stored";
            assert!(is_passing, "{} {}\n{}", answer.status, answer.text(), farm.log());
            None
        })
    };
    let id = ask("POST", "/v1/jobs", &job.to_string(), 201).json()["id"].as_str().expect("an id").to_owned();
    let picture = ask("GET", &format!("/v1/jobs/{id}/image"), "", 200).body;
    (id, picture)
}

/// Renders a job while the n-th pass of a point fails; false if there was no such pass.
fn strike(point: &str, pass: u64, job: &Value, by: By, wanted: &[u8]) -> bool {
    let folder = tempfile::tempdir().expect("a folder");
    if pass == 1 && !starts(folder.path(), point, pass) {
        return true;
    }
    let (farm, _remotes) = by.start(command(point, pass), folder.path());
    let (id, picture) = insist(&farm, job);
    assert!(picture == wanted, "{point}@{pass}: other bytes than an undisturbed run's");
    farm.succeeded(&id);
    assert!(farm.terminate().success(), "{point}@{pass}: does not shut down gracefully");
    let log = std::fs::read_to_string(folder.path().join("log")).expect("a log");
    assert!(!log.contains("panicked"), "{point}@{pass}: {log}");
    log.contains(fail_point::LOG_PREFIX)
}

/// Makes each of these passes fail; all of them must occur.
fn strike_at(point: &str, passes: &[u64], job: &Value, by: By) {
    let wanted = rendered_here(job, 0);
    for &pass in passes {
        assert!(strike(point, pass, job, by, &wanted), "{point} is not reached {pass} times");
    }
}

/// Makes every pass fail, one at a time.
fn sweep(point: &str, job: &Value, by: By) {
    let wanted = rendered_here(job, 0);
    let last = (1..MOST).find(|&pass| !strike(point, pass, job, by, &wanted));
    let last = last.unwrap_or_else(|| panic!("{point} never stops failing"));
    eprintln!("{point} by {by:?}: each of {} failed once", last - 1);
    assert!(last > 1, "{point} is never reached");
}

#[test]
fn failed_store_write_is_recovered() {
    strike_at("store_put", &[1, 3], &jobs::many_rays(), By::Pool);
    strike_at("store_put", &[2], &jobs::many_rays(), By::Remotes);
}

#[test]
fn failed_store_read_is_recovered() {
    strike_at("store_get", &[2], &jobs::many_rays(), By::Pool);
    strike_at("store_get", &[1], &jobs::many_rays(), By::Remotes);
}

#[test]
fn failed_database_write_is_recovered() {
    strike_at("database_write", &[1, 4, 7], &jobs::quick(), By::Pool);
    strike_at("database_commit", &[1, 3, 5], &jobs::quick(), By::Pool);
}

#[test]
#[ignore = "long: every write to the store fails once; 60 s"]
fn every_failed_store_write_is_recovered() {
    sweep("store_put", &jobs::many_rays(), By::Pool);
    sweep("store_put", &jobs::many_rays(), By::Remotes);
}

#[test]
#[ignore = "long: every read of the store fails once; 60 s"]
fn every_failed_store_read_is_recovered() {
    sweep("store_get", &jobs::many_rays(), By::Pool);
    sweep("store_get", &jobs::many_rays(), By::Remotes);
}

#[test]
#[ignore = "long: every write to the database fails once; 60 s"]
fn every_failed_database_write_is_recovered() {
    sweep("database_write", &jobs::quick(), By::Pool);
}

#[test]
#[ignore = "long: every commit of the database fails once; 60 s"]
fn every_failed_database_commit_is_recovered() {
    sweep("database_commit", &jobs::quick(), By::Pool);
}

#[test]
fn slow_store_only_delays_a_job() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut command = sdfarm(&[fail_point::FLAG, "serve"]);
    command.env(fail_point::ENV_VAR, "store_put=slow:300,store_get=slow:300");
    let (farm, _) = By::Pool.start(command, folder.path());
    let job = jobs::quick();
    let (id, picture) = insist(&farm, &job);
    assert!(picture == rendered_here(&job, 0));
    farm.succeeded(&id);
    let printed = finish(sdfarm(&["jobs", "--server", &farm.address]), b"");
    assert!(printed.status.success(), "{}", text(&printed.stderr));
}
