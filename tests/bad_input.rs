//! Tests invalid jobs from a table: each is rejected over HTTP with its status, pointer, line, column and fix, and by
//! `sdfarm check` with exit code 2; the server keeps running.

mod animation;
mod language;

use serde_json::Value;

use crate::jobs;
use crate::support::{Farm, finish, sdfarm, text};

/// Marks the expected position of the error in a case's text.
const MARK: char = '¤';

const SOUND: &str = r#"{
  "scene": {
    "camera": { "position": [0, 0, 5], "look_at": [0, 0, 0] },
    "materials": { "clay": { "diffuse": {} } },
    "objects": [
      { "material": "clay", "shape": { "sphere": { "radius": 1 } } }
    ]
  },
  "image": { "width": 32, "height": 32 }
}"#;

/// Invalid job, and the expected error.
struct Case {
    name: &'static str,
    text: Vec<u8>,
    status: u16,
    /// Position of the first error; `None` if none is expected.
    fault: Option<Position>,
    /// Words of the message that name the fix or the limit.
    says: &'static str,
}

struct Position {
    pointer: String,
    /// Line and column; `None` if they are not guaranteed.
    at: Option<(u64, u64)>,
}

/// Replaces one part of the valid job; the mark is the position of the error.
fn changed(name: &'static str, from: &str, to: &str, pointer: &str, says: &'static str) -> Case {
    assert_eq!(SOUND.matches(from).count(), 1, "{name}: {from:?} must be in the valid job once");
    written(name, &SOUND.replacen(from, to, 1), 422, pointer, says)
}

fn written(name: &'static str, marked: &str, status: u16, pointer: &str, says: &'static str) -> Case {
    let offset = marked.find(MARK).unwrap_or_else(|| panic!("{name}: no mark"));
    let before = &marked[..offset];
    let line = before.matches('\n').count() + 1;
    let column = before.len() - before.rfind('\n').map_or(0, |newline| newline + 1) + 1;
    let at = Some((line as u64, column as u64));
    Case {
        name,
        text: marked.replacen(MARK, "", 1).into_bytes(),
        status,
        fault: Some(Position { pointer: pointer.to_owned(), at }),
        says,
    }
}

/// Replaces the sphere of the valid job with another node.
fn with_shape(shape: &str) -> String {
    SOUND.replacen(r#"{ "sphere": { "radius": 1 } }"#, shape, 1)
}

fn nested(depth: usize) -> String {
    let open = r#"{"translate": {"by": [0,0,0], "child": "#.repeat(depth - 1);
    with_shape(&format!(r#"{open}{{"sphere": {{"radius": 1}}}}{}"#, "}}".repeat(depth - 1)))
}

fn wide(nodes: usize) -> String {
    let spheres = vec![r#"{"sphere":{"radius":1}}"#; nodes - 1].join(",");
    with_shape(&format!(r#"{{"union": {{"of": [{spheres}]}}}}"#))
}

fn large(name: &'static str, text: String, pointer: Option<&'static str>, status: u16, says: &'static str) -> Case {
    Case {
        name,
        text: text.into_bytes(),
        status,
        fault: pointer.map(|pointer| Position { pointer: pointer.to_owned(), at: None }),
        says,
    }
}

const OBJECT: &str = "/scene/objects/0";
const RADIUS: &str = "/scene/objects/0/shape/sphere/radius";
const LOOK_AT: &str = r#""look_at": [0, 0, 0]"#;
const SPHERE: &str = r#"{ "sphere": { "radius": 1 } }"#;

fn wrong_form() -> Vec<Case> {
    vec![
        changed(
            "unknown key",
            r#""radius": 1"#,
            r#""radius": 1, ¤"colour": 2"#,
            "/scene/objects/0/shape/sphere/colour",
            "radius",
        ),
        changed("unknown node", r#""sphere""#, r#"¤"spere""#, "/scene/objects/0/shape/spere", "sphere"),
        changed("duplicate key", r#""radius": 1"#, r#""radius": 1, ¤"radius": 2"#, RADIUS, "duplicate key"),
        changed(
            "duplicate key spelled otherwise",
            r#""radius": 1"#,
            r#""radius": 1, ¤"r\u0061dius": 2"#,
            RADIUS,
            "duplicate key",
        ),
        changed("missing key", r#"{ "width": 32, "height": 32 }"#, r#"¤{ "width": 32 }"#, "/image", "height"),
        changed("wrong type", r#""radius": 1"#, r#""radius": ¤"one""#, RADIUS, "number"),
        changed("null", r#""radius": 1"#, r#""radius": ¤null"#, RADIUS, "number"),
        changed("too few numbers", r#""look_at": [0, 0, 0]"#, r#""look_at": ¤[0, 0]"#, "/scene/camera/look_at", "3"),
        changed("negative radius", r#""radius": 1"#, r#""radius": ¤-1"#, RADIUS, "from 1e-6"),
        changed("radius of zero", r#""radius": 1"#, r#""radius": ¤0"#, RADIUS, "from 1e-6"),
        changed("too large for f32", r#""radius": 1"#, r#""radius": ¤1e39"#, RADIUS, "too large"),
        changed("samples of zero", r#""height": 32"#, r#""height": 32, "samples": ¤0"#, "/image/samples", "1"),
        changed("picture of no width", r#""width": 32"#, r#""width": ¤0"#, "/image/width", "1"),
        changed(
            "picture of 2^31 pixels",
            r#""width": 32, "height": 32"#,
            r#""width": ¤2147483648, "height": 1"#,
            "/image/width",
            "65535",
        ),
        changed(
            "half a sample",
            r#""height": 32"#,
            r#""height": 32, "samples": ¤1.5"#,
            "/image/samples",
            "whole number",
        ),
        changed("unknown format", r#""height": 32"#, r#""height": 32, "format": ¤"jpg""#, "/image/format", "png"),
        changed("fov of 0", LOOK_AT, r#""look_at": [0, 0, 0], "fov": ¤0"#, "/scene/camera/fov", "179 degrees"),
        changed("fov of 180", LOOK_AT, r#""look_at": [0, 0, 0], "fov": ¤180"#, "/scene/camera/fov", "179 degrees"),
        changed(
            "f-number of 0",
            LOOK_AT,
            r#""look_at": [0, 0, 0], "lens": { "f_stop": ¤0, "focal_length": 1, "focus": 4 }"#,
            "/scene/camera/lens/f_stop",
            "from 0.1 to 1000",
        ),
        changed(
            "aperture of three blades",
            LOOK_AT,
            r#""look_at": [0, 0, 0], "lens": { "aperture": 1, "focus": 4, "blades": ¤3 }"#,
            "/scene/camera/lens/blades",
            "5 to 16",
        ),
        changed("priority beyond its range", r#""image""#, r#""priority": ¤101, "image""#, "/priority", "100"),
        changed(
            "coordinate beyond a million",
            r#""position": [0, 0, 5]"#,
            r#""position": [0, 0, ¤1e7]"#,
            "/scene/camera/position/2",
            "1e6",
        ),
    ]
}

fn wrong_meaning() -> Vec<Case> {
    vec![
        changed(
            "direction of no length",
            r#""materials""#,
            r#""lights": [{ "directional": { "direction": ¤[0, 0, 0], "color": [1, 1, 1] } }], "materials""#,
            "/scene/lights/0/directional/direction",
            "length",
        ),
        changed(
            "normal of no length",
            SPHERE,
            r#"{ "plane": { "normal": ¤[0, 0, 0], "offset": 0 } }"#,
            "/scene/objects/0/shape/plane/normal",
            "length",
        ),
        changed("look_at is the position", LOOK_AT, r#""look_at": ¤[0, 0, 5]"#, "/scene/camera/look_at", "position"),
        changed("up along the view", LOOK_AT, r#""look_at": [0, 0, 0], "up": ¤[0, 0, 2]"#, "/scene/camera/up", "view"),
        changed("up of no length", LOOK_AT, r#""look_at": [0, 0, 0], "up": ¤[0, 0, 0]"#, "/scene/camera/up", "length"),
        changed(
            "lens focused behind the camera",
            LOOK_AT,
            r#""look_at": [0, 0, 0], "lens": { "aperture": 1, "focus": ¤[0, 0, 6] }"#,
            "/scene/camera/lens/focus",
            "farther along the view",
        ),
        changed(
            "f-number without a focal length",
            LOOK_AT,
            r#""look_at": [0, 0, 0], "lens": { "f_stop": ¤2.8, "focus": 4 }"#,
            "/scene/camera/lens/f_stop",
            "focal_length",
        ),
        changed(
            "unknown material",
            r#""material": "clay""#,
            r#""material": ¤"play""#,
            "/scene/objects/0/material",
            "clay",
        ),
        changed(
            "nothing united",
            SPHERE,
            r#"{ "union": { "of": ¤[] } }"#,
            "/scene/objects/0/shape/union/of",
            "or more",
        ),
        changed("layers in a PNG", r#""height": 32"#, r#""height": 32, "layers": ¤["depth"]"#, "/image/layers", "exr"),
        written(
            "no objects",
            &SOUND.replacen(r#""objects": ["#, r#""objects": ¤["#, 1).replacen(
                r#"{ "material": "clay", "shape": { "sphere": { "radius": 1 } } }"#,
                "",
                1,
            ),
            422,
            "/scene/objects",
            "or more",
        ),
    ]
}

fn not_json() -> Vec<Case> {
    let cut = &SOUND[..SOUND.find("\"shape\"").expect("in the valid job")];
    let mut bytes = SOUND.as_bytes().to_vec();
    bytes[20] = 0xff;
    vec![
        written("NaN", &SOUND.replacen(r#""radius": 1"#, r#""radius": ¤NaN"#, 1), 400, "", "NaN"),
        Case {
            name: "1e999",
            text: SOUND.replacen(r#""radius": 1"#, r#""radius": 1e999"#, 1).into_bytes(),
            status: 422,
            fault: Some(Position { pointer: RADIUS.to_owned(), at: None }),
            says: "too large",
        },
        large("truncated JSON", cut.to_owned(), Some(""), 400, "EOF"),
        large("byte order mark", format!("\u{feff}{SOUND}"), Some(""), 400, "byte order mark"),
        large("nothing at all", String::new(), Some(""), 400, "EOF"),
        large("more after the job", format!("{SOUND} {{}}"), Some(""), 400, "one job"),
        Case {
            name: "invalid UTF-8",
            text: bytes,
            status: 400,
            fault: Some(Position { pointer: String::new(), at: None }),
            says: "UTF-8",
        },
    ]
}

fn too_much() -> Vec<Case> {
    vec![
        large("nodes 65 deep", nested(65), Some(OBJECT), 422, "64"),
        large("nodes 5,000 deep", nested(5000), Some(OBJECT), 422, "64"),
        large("arrays 100,000 deep", "[".repeat(100_000), None, 422, "256"),
        large("1,000,001 nodes", wide(1_000_001), Some(""), 422, "1000000"),
    ]
}

fn cases() -> Vec<Case> {
    [wrong_form(), animation::cases(), wrong_meaning(), language::cases(), not_json(), too_much()]
        .into_iter()
        .flatten()
        .collect()
}

/// Compares a reported error with the expected one; returns the difference, if any.
fn misfit(case: &Case, pointer: &str, message: &str, line: u64, column: u64) -> Option<String> {
    let place = case.fault.as_ref()?;
    // Invalid JSON has no pointer but the root; without a guaranteed position, the subtree is enough.
    let is_exact = place.at.is_some() || case.status == 400;
    if pointer != place.pointer && (is_exact || !pointer.starts_with(&place.pointer)) {
        return Some(format!("points at {pointer:?}, not {:?}", place.pointer));
    }
    if place.at.is_some_and(|at| at != (line, column)) {
        return Some(format!("is at {line}:{column}, not {:?}", place.at));
    }
    if line == 0 || column == 0 {
        return Some("lines and columns count from 1".to_owned());
    }
    (!message.contains(case.says)).then(|| format!("says {message:?} and not {:?}", case.says))
}

#[test]
fn invalid_jobs_are_rejected_over_http_with_position_and_fix() {
    let farm = Farm::start(&["--workers", "0"]);
    assert_eq!(farm.post(SOUND).status, 201, "the valid job is accepted");
    let mut wrong = Vec::new();
    for case in cases() {
        let answer = farm.send("POST", "/v1/jobs", &[("content-type", "application/json")], case.text.clone());
        if answer.status != case.status || answer.header("content-type") != "application/problem+json" {
            wrong.push(format!("{}: {} {}", case.name, answer.status, answer.text()));
            continue;
        }
        let problem = answer.json();
        let fault = &problem["errors"][0];
        let (pointer, message) = (fault["pointer"].as_str(), fault["message"].as_str());
        let (line, column) = (fault["line"].as_u64(), fault["column"].as_u64());
        let misfit = match (pointer, message, line, column) {
            (Some(pointer), Some(message), Some(line), Some(column)) => misfit(&case, pointer, message, line, column),
            _ => Some(format!("incomplete error: {problem}")),
        };
        wrong.extend(misfit.map(|misfit| format!("{}: {misfit}", case.name)));
    }
    assert!(wrong.is_empty(), "{} cases:\n{}", wrong.len(), wrong.join("\n"));
    assert_eq!(farm.get("/livez").status, 200);
    assert_eq!(farm.get("/v1/jobs").json()["jobs"].as_array().map(Vec::len), Some(1), "only the valid job exists");
}

#[test]
fn invalid_jobs_are_rejected_by_check_with_position_and_fix() {
    let mut wrong = Vec::new();
    for case in cases() {
        let output = finish(sdfarm(&["check", "-"]), &case.text);
        let printed = text(&output.stderr);
        let place =
            case.fault.as_ref().and_then(|place| place.at).map(|(line, column)| format!("<stdin>:{line}:{column}: "));
        let is_right = output.status.code() == Some(2)
            && printed.lines().last().is_some_and(|line| line.starts_with("error: "))
            && place.is_none_or(|place| printed.contains(&place))
            && printed.contains(case.says)
            && !printed.contains("panicked");
        if !is_right {
            wrong.push(format!("{}: {:?}: {printed}", case.name, output.status.code()));
        }
    }
    assert!(wrong.is_empty(), "{} cases:\n{}", wrong.len(), wrong.join("\n"));
}

/// Jobs of `several.txt` without their marks, each with its expected errors, one per line.
fn several() -> Vec<(String, Vec<(String, String)>)> {
    let text = include_str!("bad_input/several.txt");
    let cases = text.split("\n## ").skip(1).map(|case| {
        let (_, case) = case.split_once('\n').expect("a name");
        let (job, expected) = case.split_once("\n-- ").expect("expected errors");
        let job = job.strip_prefix("OBJECTS\n").map_or_else(
            || job.to_owned(),
            |objects| SOUND.replacen(r#"{ "material": "clay", "shape": { "sphere": { "radius": 1 } } }"#, objects, 1),
        );
        let expected =
            expected.trim_end().split("\n-- ").map(|line| line.split_once(" | ").expect("a pointer and words"));
        (job.replace(MARK, ""), expected.map(|(pointer, words)| (pointer.to_owned(), words.to_owned())).collect())
    });
    cases.collect()
}

#[test]
fn all_errors_of_a_job_are_reported_together() {
    let farm = Farm::start(&["--workers", "0"]);
    let cases = several();
    assert!(cases.len() >= 20, "only {}", cases.len());
    for (job, expected) in cases {
        let problem = farm.post(&job).problem(422, "wrong_job");
        let faults = problem["errors"].as_array().expect("faults");
        assert_eq!(faults.len(), expected.len(), "{problem:#}\n{job}");
        for (fault, (pointer, words)) in faults.iter().zip(&expected) {
            assert_eq!(fault["pointer"], *pointer, "{problem:#}");
            assert!(fault["message"].as_str().is_some_and(|message| message.contains(words)), "{words}: {fault}");
        }
    }
}

#[test]
fn check_prints_errors_and_size_as_json() {
    let (job, expected) = several().swap_remove(0);
    let output = finish(sdfarm(&["check", "--json", "-"]), job.as_bytes());
    let value: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!((output.status.code(), &value["valid"]), (Some(2), &Value::from(false)));
    assert_eq!(value["errors"].as_array().map(Vec::len), Some(expected.len()), "{value:#}");
    let output = finish(sdfarm(&["check", "--json", "-"]), SOUND.as_bytes());
    let value: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!((output.status.code(), &value["valid"]), (Some(0), &Value::from(true)));
    assert_eq!((&value["nodes"], &value["rays"], &value["tiles"]), (&1.into(), &4096.into(), &1.into()), "{value:#}");
    assert!(value["estimate"]["core_seconds"].as_f64().is_some_and(|seconds| seconds > 0.0), "{value:#}");
    let output = finish(sdfarm(&["check", "-"]), SOUND.as_bytes());
    let said = text(&output.stdout);
    assert!(said.contains("1 node in 1 object") && said.contains("1 frame of 32×32"), "{said}");
}

#[test]
fn all_semantic_errors_are_reported_together() {
    let job = SOUND.replacen(r#""material": "clay""#, r#""material": "play""#, 1);
    let job = job.replacen(LOOK_AT, r#""look_at": [0, 0, 5]"#, 1);
    let output = finish(sdfarm(&["check", "-"]), job.as_bytes());
    let printed = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2));
    assert!(printed.contains("/scene/camera/look_at") && printed.contains("/scene/objects/0/material"), "{printed}");
}

#[test]
fn frame_beyond_the_end_is_rejected_with_the_valid_range() {
    let output = finish(sdfarm(&["render", "-", "--frame", "1", "--output", "-"]), SOUND.as_bytes());
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("frames 0 to 0"), "{}", text(&output.stderr));
}

#[test]
fn suspicious_scene_is_accepted_with_a_warning() {
    let farm = Farm::start(&["--workers", "0"]);
    let inside = SOUND.replacen("[0, 0, 5]", "[0, 0, 0.5]", 1);
    let warns = |value: &Value| value["warnings"][0].as_str().is_some_and(|text| text.contains("inside object 0"));
    let headers = [("content-type", "application/json")];
    let dry = farm.send("POST", "/v1/jobs?dry_run=true", &headers, inside.as_bytes().to_vec());
    assert!(dry.status == 200 && warns(&dry.json()), "{}", dry.text());
    let id = farm.accept(&inside);
    assert!(warns(&farm.get(&format!("/v1/jobs/{id}")).json()));
    let output = finish(sdfarm(&["check", "-"]), inside.as_bytes());
    assert!(output.status.success() && text(&output.stderr).contains("warning: the camera is inside object 0"));
}

#[test]
fn body_over_the_limit_is_rejected() {
    let farm = Farm::start(&["--workers", "0"]);
    let padded = format!("{SOUND}{}", " ".repeat(32 << 20));
    let problem = farm.post(&padded).problem(413, "too_large");
    assert!(problem["detail"].as_str().is_some_and(|detail| detail.contains("33554432")), "{problem}");
    let output = finish(sdfarm(&["check", "-"]), padded.as_bytes());
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("32 MiB"), "{}", text(&output.stderr));
}

#[test]
fn wrong_content_type_is_rejected_and_missing_is_json() {
    let farm = Farm::start(&["--workers", "0"]);
    let send = |headers: &[(&str, &str)]| farm.send("POST", "/v1/jobs", headers, SOUND.as_bytes().to_vec());
    let problem = send(&[("content-type", "text/plain")]).problem(415, "wrong_content_type");
    assert!(problem["detail"].as_str().is_some_and(|detail| detail.contains("application/json")), "{problem}");
    assert_eq!(send(&[]).status, 201);
    assert_eq!(send(&[("content-type", "application/json; charset=utf-8")]).status, 201);
}

#[test]
fn unknown_resources_are_not_found() {
    let farm = Farm::start(&["--workers", "0"]);
    let unknown = "/v1/jobs/01890000-0000-7000-8000-000000000000";
    farm.get(unknown).problem(404, "unknown_job");
    farm.get(&format!("{unknown}/image")).problem(404, "unknown_job");
    farm.send("POST", &format!("{unknown}/cancel"), &[], Vec::new()).problem(404, "unknown_job");
    farm.send("DELETE", unknown, &[], Vec::new()).problem(404, "unknown_job");
    let malformed = farm.get("/v1/jobs/seven");
    assert!([400, 404].contains(&malformed.status), "{}", malformed.text());
    assert_eq!(malformed.header("content-type"), "application/problem+json");

    let id = farm.accept(&jobs::quick().to_string());
    let absent = farm.get(&format!("/v1/jobs/{id}/image")).problem(404, "picture_not_stored");
    assert!(absent["detail"].as_str().is_some_and(|detail| detail.contains("not stored yet")), "{absent}");
    farm.get(&format!("/v1/jobs/{id}/frames/7/image")).problem(404, "unknown_frame");
    let wrong_method = farm.send("PATCH", "/v1/pool", &[], Vec::new());
    assert_eq!((wrong_method.status, wrong_method.header("content-type")), (405, "application/problem+json"));
}

#[test]
fn invalid_pool_sizes_are_rejected_with_the_range() {
    let farm = Farm::start(&["--workers", "0"]);
    for body in [r#"{"workers": -1}"#, r#"{"workers": 10000}"#, r#"{"workers": 257}"#, r#"{"workers": 1.5}"#, "{}", "7"]
    {
        let headers = [("content-type", "application/json")];
        let answer = farm.send("PUT", "/v1/pool", &headers, body.as_bytes().to_vec());
        assert_eq!((answer.status, answer.header("content-type")), (422, "application/problem+json"), "{body}");
        if body.contains('0') || body.contains('-') {
            assert!(answer.text().contains("256"), "{body}: {}", answer.text());
        }
    }
    for size in ["-1", "10000"] {
        let output = crate::support::run(&["pool", "--server", &farm.address, size]);
        assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    }
    assert_eq!(farm.get("/v1/pool").json()["workers"], Value::from(0));
}

#[test]
fn unknown_host_header_is_rejected() {
    let farm = Farm::start(&["--workers", "0"]);
    for host in ["evil.example", "evil.example:8080", "127.0.0.1.evil.example"] {
        let answer = farm.send("GET", "/v1/jobs", &[("host", host)], Vec::new());
        assert!((400..500).contains(&answer.status), "{host}: {}", answer.status);
        assert_eq!(answer.header("content-type"), "application/problem+json");
        assert!(answer.text().contains("--host"), "{}", answer.text());
    }
    let port = farm.address.rsplit(':').next().expect("a port");
    for host in [format!("localhost:{port}"), format!("127.0.0.1:{port}"), format!("[::1]:{port}")] {
        assert_eq!(farm.send("GET", "/v1/jobs", &[("host", &host)], Vec::new()).status, 200, "{host}");
    }
}
