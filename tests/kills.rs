//! Kills workers and the server with `kill -9` at random instants and at fail points: nothing is lost, and every
//! picture is identical to an undisturbed render.

use rustix::process::Signal;

use crate::jobs;
use crate::support::{Farm, eventually, finish, rendered_here, sdfarm, send_signal, text};

/// Asserts that a soak with these numbers of kills finds no violation.
fn assert_soaked(worker_kills: &str, server_kills: &str) {
    let kills = ["--worker-kills", worker_kills, "--server-kills", server_kills];
    let output = finish(sdfarm(&[&["soak", "--kill", "--workers", "3"][..], &kills].concat()), b"");
    let (table, told) = (text(&output.stdout), text(&output.stderr));
    assert!(output.status.success(), "{table}\n{told}");
    eprintln!("{table}");
    for row in ["workers killed", "server killed", "violations"] {
        assert!(table.lines().any(|line| line.starts_with(row)), "{table}");
    }
}

#[test]
fn soak_with_a_few_kills_finds_no_violation() {
    assert_soaked("6", "3");
}

#[test]
#[ignore = "long: 100 kills of workers and 30 of servers; 2 min"]
fn soak_with_130_kills_finds_no_violation() {
    assert_soaked("100", "30");
}

#[test]
fn soak_with_contradictory_flags_is_rejected() {
    let output = finish(sdfarm(&["soak", "--minutes", "1", "--workers", "1", "--worker-kills", "1"]), b"");
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
}

#[test]
fn terminated_worker_releases_its_tiles_and_the_job_finishes() {
    let farm = Farm::start(&["--workers", "2", "--tile", "64", "--lease-seconds", "3600"]);
    farm.ready(2);
    let job = jobs::as_png(&jobs::sized(&jobs::named("csg"), 640, 40));
    let id = farm.accept(&job.to_string());
    eventually("it runs", || (farm.get(&format!("/v1/jobs/{id}")).json()["state"] == "running").then_some(()));
    send_signal(farm.workers()[0], Signal::TERM);
    farm.succeeded(&id);
    assert!(farm.picture(&id) == rendered_here(&job, 0));
}
