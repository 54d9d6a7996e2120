//! Invalid bodies and content types of the routes for users.

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
    all.push(body(SUBMIT, "more than 8 MiB", vec![b' '; (8 << 20) + 1]));
    all.push(body(RESIZE, "more than 4 KiB", vec![b' '; 5000]));
    all
}
