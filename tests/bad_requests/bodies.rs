//! Invalid bodies, content types and content encodings of the routes for users.

use std::io::Write;

use flate2::Compression;
use flate2::write::GzEncoder;
use serde_json::{Value, json};

use super::raw::Request;

const SUBMIT: &str = "POST /v1/jobs";
const RESIZE: &str = "PUT /v1/pool";
const JSON: &str = "content-type: application/json";

/// Bodies that both routes reject.
const BODIES: [(&str, &[u8]); 22] = [
    ("no body", b""),
    ("blanks", b"  \n "),
    ("null", b"null"),
    ("a list", b"[]"),
    ("a word", b"\"job\""),
    ("a number", b"1"),
    ("true", b"true"),
    ("an empty object", b"{}"),
    ("half an object", b"{\"workers\": "),
    ("a comma too many", b"{\"workers\": 1,}"),
    ("a comment", b"{} // nothing"),
    ("two objects", b"{} {}"),
    ("single quotes", b"{'workers': 1}"),
    ("a byte order mark", b"\xef\xbb\xbf{}"),
    ("UTF-16", b"{\0}\0"),
    ("bytes that are not UTF-8", b"{\"\xff\": 1}"),
    ("half a surrogate pair", b"{\"\\ud800\": 1}"),
    ("a control character", b"{\"a\x01\": 1}"),
    ("NaN", b"{\"workers\": NaN}"),
    ("a number out of range", b"{\"workers\": 1e999}"),
    ("a duplicate member", b"{\"workers\": 1, \"workers\": 2}"),
    ("an unknown member", b"{\"colour\": 1}"),
];

fn typed(route: &str, name: &str, content_type: &str) -> Request {
    Request::new(format!("{route}: {name}"), format!("{route}\ncontent-type: {content_type}")).with("{}")
}

fn body(route: &str, name: &str, body: impl Into<Vec<u8>>) -> Request {
    Request::new(format!("{route}: {name}"), format!("{route}\n{JSON}")).with(body)
}

/// Invalid requests of this file.
pub(super) fn requests() -> Vec<Request> {
    let mut all = Vec::new();
    for route in [SUBMIT, RESIZE] {
        for (name, content_type) in [
            ("plain text", "text/plain"),
            ("a form", "application/x-www-form-urlencoded"),
            ("parts", "multipart/form-data; boundary=x"),
            ("XML", "application/xml"),
            ("bytes", "application/octet-stream"),
            ("no content type", ""),
            ("an invalid content type", "json"),
            ("a list of types", "application/json, text/plain"),
        ] {
            all.push(typed(route, name, content_type));
        }
        for (name, text) in BODIES {
            all.push(body(route, name, text));
        }
        all.push(body(route, "nested lists", "[".repeat(2000)));
        all.push(body(route, "nested objects", "{\"a\":".repeat(2000)));
    }
    for (name, text) in [
        ("a negative number of workers", r#"{"workers": -1}"#),
        ("too many", r#"{"workers": 257}"#),
        ("a number of workers out of range", r#"{"workers": 99999999999999999999}"#),
        ("a fractional number of workers", r#"{"workers": 1.5}"#),
        ("a string instead of a number", r#"{"workers": "4"}"#),
        ("null instead of a number", r#"{"workers": null}"#),
        ("a list instead of a number", r#"{"workers": [1]}"#),
        ("an additional member", r#"{"workers": 1, "ready": 1}"#),
    ] {
        all.push(body(RESIZE, name, text));
    }
    all.push(body(SUBMIT, "more than 32 MiB", vec![b' '; (32 << 20) + 1]));
    all.push(body(RESIZE, "more than 4 KiB", vec![b' '; 5000]));
    all.extend(encodings());
    all.extend(scenes());
    all
}

fn gzip(content: &[u8]) -> Vec<u8> {
    let mut writer = GzEncoder::new(Vec::new(), Compression::default());
    writer.write_all(content).and_then(|()| writer.finish()).expect("written to memory")
}

/// Bodies that cannot be unpacked, or not to a job.
fn encodings() -> Vec<Request> {
    let encoded = |route: &str, name: &str, encoding: &str, bytes: Vec<u8>| {
        Request::new(format!("{route}: {name}"), format!("{route}\n{JSON}\ncontent-encoding: {encoding}")).with(bytes)
    };
    let packed = gzip(&vec![b' '; 9000]);
    let mut changed = packed.clone();
    // The last eight bytes are a checksum and the size.
    changed[packed.len() - 8] ^= 1;
    let gigabyte = gzip(&vec![b' '; 1 << 20]).repeat(1 << 10);
    let resubmit = "POST /v1/jobs/{done}/resubmit";
    let zstd_magic = [0x28, 0xb5, 0x2f, 0xfd];
    vec![
        encoded(SUBMIT, "an unknown content encoding", "br", b"{}".to_vec()),
        encoded(SUBMIT, "two content encodings", "gzip, zstd", packed.clone()),
        encoded(resubmit, "an unknown content encoding", "deflate", b"{}".to_vec()),
        encoded(RESIZE, "a content encoding", "gzip", gzip(br#"{"workers": 1}"#)),
        encoded(SUBMIT, "half a gzip body", "gzip", packed[..packed.len() / 2].to_vec()),
        encoded(SUBMIT, "a gzip body with a wrong checksum", "gzip", changed),
        encoded(SUBMIT, "JSON that is called gzip", "gzip", b"{}".to_vec()),
        encoded(SUBMIT, "gzip with something behind it", "gzip", [gzip(b"{}"), b"{}".to_vec()].concat()),
        encoded(SUBMIT, "an empty gzip body", "gzip", Vec::new()),
        encoded(SUBMIT, "JSON that is called zstd", "zstd", b"{}".to_vec()),
        encoded(SUBMIT, "half a zstd body", "zstd", zstd_magic.to_vec()),
        encoded(
            SUBMIT,
            "a zstd body with a window of 16 MiB",
            "zstd",
            [&zstd_magic[..], &[0, 14 << 3, 1, 0, 0]].concat(),
        ),
        encoded(SUBMIT, "a gzip body of an invalid job", "gzip", gzip(b"{}")),
        encoded(SUBMIT, "a gzip body that unpacks to a gigabyte", "gzip", gigabyte.clone()),
        encoded("POST /v1/jobs?dry_run=true", "a gzip body that unpacks to a gigabyte", "gzip", gigabyte.clone()),
        encoded(resubmit, "a gzip body that unpacks to a gigabyte", "gzip", gigabyte),
    ]
}

/// A job with these named shapes and objects.
fn job(shapes: &Value, objects: &[Value]) -> String {
    let objects: Vec<Value> = objects.iter().map(|shape| json!({ "shape": shape })).collect();
    json!({
        "scene": { "camera": { "position": [0, 0, 5], "look_at": [0, 0, 0] }, "shapes": shapes, "objects": objects },
        "image": { "width": 32, "height": 32 },
    })
    .to_string()
}

/// Scenes that are too large, or endless.
fn scenes() -> Vec<Request> {
    let sphere = json!({ "sphere": { "radius": 1 } });
    let grid = |counts: [u32; 3]| json!({ "copies": { "child": sphere, "at": { "grid": counts, "step": [3, 3, 3] } } });
    let scatter =
        json!({ "scatter": { "of": [sphere], "count": 9000, "within": { "disc": { "radius": 1 } }, "apart": 0.5 } });
    let cycle = json!({ "a": { "use": "b" }, "b": { "union": { "of": [sphere, { "use": "a" }] } } });
    let ten = |name: &str| json!({ "union": { "of": vec![json!({ "use": name }); 10] } });
    let thousands = json!({ "tens": ten("one"), "hundreds": ten("tens"), "thousands": ten("hundreds"), "one": sphere });
    let million = json!({ "copies": { "child": { "use": "thousands" }, "at": { "ring": 1000, "radius": 9 } } });
    vec![
        body(SUBMIT, "a cycle of shapes", job(&cycle, &[json!({ "use": "a" })])),
        body(SUBMIT, "10⁹ copies", job(&json!({}), &[grid([1000, 1000, 1000])])),
        body(SUBMIT, "1,000,001 nodes", job(&json!({}), &[grid([1000, 1000, 1])])),
        body(SUBMIT, "more than 1,000,000 nodes by shapes", job(&thousands, &[million])),
        body(SUBMIT, "a scatter that does not fit", job(&json!({}), std::slice::from_ref(&scatter))),
        body(SUBMIT, "a cycle, 10⁹ copies and a scatter", job(&cycle, &[grid([1000, 1000, 1000]), scatter.clone()])),
        body(SUBMIT, "a cycle, 1,000,001 nodes and a scatter", job(&cycle, &[grid([1000, 1000, 1]), scatter])),
    ]
}
