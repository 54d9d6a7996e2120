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
    let recorded: Vec<_> = entries.iter().filter(|entry| entry["route"] == "/v1/keys").collect();
    let missing: Vec<_> =
        made.iter().filter(|id| !recorded.iter().any(|entry| entry["request_id"] == ***id)).collect();
    assert!(missing.is_empty(), "{} of {} keys have no entry", missing.len(), made.len());
    assert!(recorded.iter().all(|entry| entry["who"] == "ops" && entry["status"] == 201), "{page}");
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
