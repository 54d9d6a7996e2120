//! Wrong requests of every route, table-driven, sent byte for byte as written: the whole answer of each is kept in
//! `bad_requests/answers.txt` and compared; `SDFARM_WRITE_ANSWERS=1` writes it anew. The server lives on.

mod bodies;
mod http;
mod paths;
mod raw;
mod workers;

use std::fmt::Write;

use serde_json::{Value, json};

use crate::jobs;
use crate::support::{Farm, root};
use raw::{Request, exchange};

/// So many wrong requests there must be.
const LEAST: usize = 200;
const WRITE: &str = "SDFARM_WRITE_ANSWERS";

/// What the requests are about; `{job}` in a request stands for its id, and so on.
struct Stage {
    farm: Farm,
    /// Placeholders and what they stand for.
    names: Vec<(&'static str, String)>,
}

impl Stage {
    /// A farm without workers of its own, with a job that waits, and one that a worker of ours has finished.
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
        let picture = b"no picture, but bytes".to_vec();
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
            ("{nobody}", "01900000-0000-7000-8000-000000000000".to_owned()),
            ("{version}", scene::PICTURE_VERSION.to_string()),
        ];
        Self { farm, names }
    }

    /// The text with what its placeholders stand for.
    fn fill(&self, text: &str) -> String {
        self.names.iter().fold(text.to_owned(), |text, (name, value)| text.replace(name, value))
    }

    /// The text with the placeholders back, and every other id hidden.
    fn hide(&self, text: &str) -> String {
        let ids = self.names.iter().filter(|(_, value)| value.len() > 8);
        let text = ids.fold(text.to_owned(), |text, (name, value)| text.replace(value, name));
        let address = self.farm.address.strip_prefix("http://").expect("an address");
        hide_ids(&text.replace(address, "{address}"))
    }
}

/// Whatever looks like a UUID is another one in each run.
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

/// The table.
fn requests() -> Vec<Request> {
    [paths::requests(), bodies::requests(), http::requests(), workers::requests()].concat()
}

#[test]
fn wrong_requests_are_answered_as_they_always_were() {
    let stage = Stage::new();
    let requests = requests();
    assert!(requests.len() >= LEAST, "only {} requests", requests.len());
    let mut names: Vec<&str> = requests.iter().map(|request| request.name.as_str()).collect();
    names.sort_unstable();
    assert!(names.windows(2).all(|pair| pair[0] != pair[1]), "a name is there twice");
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
    assert_eq!(stage.farm.get("/v1/jobs").json()["jobs"].as_array().map(Vec::len), Some(2), "nothing came of any");
    assert!(!stage.farm.log().contains("panicked"), "{}", stage.farm.log());

    let path = root().join("tests/bad_requests/answers.txt");
    if std::env::var_os(WRITE).is_some() {
        return std::fs::write(path, answers).expect("written");
    }
    let kept = std::fs::read_to_string(path).unwrap_or_default();
    let (kept, answers): (Vec<&str>, Vec<&str>) = (kept.split("## ").collect(), answers.split("## ").collect());
    for (want, got) in kept.iter().zip(&answers) {
        assert_eq!(got, want, "an answer has changed: if that is meant, write it anew with {WRITE}=1");
    }
    assert_eq!(kept.len(), answers.len(), "requests are new or gone: write the answers anew with {WRITE}=1");
}

#[test]
fn every_route_with_an_id_refuses_what_is_none() {
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
    assert!(asked >= 30, "only {asked} were asked");
}
