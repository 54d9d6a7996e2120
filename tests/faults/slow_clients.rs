//! Tests that clients that send one byte at a time do not block others. (Idle connections: `access_control.rs`.)

use std::io::Write;
use std::net::TcpStream;

use crate::jobs;
use crate::support::Farm;

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
