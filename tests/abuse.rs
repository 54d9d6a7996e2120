//! A caller who harms others: what each can do at worst, with other users' work beside.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;

use serde_json::{Value, json};

use crate::support::{Answer, DEADLINE, Farm, eventually, finish, sdfarm, text};

/// Number of requests without a key in a run of [`flood`].
const FLOOD: u64 = 4000;

/// Creates a key in a data folder, and returns its secret.
fn new_key(data: &Path, arguments: &[&str]) -> String {
    let mut command = sdfarm(&["key", "new"]);
    command.args(arguments).arg("--data").arg(data);
    let made = finish(command, b"");
    assert!(made.status.success(), "{}", text(&made.stderr));
    text(&made.stdout).trim().to_owned()
}

/// Sends a request with a key, and a JSON body unless it is null.
fn ask(farm: &Farm, key: &str, method: &str, path: &str, body: &Value) -> Answer {
    let bearer = format!("Bearer {key}");
    let mut headers = vec![("authorization", &*bearer)];
    let bytes = if body.is_null() { Vec::new() } else { body.to_string().into_bytes() };
    if !bytes.is_empty() {
        headers.push(("content-type", "application/json"));
    }
    farm.send(method, path, &headers, bytes)
}

/// Sends requests without a key, each to another path, on one connection, and reads all responses.
fn flood(address: &str) {
    let mut connection = TcpStream::connect(address).expect("connects");
    connection.set_read_timeout(Some(DEADLINE)).expect("a timeout");
    let mut reader = connection.try_clone().expect("a second handle");
    let responses = std::thread::spawn(move || {
        let (mut bytes, mut count) = (vec![0; 1 << 16], 0);
        let mut tail = Vec::new();
        while count < FLOOD {
            let length = reader.read(&mut bytes).expect("the server responds");
            assert!(length > 0, "the server closed the connection after {count} responses");
            tail.extend_from_slice(&bytes[..length]);
            let heads = tail.windows(9).filter(|window| window == b"HTTP/1.1 ").count() as u64;
            count += heads;
            // A head may begin in the bytes that were read last.
            let keep = if heads > 0 { tail.len().saturating_sub(8) } else { 0 };
            tail.drain(..keep);
        }
    });
    for number in 0..FLOOD {
        let request = format!("POST /junk-{number} HTTP/1.1\r\nHost: localhost\r\nContent-Length: 0\r\n\r\n");
        connection.write_all(request.as_bytes()).expect("sent");
    }
    responses.join().expect("all responses are read");
}

#[test]
fn a_flood_of_rejected_requests_hides_no_change() {
    let folder = tempfile::tempdir().expect("a folder");
    let admin = new_key(&folder.path().join("data"), &["ops", "--scope", "admin"]);
    let farm = Farm::start_on(folder.path(), &["--workers", "0"]);
    let address = farm.address.trim_start_matches("http://").to_owned();
    let floods: Vec<_> = (0..2)
        .map(|_| {
            let address = address.clone();
            std::thread::spawn(move || flood(&address))
        })
        .collect();
    let mut made = Vec::new();
    while made.len() < 40 || floods.iter().any(|flood| !flood.is_finished()) {
        if made.len() >= 900 {
            break;
        }
        let name = format!("user-{}", made.len());
        let answer = ask(&farm, &admin, "POST", "/v1/keys", &json!({ "name": name, "scopes": ["read"] }));
        assert_eq!(answer.status, 201, "{}", answer.text());
        made.push(answer.header("x-request-id").to_owned());
    }
    // The last change is in the log as soon as it has its response.
    let page = ask(&farm, &admin, "GET", "/v1/audit?limit=1000", &Value::Null).json();
    let entries = page["entries"].as_array().expect("entries");
    let recorded: Vec<_> =
        entries.iter().filter(|entry| entry["route"] == "/v1/keys" && entry["who"] == "ops").collect();
    let missing: Vec<_> = made.iter().filter(|id| !recorded.iter().any(|entry| entry["request_id"] == ***id)).collect();
    assert!(missing.is_empty(), "{} of {} keys have no entry", missing.len(), made.len());
    assert!(recorded.iter().all(|entry| entry["status"] == 201), "{recorded:?}");
    for flood in floods {
        flood.join().expect("ends");
    }
    eventually("every rejection is counted", || {
        let page = ask(&farm, &admin, "GET", "/v1/audit?limit=1000", &Value::Null).json();
        let refused = page["entries"].as_array().expect("entries").iter().filter(|entry| entry["who"] == "-");
        let refused: Vec<_> = refused.collect();
        assert!(refused.len() <= 4, "{} rows", refused.len());
        let times: u64 = refused.iter().map(|entry| entry["times"].as_u64().expect("a count")).sum();
        (times == 2 * FLOOD).then_some(())
    });
    let junk = farm.log().lines().filter(|line| line.contains("refused")).count();
    assert!((1..20).contains(&junk), "{junk} lines of the log are about rejections");
}

/// A name that sets a terminal's title, clears it, forges a line, and turns what follows around.
const EVIL: &str = "a\u{1b}]0;owned\u{7}\u{1b}[2J\r\nINFO forged\u{9b}1m\u{202e}z";

/// Asserts that a text for terminals has no control character but line ends, and no forged line.
fn assert_plain(what: &str, text: &str) {
    let unsafe_character =
        text.chars().find(|&character| (character.is_control() && character != '\n') || character == '\u{202e}');
    assert_eq!(unsafe_character, None, "{what}: {text:?}");
    assert!(!text.lines().any(|line| line.starts_with("INFO forged")), "{what}: {text}");
}

#[test]
fn names_from_outside_control_no_terminal_and_forge_no_line() {
    let farm = Farm::start(&["--workers", "0", "-v"]);
    let hello = json!({
        "name": EVIL, "device": "cpu", "picture_version": scene::PICTURE_VERSION, "max_nodes": null, "process": 1
    });
    let headers = [("content-type", "application/json"), ("user-agent", "evil")];
    let worker = farm.send("POST", "/v1/worker/register", &headers, hello.to_string().into_bytes());
    assert_eq!(worker.status, 200, "{}", worker.text());
    let worker = worker.json()["worker"].clone();
    let mut job = crate::jobs::quick();
    job["name"] = json!(EVIL);
    let (id, held) = (farm.accept(&job.to_string()), farm.accept(&job.to_string()));
    assert_eq!(farm.send("POST", &format!("/v1/jobs/{held}/pause"), &[], Vec::new()).status, 200);

    // Its worker fails with a message of its own, until the job has failed.
    eventually("the job has failed", || {
        let said = |reports: Value, wants_work: bool| {
            let said = json!({
                "worker": worker, "rays_per_second": null, "held_leases": [], "reports": reports,
                "wants_work": wants_work, "wait_ms": 0
            });
            farm.send("POST", "/v1/worker/sync", &headers[..1], said.to_string().into_bytes()).json()
        };
        let batch = said(json!([]), true);
        if let Some(tiles) = batch["batch"]["work"]["render"]["tiles"].as_array() {
            let failed = |tile: &Value| json!({ "lease": tile["lease"], "outcome": { "failed": { "message": EVIL } } });
            said(tiles.iter().map(failed).collect(), false);
        }
        (farm.get(&format!("/v1/jobs/{id}")).json()["state"] == "failed").then_some(())
    });

    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("job.json");
    std::fs::write(&file, job.to_string()).expect("writes");
    let file = file.to_str().expect("plain");
    let on_server: [&[&str]; 17] = [
        &["jobs"],
        &["jobs", "--json"],
        &["status"],
        &["status", "--json"],
        &["watch", &id],
        &["fetch", &id, "-o", "-"],
        &["retry", &held],
        &["pause", &held],
        &["resume", &held],
        &["priority", &held, "1"],
        &["delete", &held, "--dry-run"],
        &["cancel", EVIL],
        &["cancel", &held],
        &["resubmit", &held],
        &["gc", "--dry-run"],
        &["audit"],
        &["submit", file],
    ];
    for arguments in on_server {
        let output = crate::support::run(&[arguments, &["--server", &farm.address]].concat());
        assert_plain(&format!("{arguments:?}"), &(text(&output.stdout) + &text(&output.stderr)));
    }
    let mut wrong = job.clone();
    wrong["scene"][EVIL] = json!(1);
    let wrong_file = folder.path().join("wrong.json");
    std::fs::write(&wrong_file, wrong.to_string()).expect("writes");
    let picture = folder.path().join("out.png");
    let wrong_file = wrong_file.to_str().expect("plain");
    let here: [&[&str]; 5] = [
        &["check", file],
        &["check", wrong_file],
        &["explain", file],
        &["render", file, "-o", picture.to_str().expect("plain")],
        &["submit", wrong_file, "--server", &farm.address],
    ];
    for arguments in here {
        let output = crate::support::run(arguments);
        assert_plain(&format!("{arguments:?}"), &(text(&output.stdout) + &text(&output.stderr)));
    }
    let listed = crate::support::succeed(&["status", "--server", &farm.address]);
    assert!(listed.contains("a\\u{1b}]0;owned\\u{7}"), "{listed}");
    let log = farm.log();
    assert!(log.contains("\\u{1b}]0;owned"), "the log has the names: {log}");
    assert_plain("the log", &log);
}
