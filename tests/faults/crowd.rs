//! Clients that mean no good, or nothing: thousands that connect and say nothing, and some that speak a letter at a time.
//! Others are served meanwhile.

use std::io::Write;
use std::net::TcpStream;
use std::time::{Duration, Instant};

use crate::jobs;
use crate::support::Farm;

/// Connections that say nothing.
const IDLE: usize = 10_000;
/// Connections that speak slowly.
const SLOW: usize = 200;

fn connect(farm: &Farm) -> Option<TcpStream> {
    TcpStream::connect(farm.address.strip_prefix("http://").expect("an address")).ok()
}

/// A job goes through, and how long a health check took at most.
fn is_served(farm: &Farm, seed: u64) -> Duration {
    let id = farm.accept(&jobs::seeded(&jobs::quick(), seed).to_string());
    let mut slowest = Duration::ZERO;
    for _ in 0..20 {
        let start = Instant::now();
        assert_eq!(farm.get("/livez").status, 200);
        slowest = slowest.max(start.elapsed());
    }
    farm.succeeded(&id);
    slowest
}

#[test]
fn ten_thousand_idle_connections_keep_nobody_out() {
    let farm = Farm::start(&["--workers", "1"]);
    farm.ready(1);
    let idle: Vec<TcpStream> = (0..IDLE).map_while(|_| connect(&farm)).collect();
    if idle.len() < IDLE {
        eprintln!("skipped: {} of {IDLE} idle connections, this machine allows no more", IDLE - idle.len());
    }
    let slowest = is_served(&farm, 1);
    eprintln!("{} idle connections: the slowest health check took {slowest:.1?}", idle.len());
    drop(idle);
    is_served(&farm, 2);
}

#[test]
fn clients_that_speak_a_letter_at_a_time_keep_nobody_out() {
    let farm = Farm::start(&["--workers", "1"]);
    farm.ready(1);
    let mut slow: Vec<TcpStream> = (0..SLOW).filter_map(|_| connect(&farm)).collect();
    let request =
        b"POST /v1/jobs HTTP/1.1\r\nhost: 127.0.0.1\r\ncontent-type: application/json\r\ncontent-length: 9999\r\n\r\n{";
    for (place, letter) in request.iter().enumerate() {
        for connection in &mut slow {
            // One that the server has had enough of is closed.
            let _ = connection.write_all(&[*letter]);
        }
        if place % 40 == 0 {
            is_served(&farm, place as u64);
        }
    }
    is_served(&farm, 9999);
    // Their bodies stop midway: nothing comes of them.
    drop(slow);
    assert!(!farm.log().contains("panicked"), "{}", farm.log());
}
