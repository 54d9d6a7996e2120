//! Kills workers and the server with `kill -9` at random instants and at fail points: nothing is lost, and every
//! picture is identical to an undisturbed render.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::Parser;
use lab::Lab;
use rustix::process::Signal;

use crate::seaweedfs::SeaweedFs;
use crate::slow_network::SlowNetwork;
use crate::support::{DEADLINE, Farm, PROGRAM, eventually, rendered_here, send_signal};
use crate::{jobs, postgres_server};

/// Table of a soak with these flags, which must find no violation.
fn soaked(store: Option<&SeaweedFs>, flags: &[&str]) -> String {
    let program = ["sdfarm-lab", "--sdfarm", PROGRAM, "soak", "--kill"];
    let lab = Lab::try_parse_from(program.iter().chain(flags)).expect("valid flags");
    let lab = lab.with_environment(store.map(SeaweedFs::environment).into_iter().flatten());
    let runtime = tokio::runtime::Runtime::new().expect("threads start");
    let ended = runtime.block_on(async { tokio::time::timeout(DEADLINE, lab.run()).await });
    let table = ended.expect("it ends in time").expect("no violation is found");
    eprintln!("{table}");
    table
}

/// Asserts that a soak with these flags finds no violation.
fn assert_soaked(flags: &[&str]) {
    let table = soaked(None, &[&["--workers", "3"][..], flags].concat());
    for row in ["workers killed", "server killed", "violations"] {
        assert!(table.lines().any(|line| line.starts_with(row)), "{table}");
    }
}

#[test]
fn soak_with_a_few_kills_finds_no_violation() {
    assert_soaked(&["--worker-kills", "6", "--server-kills", "3"]);
}

#[test]
#[ignore = "long: 100 kills of workers and 30 of servers; 2 min"]
fn soak_with_130_kills_finds_no_violation() {
    assert_soaked(&["--worker-kills", "100", "--server-kills", "30"]);
}

/// Soaks a farm on PostgreSQL while all its connections are cut every now and then.
fn soak_on_postgresql(worker_kills: &str, server_kills: &str) {
    if postgres_server::required().is_none() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let database = postgres_server::database_of(&data).expect("a database");
    let kills = ["--worker-kills", worker_kills, "--server-kills", server_kills];
    let cut = std::thread::scope(|scope| {
        let soak = scope.spawn(|| {
            assert_soaked(&[&kills[..], &["--database", &database, "--data", data.to_str().expect("plain")]].concat());
        });
        let mut cut = 0;
        for round in 0_u64.. {
            std::thread::sleep(Duration::from_millis(300 + round * 137 % 900));
            if soak.is_finished() {
                break;
            }
            cut += postgres_server::cut_connections(&database);
        }
        soak.join().expect("no violation is found");
        cut
    });
    eprintln!("{cut} connections to the database were cut");
    assert!(cut > 0);
}

#[test]
fn soak_on_postgresql_with_a_few_kills_and_cut_connections_finds_no_violation() {
    soak_on_postgresql("6", "3");
}

#[test]
#[ignore = "long: 100 kills of workers and 30 of servers, and cut connections; 2 min"]
fn soak_on_postgresql_with_130_kills_and_cut_connections_finds_no_violation() {
    soak_on_postgresql("100", "30");
}

/// Soaks a farm of three servers on PostgreSQL and S3, whose servers hear only half of what the others tell, over a slow
/// network, while all connections to the database are cut every now and then.
fn soak_three_servers(worker_kills: &str, server_kills: &str, workers: &str) {
    if postgres_server::required().is_none() {
        return;
    }
    let Some(store) = SeaweedFs::start() else { return };
    store.make_bucket("soak");
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("farm");
    let database = postgres_server::database_of(&data).expect("a database");
    let network = SlowNetwork::to(&database, Duration::from_millis(100));
    let (data, seen) = (data.to_str().expect("plain").to_owned(), AtomicBool::new(false));
    let flags = [
        ["--servers", "3", "--workers", workers],
        ["--data", &data, "--store", "s3://soak/farm"],
        ["--worker-kills", worker_kills, "--server-kills", server_kills],
    ];
    let flags = [&flags.concat()[..], &["--database", network.address()]].concat();
    let (table, cut) = std::thread::scope(|scope| {
        let cutter = scope.spawn(|| {
            let mut cut = 0;
            for round in 0_u64.. {
                std::thread::sleep(Duration::from_millis(500 + round * 137 % 900));
                if seen.load(Ordering::Relaxed) {
                    break;
                }
                cut += postgres_server::cut_connections(&database);
            }
            cut
        });
        let soak = scope.spawn(|| soaked(Some(&store), &flags)).join();
        seen.store(true, Ordering::Relaxed);
        (soak.expect("no violation is found"), cutter.join().expect("no panic"))
    });
    eprintln!("{cut} connections to the database were cut");
    assert!(cut > 0 && table.contains("events followed from server to server"), "{table}");
}

#[test]
fn soak_of_three_servers_with_a_few_kills_finds_no_violation() {
    soak_three_servers("6", "4", "3");
}

#[test]
#[ignore = "long: 200 kills of ten workers and 100 of three servers, and cut connections; 5 min"]
fn soak_of_three_servers_with_300_kills_finds_no_violation() {
    soak_three_servers("200", "100", "10");
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
