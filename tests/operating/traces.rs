//! Tests, on a real farm, that one trace covers a job from its submission to the stored picture, and that logs are
//! JSON.

use std::collections::HashMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::Stdio;
use std::sync::{Arc, Mutex};

use rustix::process::Signal;
use serde_json::Value;

use crate::support::{Farm, sdfarm, send_signal, wait};

/// Part of a span that the collector stores.
#[derive(Clone, Debug, Default)]
struct Span {
    trace: String,
    id: String,
    parent: String,
    name: String,
}

/// Collector that receives spans by OTLP over HTTP.
struct Collector {
    address: String,
    spans: Arc<Mutex<Vec<Span>>>,
}

impl Collector {
    fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = format!("http://{}", listener.local_addr().expect("bound"));
        let spans = Arc::new(Mutex::new(Vec::new()));
        let taken = spans.clone();
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let taken = taken.clone();
                std::thread::spawn(move || serve(stream, &taken));
            }
        });
        Self { address, spans }
    }

    fn of_trace(&self, trace: &str) -> Vec<Span> {
        self.spans.lock().expect("not poisoned").iter().filter(|span| span.trace == trace).cloned().collect()
    }
}

/// Receives requests until the client closes the connection.
fn serve(stream: TcpStream, taken: &Mutex<Vec<Span>>) {
    let mut reader = BufReader::new(stream.try_clone().expect("a socket"));
    let mut stream = stream;
    loop {
        let (mut line, mut length) = (String::new(), 0);
        loop {
            line.clear();
            if reader.read_line(&mut line).unwrap_or(0) == 0 {
                return;
            }
            if let Some((name, value)) = line.split_once(':')
                && name.eq_ignore_ascii_case("content-length")
            {
                length = value.trim().parse().expect("a number");
            }
            if line == "\r\n" {
                break;
            }
        }
        let mut body = vec![0; length];
        reader.read_exact(&mut body).expect("a complete body");
        taken.lock().expect("not poisoned").extend(spans(&body));
        let _ =
            stream.write_all(b"HTTP/1.1 200 OK\r\ncontent-type: application/x-protobuf\r\ncontent-length: 0\r\n\r\n");
    }
}

/// Returns the byte fields of a Protocol Buffers message, by number.
fn fields(mut message: &[u8]) -> Vec<(u64, &[u8])> {
    let mut found = Vec::new();
    while !message.is_empty() {
        let key = number(&mut message);
        match key & 7 {
            0 => drop(number(&mut message)),
            1 => message = &message[8..],
            2 => {
                let length = number(&mut message) as usize;
                found.push((key >> 3, &message[..length]));
                message = &message[length..];
            }
            5 => message = &message[4..],
            kind => panic!("wire type {kind}"),
        }
    }
    found
}

fn number(message: &mut &[u8]) -> u64 {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let (byte, rest) = message.split_first().expect("a complete number");
        *message = rest;
        value |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            break;
        }
    }
    value
}

/// Returns the spans of an export request: resource spans (1), scope spans (2), spans (2).
fn spans(body: &[u8]) -> Vec<Span> {
    let mut found = Vec::new();
    for (_, resource) in fields(body).into_iter().filter(|(field, _)| *field == 1) {
        for (_, scope) in fields(resource).into_iter().filter(|(field, _)| *field == 2) {
            for (_, span) in fields(scope).into_iter().filter(|(field, _)| *field == 2) {
                let get = |wanted| {
                    fields(span).into_iter().find(|(field, _)| *field == wanted).map_or(&[][..], |(_, bytes)| bytes)
                };
                let hex = |bytes: &[u8]| bytes.iter().fold(String::new(), |text, byte| text + &format!("{byte:02x}"));
                let name = String::from_utf8_lossy(get(5)).into_owned();
                found.push(Span { trace: hex(get(1)), id: hex(get(2)), parent: hex(get(4)), name });
            }
        }
    }
    found
}

const TRACE: &str = "4bf92f3577b34da6a3ce929d0e0e4736";
const CLIENT: &str = "00f067aa0ba902b7";

/// Submits a small job like a client that has its own trace.
fn hand_in(farm: &Farm) -> String {
    let job = r#"{"scene": {"camera": {"position": [0, 0, 4], "look_at": [0, 0, 0]},
        "objects": [{"material": {"normals": {}}, "shape": {"sphere": {"radius": 1}}}]},
        "image": {"width": 64, "height": 48, "samples": 1}}"#;
    let headers = [
        ("content-type", "application/json"),
        ("traceparent", &format!("00-{TRACE}-{CLIENT}-01")[..]),
        ("x-request-id", "the-request"),
    ];
    let answer = farm.send("POST", "/v1/jobs", &headers, job.as_bytes().to_vec());
    assert_eq!(answer.status, 201, "{}", answer.text());
    let id = answer.json()["id"].as_str().expect("an id").to_owned();
    farm.succeeded(&id);
    id
}

/// Names of a span and its ancestors, up to the client's span.
fn names_up_from(name: &str, spans: &[Span]) -> Vec<String> {
    let by_id: HashMap<&str, &Span> = spans.iter().map(|span| (span.id.as_str(), span)).collect();
    let mut span = spans.iter().find(|span| span.name == name).unwrap_or_else(|| panic!("no {name} in {spans:?}"));
    let mut names = vec![span.name.clone()];
    while let Some(above) = by_id.get(span.parent.as_str()) {
        names.push(above.name.clone());
        span = above;
    }
    assert_eq!(span.parent, CLIENT, "the client's span is the root");
    names
}

#[test]
fn one_trace_covers_a_job_from_request_to_picture() {
    let collector = Collector::start();
    let folder = tempfile::tempdir().expect("a folder");
    let flags = ["--device", "cpu", "--workers", "1", "--log", "json", "-v", "--otlp", &collector.address];
    let farm = Farm::start_on(folder.path(), &flags);
    let id = hand_in(&farm);
    let path = folder.path().join("log");
    // The remaining traces are sent when the processes exit.
    assert!(farm.terminate().success());

    let spans = collector.of_trace(TRACE);
    assert_eq!(names_up_from("deliver", &spans), ["deliver", "batch", "lease", "request"], "{spans:?}");
    for name in ["submit", "render", "encode"] {
        assert!(spans.iter().any(|span| span.name == name), "no {name} in {spans:?}");
    }
    check_log(&std::fs::read_to_string(path).expect("a log"), &id);
}

#[test]
fn trace_continues_when_a_remote_worker_uploads_its_picture() {
    let collector = Collector::start();
    let farm = Farm::start(&["--workers", "0", "--otlp", &collector.address]);
    let worker = ["worker", "--server", &farm.address, "--device", "cpu", "--otlp", &collector.address];
    let mut worker = sdfarm(&worker).stderr(Stdio::null()).spawn().expect("the program starts");
    hand_in(&farm);
    send_signal(worker.id(), Signal::TERM);
    assert!(wait(&mut worker).success());
    assert!(farm.terminate().success());
    let spans = collector.of_trace(TRACE);
    let names = ["store", "request", "deliver", "batch", "lease", "request"];
    assert_eq!(names_up_from("store", &spans), names, "{spans:?}");
}

/// Asserts that every line is an object, and that lines about the job name it, its frame, and its worker.
fn check_log(log: &str, id: &str) {
    let lines: Vec<Value> =
        log.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"))).collect();
    for line in &lines {
        for field in ["timestamp", "level", "target", "message"] {
            assert!(line[field].is_string(), "no {field} in {line}");
        }
    }
    let put = lines.iter().find(|line| line["message"] == "picture stored").expect("the worker's line");
    assert_eq!((&put["job"], &put["frame"]), (&id.into(), &0.into()), "{put}");
    assert!(put["worker"].as_str().is_some_and(|worker| worker.len() == 36) && put["label"] == "pool-1", "{put}");
    let posted = lines.iter().find(|line| line["request_id"] == "the-request").expect("the request's line");
    assert_eq!((&posted["method"], &posted["path"]), (&"POST".into(), &"/v1/jobs".into()), "{posted}");
    let looked = format!("/v1/jobs/{id}");
    let looked = lines.iter().find(|line| line["path"] == looked.as_str()).expect("a line for the GET of the job");
    assert_eq!(looked["job"], id, "{looked}");
}
