//! The n-th write fails, for every n until a run passes without a failure: no panic, and the job ends as it should.

use std::path::Path;
use std::time::{Duration, Instant};

use proto::fail;
use serde_json::Value;

use crate::faults::remote::Remote;
use crate::jobs;
use crate::support::{DEADLINE, Farm, finish, rendered_here, sdfarm, text};

/// No job writes so often.
const MOST: u64 = 400;
const FLAGS: [&str; 4] = ["--tile", "96", "--lease-seconds", "3"];
/// A job has ended by then, whatever failed.
const TWO_LEASES: Duration = Duration::from_secs(6);
const POOL: [&str; 2] = ["--workers", "2"];

/// Who renders: the pool's workers write to the server's folders, others through the server.
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
    let mut command = sdfarm(&[fail::FLAG, "serve"]);
    command.env(fail::VARIABLE, format!("{point}=error@{pass}"));
    command
}

/// Whether a server can be started whose n-th write fails. One that can't says why, in order.
fn starts(folder: &Path, point: &str, pass: u64) -> bool {
    let data = folder.join("probe");
    let mut probe = command(point, pass);
    probe.args(["--listen", "127.0.0.1:0", "--data"]).arg(&data).args(["--workers", "0"]);
    // Ends at once where it serves: its standard output is not what is looked at.
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
        child.kill().expect("a child of ours");
        child.wait().expect("a child of ours");
        return true;
    }
    let output = child.wait_with_output().expect("a child of ours");
    let told = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{point}@{pass}: {told}");
    assert!(told.contains("error: ") && !told.contains("panicked"), "{point}@{pass}: {told}");
    false
}

/// Hands in a job until it is taken, and asks for its picture until it is there; each refusal is a problem.
fn insist(farm: &Farm, job: &Value) -> (String, Vec<u8>) {
    let start = Instant::now();
    let ask = |method: &str, path: &str, body: &str, status: u16| loop {
        let answer = farm.send(method, path, &[("content-type", "application/json")], body.as_bytes().to_vec());
        if answer.status == status {
            return answer;
        }
        let is_passing = answer.status >= 500 || answer.json()["code"] == "picture_not_stored";
        assert!(is_passing && start.elapsed() < DEADLINE, "{} {}\n{}", answer.status, answer.text(), farm.log());
        std::thread::sleep(Duration::from_millis(5));
    };
    let id = ask("POST", "/v1/jobs", &job.to_string(), 201).json()["id"].as_str().expect("an id").to_owned();
    let picture = ask("GET", &format!("/v1/jobs/{id}/image"), "", 200).body;
    (id, picture)
}

fn sweep(point: &str, job: &Value, by: By) {
    let wanted = rendered_here(job, 0);
    let mut slowest = Duration::ZERO;
    for pass in 1..MOST {
        let folder = tempfile::tempdir().expect("a folder");
        if pass == 1 && !starts(folder.path(), point, pass) {
            continue;
        }
        let (farm, _remotes) = by.start(command(point, pass), folder.path());
        let start = Instant::now();
        let (id, picture) = insist(&farm, job);
        assert!(picture == wanted, "{point}@{pass}: other bytes than an undisturbed run's");
        farm.succeeded(&id);
        slowest = slowest.max(start.elapsed());
        assert!(slowest <= TWO_LEASES, "{point}@{pass} by {by:?}: it took {slowest:?}\n{}", farm.log());
        assert!(farm.terminate().success(), "{point}@{pass}: does not end in order");
        let log = std::fs::read_to_string(folder.path().join("log")).expect("a log");
        assert!(!log.contains("panicked"), "{point}@{pass}: {log}");
        let has_struck = log.contains(fail::MARK);
        if !has_struck {
            eprintln!("{point} by {by:?}: each of {} failed once; the slowest job took {slowest:?}", pass - 1);
            assert!(pass > 1, "{point} is never passed");
            return;
        }
    }
    panic!("{point} strikes on and on");
}

#[test]
fn every_write_to_the_store_may_fail_once() {
    sweep("store_put", &jobs::many_rays(), By::Pool);
    sweep("store_put", &jobs::many_rays(), By::Remotes);
}

#[test]
fn every_read_of_the_store_may_fail_once() {
    sweep("store_get", &jobs::many_rays(), By::Pool);
    sweep("store_get", &jobs::many_rays(), By::Remotes);
}

#[test]
fn every_write_to_the_database_may_fail_once() {
    sweep("database_write", &jobs::quick(), By::Pool);
}

#[test]
fn every_commit_of_the_database_may_fail_once() {
    sweep("database_commit", &jobs::quick(), By::Pool);
}

#[test]
fn slow_store_delays_a_job_and_no_more() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut command = sdfarm(&[fail::FLAG, "serve"]);
    command.env(fail::VARIABLE, "store_put=slow:300,store_get=slow:300");
    let (farm, _) = By::Pool.start(command, folder.path());
    let job = jobs::quick();
    let (id, picture) = insist(&farm, &job);
    assert!(picture == rendered_here(&job, 0));
    farm.succeeded(&id);
    let told = finish(sdfarm(&["jobs", "--server", &farm.address]), b"");
    assert!(told.status.success(), "{}", text(&told.stderr));
}
