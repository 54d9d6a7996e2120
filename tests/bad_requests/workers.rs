//! Invalid requests of workers: another version, unknown ids, stale leases, wrong sizes and hashes, oversized bodies.

use super::raw::Request;

const REGISTER: &str = "POST /v1/worker/register";
const SYNC: &str = "POST /v1/worker/sync";
const JSON: &str = "content-type: application/json";
const HELLO: &str = r#"{"name":"n","device":"cpu","picture_version":{version},"max_nodes":null,"process":1}"#;
const SAID: &str =
    r#"{"worker":"{worker}","rays_per_second":null,"held_leases":[],"reports":[],"wants_work":false,"wait_ms":0}"#;
const OTHER_HASH: &str = "0000000000000000000000000000000000000000000000000000000000000000";

/// Replaces one part of a message.
fn changed(route: &str, name: &str, message: &str, from: &str, to: &str) -> Request {
    assert!(message.contains(from), "{name}: {from:?} must be in the message");
    let head = format!("{route}\n{JSON}");
    Request::new(format!("{route}: {name}"), head).with(message.replacen(from, to, 1))
}

fn hello() -> Vec<Request> {
    [
        ("a version that is past", "{version}", "0"),
        ("a version to come", "{version}", "4000000000"),
        ("no version", "\"picture_version\":{version},", ""),
        ("a version in words", "{version}", "\"one\""),
        ("no name", "\"name\":\"n\",", ""),
        ("a number for a name", "\"n\"", "1"),
        ("a process below none", "\"process\":1", "\"process\":-1"),
        ("nodes below none", "null", "-5"),
        ("one key more", "\"process\":1", "\"process\":1,\"key\":2"),
        ("a key twice", "\"process\":1", "\"process\":1,\"process\":2"),
    ]
    .into_iter()
    .map(|(name, from, to)| changed(REGISTER, name, HELLO, from, to))
    .collect()
}

fn sync() -> Vec<Request> {
    [
        ("a worker nobody knows", "{worker}", "{nobody}"),
        ("a worker that is none", "{worker}", "me"),
        ("no worker", "\"worker\":\"{worker}\",", ""),
        ("a speed in words", "null", "\"fast\""),
        ("leases that are none", "\"held_leases\":[]", "\"held_leases\":[\"x\"]"),
        ("leases that are no list", "\"held_leases\":[]", "\"held_leases\":{}"),
        ("results that are no list", "\"reports\":[]", "\"reports\":null"),
        ("a result without an outcome", "\"reports\":[]", "\"reports\":[{\"lease\":\"{stale}\"}]"),
        ("an outcome nobody knows", "\"reports\":[]", "\"reports\":[{\"lease\":\"{stale}\",\"outcome\":\"won\"}]"),
        (
            "a blob of a size below none",
            "\"reports\":[]",
            "\"reports\":[{\"lease\":\"{stale}\",\"outcome\":{\"blob\":{\"hash\":\"{hash}\",\"size_bytes\":-1}}}]",
        ),
        ("a wish in words", "\"wants_work\":false", "\"wants_work\":\"no\""),
        ("a wait below none", "\"wait_ms\":0", "\"wait_ms\":-1"),
        ("one key more", "\"wait_ms\":0", "\"wait_ms\":0,\"key\":2"),
        ("a key twice", "\"wait_ms\":0", "\"wait_ms\":0,\"wait_ms\":1"),
    ]
    .into_iter()
    .map(|(name, from, to)| changed(SYNC, name, SAID, from, to))
    .collect()
}

/// Results without effect: the response lists them as lost.
fn stale() -> Vec<Request> {
    let result = |name: &str, lease: &str, outcome: &str| {
        let results = format!("\"reports\":[{{\"lease\":\"{lease}\",\"outcome\":{outcome}}}]");
        changed(SYNC, name, SAID, "\"reports\":[]", &results).foreign()
    };
    let picture = r#"{"picture":{"hash":"{hash}","size_bytes":21}}"#;
    vec![
        result("a picture under a stale lease", "{stale}", picture),
        result("a picture under nobody's lease", "{nobody}", picture),
        result("a blob under a stale lease", "{stale}", &picture.replace("picture", "blob")),
        result("a picture of the wrong size", "{stale}", &picture.replace("21", "22")),
        result("a picture that was never put", "{stale}", &picture.replace("{hash}", OTHER_HASH)),
        result("a picture whose name is no hash", "{stale}", &picture.replace("{hash}", "../../etc/passwd")),
        result("a failure under a stale lease", "{stale}", r#"{"failed":{"message":"no"}}"#),
        result("bad blobs under a stale lease", "{stale}", r#"{"bad_blobs":{"tiles":[0,1,4294967295]}}"#),
        result("a hand-back under a stale lease", "{stale}", "\"released\""),
        changed(SYNC, "a stale lease that is held", SAID, "\"held_leases\":[]", "\"held_leases\":[\"{stale}\"]")
            .foreign(),
        changed(SYNC, "a speed beyond all", SAID, "null", "1e308").foreign(),
        changed(SYNC, "a speed below none", SAID, "null", "-1").foreign(),
    ]
}

fn bytes() -> Vec<Request> {
    let mut all = Vec::new();
    for folder in ["blobs", "pictures"] {
        let path = format!("/v1/worker/{folder}");
        let upper = "A".repeat(64);
        let long = "0".repeat(65);
        for (name, hash) in [
            ("a name that is no hash", "nonsense"),
            ("a hash in capitals", upper.as_str()),
            ("a hash too long", long.as_str()),
            ("a way up", "%2e%2e%2ffarm.sqlite"),
            ("the hash of other bytes", OTHER_HASH),
        ] {
            all.push(Request::new(format!("PUT {folder}: {name}"), format!("PUT {path}/{hash}")).with("bytes"));
        }
        let head = format!("PUT {path}/{{hash}}\ncontent-length: 100");
        all.push(Request::new(format!("PUT {folder}: bytes that stop midway"), head).with("bytes").stopped());
        let head = format!("PUT {path}/{OTHER_HASH}");
        all.push(Request::new(format!("PUT {folder}: no bytes"), head));
        let head = format!("PUT {path}/{OTHER_HASH}\ntransfer-encoding: chunked");
        let bomb = [&b"200000\r\n"[..], &vec![0; 0x20_0000], b"\r\n0\r\n\r\n"].concat();
        all.push(Request::new(format!("PUT {folder}: megabytes of nothing"), head).with(bomb));
    }
    all.push(Request::new("GET blobs: nobody's", format!("GET /v1/worker/blobs/{OTHER_HASH}")));
    all.push(Request::new("GET blobs: a name that is no hash", "GET /v1/worker/blobs/nonsense"));
    all.push(Request::new("GET jobs: nobody's", "GET /v1/worker/jobs/{nobody}"));
    all.push(Request::new("GET jobs: no id", "GET /v1/worker/jobs/nonsense"));
    for head in [REGISTER, SYNC, "GET /v1/worker/jobs/{job}", "PUT /v1/worker/blobs/{hash}"] {
        for token in ["Bearer nonsense", "Bearer ", "Basic dXNlcjpwYXNz", "nonsense"] {
            let name = format!("{head} with {token:?}");
            all.push(Request::new(name, format!("{head}\n{JSON}\nauthorization: {token}")).with("{}"));
        }
    }
    all
}

/// Invalid requests of this file.
pub(super) fn requests() -> Vec<Request> {
    [hello(), sync(), stale(), bytes()].concat()
}
