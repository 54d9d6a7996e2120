//! Thousands of each cheap thing, and connections that are slow on purpose.

use std::io::Write;
use std::net::TcpListener;

use serde_json::{Value, json};

use super::{Attack, Attacker, ball};
use crate::jobs;

/// Bytes of a body that is sent slowly.
const SLOW_BODY_BYTES: usize = 32 << 20;

pub(super) fn attacks() -> Vec<Attack> {
    vec![
        Attack { name: "unauthenticated requests to random paths", run: random_paths },
        Attack { name: "wrong keys", run: wrong_keys },
        Attack { name: "event streams of one job", run: event_streams },
        Attack { name: "event streams that start at any event", run: event_positions },
        Attack { name: "slow readers of one picture", run: slow_readers },
        Attack { name: "large bodies, sent slowly", run: slow_bodies },
        Attack { name: "bodies that are promised and never sent", run: empty_bodies },
        Attack { name: "connections that send nothing", run: |attacker| attacker.hold(4000, b"") },
        Attack { name: "heads that never end", run: |attacker| attacker.hold(2000, b"GET /v1/jobs HTTP/1.1\r\nx: ") },
        Attack { name: "heads of many lines", run: long_heads },
        Attack { name: "many requests on one connection at once", run: pipelines },
        Attack { name: "large dry runs", run: dry_runs },
        Attack { name: "tiny jobs", run: tiny_jobs },
        Attack { name: "tiny jobs under one idempotency key", run: one_idempotency_key },
        Attack { name: "paused jobs", run: paused_jobs },
        Attack { name: "jobs of high priority", run: urgent_jobs },
        Attack { name: "jobs with webhooks to an address that never answers", run: webhooks },
        Attack { name: "jobs of 100,000 frames, cancelled and deleted", run: long_jobs },
        Attack { name: "pause, resume, priority and retry of one job", run: changes },
        Attack { name: "resubmissions of one job", run: resubmissions },
        Attack { name: "previews and thumbnails of many sizes", run: previews },
        Attack { name: "archives and ranges of one picture", run: ranges },
        Attack { name: "searches and pages of the list of jobs", run: searches },
        Attack { name: "signed links", run: links },
        Attack { name: "names with control characters", run: control_characters },
    ]
}

fn seeded_ball(seed: u64) -> Value {
    jobs::seeded(&ball(), seed)
}

/// A job of the attacker whose picture is stored.
fn finished(attacker: &Attacker<'_>) -> Option<String> {
    let id = attacker.submit(&ball())?;
    while attacker.goes_on() {
        let job = attacker.send("GET", &format!("/v1/jobs/{id}"), "")?;
        if job.json()["state"] == "succeeded" {
            return Some(id);
        }
    }
    None
}

fn random_paths(attacker: &Attacker<'_>) {
    attacker.flood(8, |number| {
        attacker.send_as("", "GET", &format!("/v1/{number:x}/{}", number.wrapping_mul(0x9e37_79b9)), "");
    });
}

fn wrong_keys(attacker: &Attacker<'_>) {
    attacker.flood(8, |number| {
        attacker.send_as(&format!("Bearer sdf_{number:064x}"), "GET", "/v1/jobs", "");
    });
}

fn event_streams(attacker: &Attacker<'_>) {
    let Some(id) = attacker.submit(&ball()) else { return };
    attacker.hold(4000, format!("{}\r\n", attacker.head("GET", &format!("/v1/jobs/{id}/events"))).as_bytes());
}

fn event_positions(attacker: &Attacker<'_>) {
    let Some(id) = attacker.submit(&ball()) else { return };
    attacker.flood(4, |number| {
        let position = ["0", "-1", "9223372036854775807", "18446744073709551616", "x", ""][number as usize % 6];
        let head = attacker.head("GET", &format!("/v1/jobs/{id}/events"));
        drop(attacker.connect(format!("{head}last-event-id: {position}\r\n\r\n").as_bytes()));
    });
}

fn slow_readers(attacker: &Attacker<'_>) {
    let large = json!({ "scene": ball()["scene"], "image": { "width": 1200, "height": 1200, "samples": 1,
        "format": "exr", "precision": "float" } });
    let Some(id) = attacker.submit(&large) else { return };
    attacker.hold(2000, format!("{}\r\n", attacker.head("GET", &format!("/v1/jobs/{id}/image"))).as_bytes());
}

fn slow_bodies(attacker: &Attacker<'_>) {
    let head = attacker.head("POST", "/v1/jobs");
    let head = format!("{head}content-type: application/json\r\ncontent-length: {SLOW_BODY_BYTES}\r\n\r\n");
    let piece = vec![b' '; 64 << 10];
    let mut open: Vec<_> = (0..250).map_while(|_| attacker.connect(head.as_bytes())).collect();
    for _ in 0..SLOW_BODY_BYTES / piece.len() - 1 {
        if !attacker.goes_on() {
            break;
        }
        // A connection that the server has closed can't be written to.
        open.retain_mut(|connection| connection.write_all(&piece).is_ok());
    }
    while attacker.goes_on() {
        open.retain_mut(|connection| connection.write_all(b" ").is_ok());
        std::thread::sleep(super::PAUSE);
    }
}

fn empty_bodies(attacker: &Attacker<'_>) {
    let head = attacker.head("POST", "/v1/jobs");
    attacker.hold(2000, format!("{head}content-type: application/json\r\ncontent-length: 32000000\r\n\r\n").as_bytes());
}

fn long_heads(attacker: &Attacker<'_>) {
    let line = format!("x-long: {}\r\n", "a".repeat(8 << 10));
    attacker.flood(4, |number| {
        let lines = line.repeat(1 + number as usize % 64);
        drop(attacker.connect(format!("{}{lines}\r\n", attacker.head("GET", "/v1/jobs")).as_bytes()));
    });
}

fn pipelines(attacker: &Attacker<'_>) {
    let requests = format!("{}\r\n", attacker.head("GET", "/v1/jobs?limit=1000")).repeat(200);
    attacker.flood(4, |_| drop(attacker.connect(requests.as_bytes())));
}

/// Text of a job with this many nodes.
fn many_nodes(count: usize) -> String {
    let sphere = |number: usize| {
        let [x, y, z] = [number % 100, number / 100 % 100, number / 10_000];
        format!(r#"{{"translate":{{"by":[{x},{y},{z}],"child":{{"sphere":{{"radius":0.3}}}}}}}}"#)
    };
    let mut job = ball();
    job["scene"]["objects"][0]["shape"] = json!({ "union": { "smooth": 0.1, "of": "SPHERES" } });
    let spheres: Vec<String> = (0..count / 2).map(sphere).collect();
    job.to_string().replacen("\"SPHERES\"", &format!("[{}]", spheres.join(",")), 1)
}

fn dry_runs(attacker: &Attacker<'_>) {
    let text = many_nodes(900_000);
    attacker.flood(30, |_| drop(attacker.send("POST", "/v1/jobs?dry_run=true", text.clone())));
}

fn tiny_jobs(attacker: &Attacker<'_>) {
    attacker.flood(8, |number| drop(attacker.submit(&seeded_ball(number))));
}

fn one_idempotency_key(attacker: &Attacker<'_>) {
    attacker.flood(8, |number| {
        let headers = [("authorization", attacker.submitter.as_str()), ("idempotency-key", "same")];
        let body = seeded_ball(number % 3).to_string().into_bytes();
        attacker.sent.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        drop(attacker.farm.try_send("POST", "/v1/jobs", &headers, body));
    });
}

fn paused_jobs(attacker: &Attacker<'_>) {
    attacker.flood(8, |number| {
        if let Some(id) = attacker.submit(&seeded_ball(number)) {
            attacker.send("POST", &format!("/v1/jobs/{id}/pause"), "");
        }
    });
}

fn urgent_jobs(attacker: &Attacker<'_>) {
    attacker.flood(4, |number| {
        let mut job = jobs::seeded(&jobs::endless(), number);
        job["priority"] = json!(100);
        attacker.submit(&job);
    });
}

fn webhooks(attacker: &Attacker<'_>) {
    // It accepts connections, and never reads from them.
    let silent = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = silent.local_addr().expect("it is bound");
    attacker.flood(4, |number| {
        let path = format!("/v1/jobs?webhook=http://{address}/{number}");
        attacker.send("POST", &path, seeded_ball(number).to_string());
    });
}

fn long_jobs(attacker: &Attacker<'_>) {
    attacker.flood(2, |number| {
        let mut job = seeded_ball(number);
        job["frames"] = json!({ "count": 100_000 });
        let Some(id) = attacker.submit(&job) else { return };
        attacker.send("POST", &format!("/v1/jobs/{id}/cancel"), "");
        attacker.send("DELETE", &format!("/v1/jobs/{id}"), "");
    });
}

fn changes(attacker: &Attacker<'_>) {
    let Some(id) = attacker.submit(&jobs::endless()) else { return };
    attacker.flood(8, |number| {
        let path = |what: &str| format!("/v1/jobs/{id}{what}");
        match number % 4 {
            0 => attacker.send("POST", &path("/pause"), ""),
            1 => attacker.send("POST", &path("/resume"), ""),
            2 => attacker.send("PATCH", &path(""), r#"{ "priority": -100 }"#),
            _ => attacker.send("POST", &path("/retry"), ""),
        };
    });
    attacker.send("POST", &format!("/v1/jobs/{id}/cancel"), "");
}

fn resubmissions(attacker: &Attacker<'_>) {
    let Some(id) = attacker.submit(&ball()) else { return };
    attacker.flood(8, |number| {
        let patch = json!({ "image": { "seed": number } }).to_string();
        attacker.send("POST", &format!("/v1/jobs/{id}/resubmit"), patch);
    });
}

fn previews(attacker: &Attacker<'_>) {
    // Paused, so that only its previews compete with the other user's job.
    let Some(id) = attacker.submit(&jobs::endless()) else { return };
    attacker.send("POST", &format!("/v1/jobs/{id}/pause"), "");
    attacker.flood(40, |number| {
        let kind = if number % 4 == 0 { "thumbnail" } else { "preview" };
        attacker.send("GET", &format!("/v1/jobs/{id}/frames/0/{kind}?width={}", 16 + number % 1000), "");
    });
    attacker.send("POST", &format!("/v1/jobs/{id}/cancel"), "");
}

fn ranges(attacker: &Attacker<'_>) {
    let Some(id) = finished(attacker) else { return };
    attacker.flood(8, |number| {
        let what = if number % 2 == 0 { "image" } else { "frames.zip" };
        let range = ["bytes=0-0,1-1,2-2", "bytes=-9223372036854775808", "bytes=5-1", "bytes=0-18446744073709551616"];
        let head = attacker.head("GET", &format!("/v1/jobs/{id}/{what}"));
        drop(attacker.connect(format!("{head}range: {}\r\n\r\n", range[number as usize % 4]).as_bytes()));
    });
}

fn searches(attacker: &Attacker<'_>) {
    attacker.flood(8, |number| {
        let path = match number % 3 {
            0 => format!("/v1/jobs?match={}", "%25_".repeat(200)),
            1 => format!("/v1/jobs?limit=1000&cursor={}", u64::MAX - number),
            _ => "/v1/jobs?limit=1000&state=succeeded".to_owned(),
        };
        attacker.send("GET", &path, "");
    });
}

fn links(attacker: &Attacker<'_>) {
    let Some(id) = finished(attacker) else { return };
    attacker.flood(8, |_| drop(attacker.send("POST", &format!("/v1/jobs/{id}/frames/0/link"), "{}")));
}

fn control_characters(attacker: &Attacker<'_>) {
    attacker.flood(4, |number| {
        let mut job = seeded_ball(number);
        job["name"] = json!("\u{1b}]0;owned\u{7}\u{1b}[2J\r\nERROR forged\u{202e}");
        attacker.submit(&job);
    });
}
