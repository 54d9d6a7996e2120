//! Tests that clients that send one byte at a time, or do not read, do not block others and cost little memory.
//! (Idle connections: `access_control.rs`.)

use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;

use crate::jobs;
use crate::support::{Farm, eventually};

/// Number of slow connections.
const SLOW: usize = 200;

fn connect(farm: &Farm) -> Option<TcpStream> {
    TcpStream::connect(farm.address.strip_prefix("http://").expect("an address")).ok()
}

/// Asserts that a job is rendered, and health checks respond.
fn assert_served(farm: &Farm, seed: u64) {
    let id = farm.accept(&jobs::seeded(&jobs::quick(), seed).to_string());
    for _ in 0..20 {
        assert_eq!(farm.get("/livez").status, 200);
    }
    farm.succeeded(&id);
}

#[test]
fn slow_clients_do_not_block_others() {
    let farm = Farm::start(&["--workers", "1"]);
    farm.ready(1);
    let mut slow: Vec<TcpStream> = (0..SLOW).filter_map(|_| connect(&farm)).collect();
    let request =
        b"POST /v1/jobs HTTP/1.1\r\nhost: 127.0.0.1\r\ncontent-type: application/json\r\ncontent-length: 9999\r\n\r\n{";
    for (place, letter) in request.iter().enumerate() {
        for connection in &mut slow {
            // The server closes connections that are too slow.
            let _ = connection.write_all(&[*letter]);
        }
        if place % 40 == 0 {
            assert_served(&farm, place as u64);
        }
    }
    assert_served(&farm, 9999);
    // Their bodies are incomplete, so they create no jobs.
    drop(slow);
    assert!(!farm.log().contains("panicked"), "{}", farm.log());
}

/// Maximum memory of a connection whose client does not read.
const READER_BYTES: u64 = 128 << 10;
/// Maximum memory of unfinished bodies together.
const BODIES_BYTES: u64 = 256 << 20;

/// Resident memory of the server's process.
fn resident_bytes(farm: &Farm) -> u64 {
    let status = fs::read_to_string(format!("/proc/{}/status", farm.process())).expect("it runs");
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).expect("Linux reports it");
    let kib: u64 = line.trim().trim_end_matches(" kB").parse().expect("a number");
    kib << 10
}

/// Resident memory when it grows no more.
fn settled_bytes(farm: &Farm) -> u64 {
    let mut last = 0;
    let mut same = 0;
    eventually("the memory grows no more", || {
        let now = resident_bytes(farm);
        same = if now == last { same + 1 } else { 0 };
        last = now;
        (same >= 50).then_some(now)
    })
}

fn assert_readers_cost_little(readers: u64) {
    let farm = Farm::start(&["--workers", "1", "--max-requests-per-caller", "4096"]);
    farm.ready(1);
    let id = farm.accept(&jobs::as_exr(&jobs::sized(&jobs::named("csg"), 512, 1)).to_string());
    farm.succeeded(&id);
    assert!(farm.picture(&id).len() > 1 << 20, "the picture is larger than what sockets buffer");
    farm.set_pool(0);
    let before_bytes = settled_bytes(&farm);
    let request = format!("GET /v1/jobs/{id}/image HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\n");
    let connections: Vec<TcpStream> = (0..readers)
        .map(|_| {
            let mut connection = connect(&farm).expect("a place");
            connection.write_all(request.as_bytes()).expect("written");
            let mut start = [0; 12];
            connection.read_exact(&mut start).expect("a response");
            assert_eq!(&start, b"HTTP/1.1 200");
            connection
        })
        .collect();
    let grown_bytes = settled_bytes(&farm).saturating_sub(before_bytes);
    eprintln!("{readers} readers that do not read cost {} KiB each", (grown_bytes / readers) >> 10);
    assert!(grown_bytes <= readers * READER_BYTES, "{} KiB each", (grown_bytes / readers) >> 10);
    assert_eq!(farm.get("/livez").status, 200);
    drop(connections);
}

#[test]
fn a_client_that_does_not_read_costs_little_memory() {
    assert_readers_cost_little(200);
}

#[test]
#[ignore = "long: 1,000 readers of one picture; 10 s"]
fn a_thousand_clients_that_do_not_read_cost_little_memory() {
    assert_readers_cost_little(1000);
}

#[test]
#[ignore = "long: 60 bodies of 32 MiB; 20 s"]
fn unfinished_bodies_cost_a_bounded_amount_of_memory() {
    let farm = Farm::start(&["--workers", "0"]);
    let body = vec![b' '; (32 << 20) - 1];
    let before_bytes = settled_bytes(&farm);
    let head =
        b"POST /v1/jobs HTTP/1.1\r\nhost: 127.0.0.1\r\ncontent-type: application/json\r\ncontent-length: 33554432\r\n\r\n";
    let unfinished: Vec<TcpStream> = (0..60)
        .map(|_| {
            let mut connection = connect(&farm).expect("a place");
            connection.write_all(head).expect("written");
            connection.write_all(&body).expect("written");
            connection
        })
        .collect();
    let grown_bytes = settled_bytes(&farm).saturating_sub(before_bytes);
    eprintln!("{} unfinished bodies cost {} MiB", unfinished.len(), grown_bytes >> 20);
    assert!(grown_bytes <= BODIES_BYTES, "{} MiB", grown_bytes >> 20);
    assert_eq!(farm.get("/livez").status, 200);
    farm.accept(&jobs::quick().to_string());
}
