//! Tests invalid requests to every route, sent byte by byte from a table. Each complete response is compared with
//! `bad_requests/answers.txt`, which `SDFARM_WRITE_ANSWERS=1` rewrites. The server keeps running.

mod bodies;
mod http;
mod paths;
mod raw;
mod workers;

use std::fmt::Write;

use serde_json::{Value, json};

use crate::jobs;
use crate::support::{Farm, rendered_here, root};
use raw::{Request, exchange};

/// Minimum number of invalid requests.
const LEAST: usize = 200;
const WRITE: &str = "SDFARM_WRITE_ANSWERS";

/// Farm and resources that the requests name; `{job}` in a request is replaced with the job's id, and so on.
struct Stage {
    farm: Farm,
    /// Placeholders and their values.
    names: Vec<(&'static str, String)>,
}

impl Stage {
    /// Starts a farm without pool workers, with a queued job, and a job that a simulated worker has finished.
    fn new() -> Self {
        let farm = Farm::start(&["--workers", "0", "--lease-seconds", "3600"]);
        let done = farm.accept(&jobs::quick().to_string());
        let post = |path: &str, body: Value| {
            let json = [("content-type", "application/json")];
            let answer = farm.send("POST", path, &json, body.to_string().into());
            assert_eq!(answer.status, 200, "{path}: {}", answer.text());
            answer.json()
        };
        let hello = json!({ "name": "ours", "device": "cpu", "picture_version": scene::PICTURE_VERSION,
                            "max_nodes": null, "process": 1 });
        let worker = post("/v1/worker/register", hello)["worker"].as_str().expect("an id").to_owned();
        let sync = |results: Value, wants_work: bool| {
            post(
                "/v1/worker/sync",
                json!({ "worker": worker, "rays_per_second": null, "held_leases": [], "reports": results,
                        "wants_work": wants_work, "wait_ms": 0 }),
            )
        };
        let run = sync(json!([]), true)["batch"].clone();
        let tiles = run["work"]["render"]["tiles"].as_array().expect("tiles").clone();
        let picture = rendered_here(&jobs::quick(), 0);
        let hash = blake3::hash(&picture).to_hex().to_string();
        let size_bytes = picture.len();
        assert_eq!(farm.send("PUT", &format!("/v1/worker/pictures/{hash}"), &[], picture).status, 204);
        let outcome = json!({ "picture": { "hash": hash, "size_bytes": size_bytes } });
        let results = tiles.iter().map(|tile| json!({ "lease": tile["lease"], "outcome": outcome })).collect();
        sync(results, false);
        farm.succeeded(&done);
        let job = farm.accept(&jobs::seeded(&jobs::quick(), 7).to_string());
        let stale = tiles[0]["lease"].as_str().expect("an id").to_owned();
        let names = vec![
            ("{job}", job),
            ("{done}", done),
            ("{worker}", worker),
            ("{stale}", stale),
            ("{hash}", hash),
            ("{size}", size_bytes.to_string()),
            ("{nobody}", "01900000-0000-7000-8000-000000000000".to_owned()),
            ("{version}", scene::PICTURE_VERSION.to_string()),
        ];
        Self { farm, names }
    }

    /// Replaces the placeholders with their values.
    fn fill(&self, text: &str) -> String {
        self.names.iter().fold(text.to_owned(), |text, (name, value)| text.replace(name, value))
    }

    /// Replaces the values with their placeholders, and hides every other id.
    fn hide(&self, text: &str) -> String {
        let ids = self.names.iter().filter(|(_, value)| value.len() > 8);
        let text = ids.fold(text.to_owned(), |text, (name, value)| text.replace(value, name));
        let size = self.fill("{size}");
        let text = text
            .replace(&format!("bytes */{size}"), "bytes */{size}")
            .replace(&format!("has {size} bytes"), "has {size} bytes");
        let address = self.farm.address.strip_prefix("http://").expect("an address");
        hide_ids(&text.replace(address, "{address}"))
    }
}

/// Hides UUIDs, which differ in each run.
fn hide_ids(text: &str) -> String {
    const SHAPE: &str = "xxxxxxxx-xxxx-xxxx-xxxx-xxxxxxxxxxxx";
    let mut hidden = String::new();
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let is_id = rest.len() >= SHAPE.len()
            && rest.bytes().zip(SHAPE.bytes()).all(|(byte, shape)| match shape {
                b'x' => byte.is_ascii_hexdigit(),
                dash => byte == dash,
            });
        let (shown, length) = if is_id { ("{id}", SHAPE.len()) } else { (&rest[..first.len_utf8()], first.len_utf8()) };
        hidden.push_str(shown);
        rest = &rest[length..];
    }
    hidden
}

/// All invalid requests.
fn requests() -> Vec<Request> {
    [paths::requests(), bodies::requests(), http::requests(), workers::requests()].concat()
}

#[test]
fn invalid_requests_get_the_recorded_responses() {
    let stage = Stage::new();
    let requests = requests();
    assert!(requests.len() >= LEAST, "only {} requests", requests.len());
    let mut names: Vec<&str> = requests.iter().map(|request| request.name.as_str()).collect();
    names.sort_unstable();
    assert!(names.windows(2).all(|pair| pair[0] != pair[1]), "a name occurs twice");
    let (mut answers, mut faults) = (String::new(), Vec::new());
    for request in &requests {
        let answer = exchange(&stage.farm.address, &request.bytes(|text| stage.fill(text)), request.stops);
        if let Err(fault) = answer.check(request.is_ours) {
            faults.push(format!("{}: {fault}: {}", request.name, answer.text()));
        }
        writeln!(answers, "## {}\n{}\n", request.name, stage.hide(&answer.text())).expect("writing to a string");
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert_eq!(stage.farm.get("/livez").status, 200, "{}", stage.farm.log());
    assert_eq!(stage.farm.get("/v1/jobs").json()["jobs"].as_array().map(Vec::len), Some(2), "no request created a job");
    assert!(!stage.farm.log().contains("panicked"), "{}", stage.farm.log());

    let path = root().join("tests/bad_requests/answers.txt");
    if std::env::var_os(WRITE).is_some() {
        return std::fs::write(path, answers).expect("written");
    }
    let kept = std::fs::read_to_string(path).unwrap_or_default();
    let (kept, answers): (Vec<&str>, Vec<&str>) = (kept.split("## ").collect(), answers.split("## ").collect());
    for (want, got) in kept.iter().zip(&answers) {
        assert_eq!(got, want, "a response has changed: if that is intended, rewrite it with {WRITE}=1");
    }
    assert_eq!(kept.len(), answers.len(), "requests were added or removed: rewrite the responses with {WRITE}=1");
}

#[test]
fn every_route_with_an_id_rejects_invalid_ids() {
    let stage = Stage::new();
    let document = stage.farm.get("/openapi.json").json();
    let mut asked = 0;
    for (path, methods) in document["paths"].as_object().expect("paths") {
        for method in methods
            .as_object()
            .expect("methods")
            .keys()
            .filter(|method| path.contains("{id}") && *method != "parameters")
        {
            for id in ["x", "{nobody}", "%00", "%2e%2e", "0", "'%20or%201=1--"] {
                // Clients resolve the dots: that is the stream of all jobs, which has no end.
                if id == "%2e%2e" && path == "/v1/jobs/{id}/events" {
                    continue;
                }
                let path = path.replace("{id}", &stage.fill(id)).replace("{frame}", "0");
                let body =
                    if ["post", "put", "patch"].contains(&method.as_str()) { b"{}".to_vec() } else { Vec::new() };
                let json = [("content-type", "application/json")];
                let answer = stage.farm.send(&method.to_uppercase(), &path, &json, body);
                assert!((400..500).contains(&answer.status), "{method} {path}: {} {}", answer.status, answer.text());
                let problem = answer.problem(answer.status, answer.json()["code"].as_str().expect("a code"));
                assert_eq!(problem["request_id"], answer.header("x-request-id"), "{problem}");
                asked += 1;
            }
        }
    }
    assert!(asked >= 30, "only {asked} routes were tested");
}
