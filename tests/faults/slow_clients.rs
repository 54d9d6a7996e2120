//! Clients that speak a letter at a time: others are served meanwhile. (Thousands that say nothing are in `admission.rs`.)

use std::io::Write;
use std::net::TcpStream;

use crate::jobs;
use crate::support::Farm;

/// Connections that speak slowly.
const SLOW: usize = 200;

fn connect(farm: &Farm) -> Option<TcpStream> {
    TcpStream::connect(farm.address.strip_prefix("http://").expect("an address")).ok()
}

/// A job goes through, and health checks answer.
fn assert_served(farm: &Farm, seed: u64) {
    let id = farm.accept(&jobs::seeded(&jobs::quick(), seed).to_string());
    for _ in 0..20 {
        assert_eq!(farm.get("/livez").status, 200);
    }
    farm.succeeded(&id);
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
            assert_served(&farm, place as u64);
        }
    }
    assert_served(&farm, 9999);
    // Their bodies stop midway: nothing comes of them.
    drop(slow);
    assert!(!farm.log().contains("panicked"), "{}", farm.log());
}
