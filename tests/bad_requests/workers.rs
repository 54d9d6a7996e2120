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
        ("a version that is not a number", "{version}", "\"one\""),
        ("no name", "\"name\":\"n\",", ""),
        ("a number for a name", "\"n\"", "1"),
        ("a negative process id", "\"process\":1", "\"process\":-1"),
        ("a negative number of nodes", "null", "-5"),
        ("an additional member", "\"process\":1", "\"process\":1,\"key\":2"),
        ("a duplicate member", "\"process\":1", "\"process\":1,\"process\":2"),
    ]
    .into_iter()
    .map(|(name, from, to)| changed(REGISTER, name, HELLO, from, to))
    .collect()
}

fn sync() -> Vec<Request> {
    [
        ("an unknown worker", "{worker}", "{nobody}"),
        ("an invalid worker id", "{worker}", "me"),
        ("no worker", "\"worker\":\"{worker}\",", ""),
        ("a speed that is not a number", "null", "\"fast\""),
        ("invalid lease ids", "\"held_leases\":[]", "\"held_leases\":[\"x\"]"),
        ("leases that are not a list", "\"held_leases\":[]", "\"held_leases\":{}"),
        ("results that are not a list", "\"reports\":[]", "\"reports\":null"),
        ("a result without an outcome", "\"reports\":[]", "\"reports\":[{\"lease\":\"{stale}\"}]"),
        ("an unknown outcome", "\"reports\":[]", "\"reports\":[{\"lease\":\"{stale}\",\"outcome\":\"won\"}]"),
        (
            "a blob with a negative size",
            "\"reports\":[]",
            "\"reports\":[{\"lease\":\"{stale}\",\"outcome\":{\"blob\":{\"hash\":\"{hash}\",\"size_bytes\":-1}}}]",
        ),
        ("wants_work that is not a boolean", "\"wants_work\":false", "\"wants_work\":\"no\""),
        ("a negative wait", "\"wait_ms\":0", "\"wait_ms\":-1"),
        ("an additional member", "\"wait_ms\":0", "\"wait_ms\":0,\"key\":2"),
        ("a duplicate member", "\"wait_ms\":0", "\"wait_ms\":0,\"wait_ms\":1"),
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
    let picture = r#"{"picture":{"hash":"{hash}","size_bytes":{size}}}"#;
    vec![
        result("a picture under a stale lease", "{stale}", picture),
        result("a picture under an unknown lease", "{nobody}", picture),
        result("a blob under a stale lease", "{stale}", &picture.replace("picture", "blob")),
        result("a picture of the wrong size", "{stale}", &picture.replace("{size}", "22")),
        result("a picture that was never uploaded", "{stale}", &picture.replace("{hash}", OTHER_HASH)),
        result("a picture whose name is not a hash", "{stale}", &picture.replace("{hash}", "../../etc/passwd")),
        result("a failure under a stale lease", "{stale}", r#"{"failed":{"message":"no"}}"#),
        result("bad blobs under a stale lease", "{stale}", r#"{"bad_blobs":{"tiles":[0,1,4294967295]}}"#),
        result("a release under a stale lease", "{stale}", "\"released\""),
        changed(SYNC, "a stale lease that is held", SAID, "\"held_leases\":[]", "\"held_leases\":[\"{stale}\"]")
            .foreign(),
        changed(SYNC, "a speed out of range", SAID, "null", "1e308").foreign(),
        changed(SYNC, "a negative speed", SAID, "null", "-1").foreign(),
    ]
}

fn bytes() -> Vec<Request> {
    let mut all = Vec::new();
    for folder in ["blobs", "pictures"] {
        let path = format!("/v1/worker/{folder}");
        let upper = "A".repeat(64);
        let long = "0".repeat(65);
        for (name, hash) in [
            ("a name that is not a hash", "nonsense"),
            ("a hash in capitals", upper.as_str()),
            ("a hash too long", long.as_str()),
            ("a path traversal", "%2e%2e%2ffarm.sqlite"),
            ("the hash of other bytes", OTHER_HASH),
        ] {
            all.push(Request::new(format!("PUT {folder}: {name}"), format!("PUT {path}/{hash}")).with("bytes"));
        }
        let head = format!("PUT {path}/{{hash}}\ncontent-length: 100");
        all.push(Request::new(format!("PUT {folder}: incomplete bytes"), head).with("bytes").stopped());
        let head = format!("PUT {path}/{OTHER_HASH}");
        all.push(Request::new(format!("PUT {folder}: no bytes"), head));
        let head = format!("PUT {path}/{OTHER_HASH}\ntransfer-encoding: chunked");
        let bomb = [&b"200000\r\n"[..], &vec![0; 0x20_0000], b"\r\n0\r\n\r\n"].concat();
        all.push(Request::new(format!("PUT {folder}: megabytes of nothing"), head).with(bomb));
    }
    all.push(Request::new("GET blobs: unknown", format!("GET /v1/worker/blobs/{OTHER_HASH}")));
    all.push(Request::new("GET blobs: a name that is no hash", "GET /v1/worker/blobs/nonsense"));
    all.push(Request::new("GET jobs: unknown", "GET /v1/worker/jobs/{nobody}"));
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
