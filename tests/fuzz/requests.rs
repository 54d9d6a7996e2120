//! Fuzzes raw requests to a server: the parsers of request lines, headers, ranges, cursors, and queries; and the
//! messages and bytes of a worker, while real workers render the jobs of another user.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::Duration;

use proto::worker_protocol::{REGISTER_PATH, SYNC_PATH};
use serde_json::json;

use super::messages::growing_jobs;
use super::{Effort, fuzz};
use crate::jobs;
use crate::support::{Farm, rendered_here};

/// Requests of the corpus. They include neither pool changes nor webhooks, because mutations could start hundreds of
/// processes.
fn corpus(job: &str) -> Vec<Vec<u8>> {
    let get = |path: &str, headers: &str| format!("GET {path} HTTP/1.1\r\nhost: 127.0.0.1\r\n{headers}\r\n");
    let text = r#"{"scene":{},"image":{"width":8,"height":8}}"#;
    let json = format!("content-type: application/json\r\ncontent-length: {}\r\n\r\n{text}", text.len());
    let growing = growing_jobs().map(|text| {
        let head = "POST /v1/jobs?dry_run=true HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json";
        format!(
            "{head}\r\nconnection: close\r\ntransfer-encoding: chunked\r\n\r\n{:x}\r\n{text}\r\n0\r\n\r\n",
            text.len()
        )
    });
    let usual = [
        get("/v1/jobs?limit=10&state=queued", ""),
        get("/v1/jobs?cursor=2", "accept: application/json\r\n"),
        get(&format!("/v1/jobs/{job}"), "x-request-id: a\r\n"),
        get(&format!("/v1/jobs/{job}/image"), "range: bytes=0-99\r\nif-range: \"x\"\r\n"),
        get(&format!("/v1/jobs/{job}/frames/0/image"), "if-none-match: W/\"a\", \"b\"\r\n"),
        get("/livez", "origin: http://127.0.0.1\r\n"),
        get("/v1/workers", "authorization: Bearer x\r\n"),
        format!("POST /v1/jobs?dry_run=true HTTP/1.1\r\nhost: localhost\r\n{json}"),
        format!("POST /v1/worker/sync HTTP/1.1\r\nhost: localhost\r\n{json}"),
        format!("PUT /v1/worker/blobs/{} HTTP/1.1\r\nhost: localhost\r\n{json}", "0".repeat(64)),
        "POST /v1/jobs HTTP/1.1\r\nhost: [::1]:80\r\ntransfer-encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n".to_owned(),
    ];
    usual.into_iter().chain(growing).map(String::into_bytes).collect()
}

fn try_requests(effort: Effort) {
    let farm = Farm::start(&["--workers", "0"]);
    let job = farm.accept(&jobs::quick().to_string());
    let address = farm.address.strip_prefix("http://").expect("an address").to_owned();
    fuzz("requests", effort, &corpus(&job), |bytes| {
        let mut connection = TcpStream::connect(&address).expect("the server listens");
        connection.set_read_timeout(Some(Duration::from_secs(5))).expect("settable");
        // The server may reject the request before it has read everything.
        let _ = connection.write_all(bytes);
        let _ = connection.shutdown(Shutdown::Write);
        let mut answer = Vec::new();
        let _ = connection.read_to_end(&mut answer);
        let status = answer.get(9..12).unwrap_or_default();
        assert!(!status.starts_with(b"5"), "{}", String::from_utf8_lossy(&answer));
    });
    assert_eq!(farm.get("/livez").status, 200, "{}", farm.log());
    assert!(!farm.log().contains("panicked"), "{}", farm.log());
}

#[test]
fn fuzzed_requests_get_responses_without_server_errors() {
    try_requests(Effort::Runs(300));
}

#[test]
#[ignore = "long: fuzzing for 60 s"]
fn long_fuzzed_requests_get_responses_without_server_errors() {
    try_requests(Effort::Long);
}

/// Messages of a registered worker. Each begins with a letter for its route.
fn worker_corpus(farm: &Farm) -> Vec<Vec<u8>> {
    let hello = json!({ "name": "fuzzed", "device": "cpu", "picture_version": scene::PICTURE_VERSION,
        "max_nodes": 1000, "process": 1 });
    let register = |hello: &serde_json::Value| {
        farm.send("POST", REGISTER_PATH, &[("content-type", "application/json")], hello.to_string().into_bytes())
    };
    let worker = register(&hello).json()["worker"].clone();
    let lease = "01900000-0000-7000-8000-000000000000";
    let hash = blake3::hash(b"bytes").to_hex().to_string();
    let sync = |reports: serde_json::Value, wants_work: bool| {
        json!({ "worker": worker, "rays_per_second": 1e6, "held_leases": [lease], "reports": reports,
            "wants_work": wants_work, "wait_ms": 0,
            "metrics": { "timings": [{ "phase": "render", "took_ms": 1.5, "rays": 7 }],
                "memory": { "used_bytes": 1, "total_bytes": 2 } } })
    };
    let outcomes = json!([
        { "lease": lease, "outcome": { "blob": { "hash": hash, "size_bytes": 5 } } },
        { "lease": lease, "outcome": { "picture": { "hash": hash, "size_bytes": 5 } } },
        { "lease": lease, "outcome": { "bad_blobs": { "tiles": [0, 7] } } },
        { "lease": lease, "outcome": { "failed": { "message": "no" } } },
        { "lease": lease, "outcome": "released" }]);
    let messages = [("r", hello), ("s", sync(json!([]), true)), ("s", sync(outcomes, false))];
    let messages = messages.map(|(route, message)| format!("{route}{message}").into_bytes());
    messages.into_iter().chain([b"b\0\x01\x02sdfarm".to_vec(), b"p\x89PNG\r\n\x1a\n".to_vec()]).collect()
}

/// No message of a worker may cause a server error, and none may change another user's picture.
fn try_workers(effort: Effort) {
    let farm = Farm::start(&["--workers", "1", "--threads", "1", "--lease-seconds", "1"]);
    farm.ready(1);
    let mut seed = 0;
    fuzz("a worker's requests", effort, &worker_corpus(&farm), |bytes| {
        let Some((route, body)) = bytes.split_first() else { return };
        let hash = blake3::hash(body).to_hex();
        let (method, path) = match route {
            b'r' => ("POST", REGISTER_PATH.to_owned()),
            b's' => ("POST", SYNC_PATH.to_owned()),
            b'b' => ("PUT", format!("/v1/worker/blobs/{hash}")),
            _ => ("PUT", format!("/v1/worker/pictures/{hash}")),
        };
        let answer = farm.send(method, &path, &[("content-type", "application/json")], body.to_vec());
        assert!(answer.status < 500, "{path}: {} {}", answer.status, answer.text());
        seed += 1;
        if seed % 200 == 1 {
            let job = jobs::seeded(&jobs::quick(), seed);
            let id = farm.accept(&job.to_string());
            farm.succeeded(&id);
            assert!(farm.picture(&id) == rendered_here(&job, 0), "other bytes than an undisturbed render's");
        }
    });
    assert!(!farm.log().contains("panicked"), "{}", farm.log());
}

#[test]
fn fuzzed_requests_of_a_worker_disturb_nobody() {
    try_workers(Effort::Runs(300));
}

#[test]
#[ignore = "long: fuzzing for 60 s"]
fn long_fuzzed_requests_of_a_worker_disturb_nobody() {
    try_workers(Effort::Long);
}
