//! Fuzzes raw requests to a server: the parsers of request lines, headers, ranges, cursors, and queries.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::Duration;

use super::{Effort, fuzz};
use crate::jobs;
use crate::support::Farm;

/// Requests of the corpus. They include neither pool changes nor webhooks, because mutations could start hundreds of
/// processes.
fn corpus(job: &str) -> Vec<Vec<u8>> {
    let get = |path: &str, headers: &str| format!("GET {path} HTTP/1.1\r\nhost: 127.0.0.1\r\n{headers}\r\n");
    let text = r#"{"scene":{},"image":{"width":8,"height":8}}"#;
    let json = format!("content-type: application/json\r\ncontent-length: {}\r\n\r\n{text}", text.len());
    [
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
    ]
    .map(String::into_bytes)
    .to_vec()
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
