//! Invalid paths, methods, ids, frames, and queries.

use super::raw::Request;

/// Routes, and methods that they do not support.
const METHODS: [(&str, &[&str]); 14] = [
    ("/v1/jobs", &["PUT", "DELETE"]),
    ("/v1/jobs/{job}/cancel", &["GET", "PUT", "DELETE"]),
    ("/v1/jobs/{job}", &["POST", "PUT"]),
    ("/v1/jobs/{job}/image", &["POST", "DELETE"]),
    ("/v1/jobs/{job}/frames/0/image", &["PUT", "PATCH"]),
    ("/v1/workers", &["POST", "DELETE"]),
    ("/v1/pool", &["POST", "DELETE", "PATCH"]),
    ("/v1/scaling", &["POST", "PUT"]),
    ("/v1/schema/job", &["POST", "PUT"]),
    ("/livez", &["POST", "DELETE"]),
    ("/readyz", &["PUT"]),
    ("/metrics", &["POST"]),
    ("/v1/worker/register", &["GET", "PUT"]),
    ("/v1/worker/sync", &["GET", "DELETE"]),
];

/// Invalid or unknown job ids.
const IDS: [(&str, &str); 12] = [
    ("a word", "nonsense"),
    ("a number", "1"),
    ("a negative number", "-1"),
    ("an unknown id", "{nobody}"),
    ("an id cut short", "01900000-0000-7000-8000-00000000000"),
    ("an id with a letter too many", "{nobody}0"),
    ("an id with an invalid hex digit", "0190000g-0000-7000-8000-000000000000"),
    ("NUL", "%00"),
    ("bytes that are not UTF-8", "%ff%fe"),
    ("a path traversal", "%2e%2e%2f%2e%2e"),
    ("an SQL injection", "'%20OR%201=1%20--"),
    ("letters of a non-Latin script", "%d1%84%d0%b0%d0%b9%d0%bb"),
];

/// Routes with a job id: the method, and the path before and after the id.
const OF_A_JOB: [(&str, &str, &str); 5] = [
    ("GET", "/v1/jobs/", ""),
    ("DELETE", "/v1/jobs/", ""),
    ("POST", "/v1/jobs/", "/cancel"),
    ("GET", "/v1/jobs/", "/image"),
    ("GET", "/v1/jobs/", "/frames/0/image"),
];

const FRAMES: [&str; 9] = ["1", "-1", "x", "1.5", "4294967295", "4294967296", "99999999999999999999", "%30x", "+-0"];

/// Queries that the list of jobs rejects.
const QUERIES: [&str; 22] = [
    "limit=0",
    "limit=1001",
    "limit=-1",
    "limit=1.5",
    "limit=ten",
    "limit=",
    "limit=99999999999999999999",
    "limit=1&limit=2",
    "limit=0x10",
    "limit=1e2",
    "state=done",
    "state=",
    "state=QUEUED",
    "state=queued&state=running",
    "state=queued%00",
    "cursor=x",
    "cursor=",
    "cursor=-",
    "cursor=1;DROP%20TABLE%20job",
    "cursor=99999999999999999999999",
    "page=2",
    "limit=5&order=name",
];

/// Queries that the number of wanted workers rejects.
const SCALING_QUERIES: [&str; 8] = [
    "target_seconds=0",
    "target_seconds=86401",
    "target_seconds=-1",
    "target_seconds=1.5",
    "target_seconds=",
    "target_seconds=ten",
    "target_seconds=1&target_seconds=2",
    "device=cpu",
];

/// Invalid requests of this file.
pub(super) fn requests() -> Vec<Request> {
    let mut all = Vec::new();
    for path in [
        "/v1",
        "/v1/",
        "/v2/jobs",
        "/v1/job",
        "/v1/jobs/",
        "/v1//jobs",
        "/V1/JOBS",
        "/v1/jobs/{job}/",
        "/favicon.ico",
        "/v1/jobs/{job}/stitches",
        "/v1/jobs/{job}/frames/0",
        "/v1/jobs/{job}/frames//image",
        "/../../etc/passwd",
        "/v1/worker",
        "/v1/worker/tiles",
        "/.env",
    ] {
        all.push(Request::new(format!("no route: {path}"), format!("GET {path}")));
    }
    for (path, methods) in METHODS {
        for method in methods {
            all.push(Request::new(format!("wrong method: {method} {path}"), format!("{method} {path}")));
        }
    }
    for (method, before, after) in OF_A_JOB {
        for (what, id) in IDS {
            let name = format!("{method} {before}ID{after}: the id is {what}");
            all.push(Request::new(name, format!("{method} {before}{id}{after}")));
        }
    }
    for frame in FRAMES {
        let path = format!("/v1/jobs/{{done}}/frames/{frame}/image");
        all.push(Request::new(format!("no frame: {frame}"), format!("GET {path}")));
    }
    all.push(Request::new("frame of an unknown job", "GET /v1/jobs/{nobody}/frames/x/image"));
    all.push(Request::new("picture of a job that waits", "GET /v1/jobs/{job}/image"));
    all.push(Request::new("picture of a frame that waits", "GET /v1/jobs/{job}/frames/0/image"));
    all.push(Request::new("cancel of a job that has ended", "POST /v1/jobs/{done}/cancel"));
    for query in QUERIES {
        all.push(Request::new(format!("list: {query}"), format!("GET /v1/jobs?{query}")));
    }
    for query in SCALING_QUERIES {
        all.push(Request::new(format!("scaling: {query}"), format!("GET /v1/scaling?{query}")));
    }
    for query in ["dry_run=maybe", "dry_run=", "dry_run=1", "dry_run=true&dry_run=true", "dryrun=true"] {
        let head = format!("POST /v1/jobs?{query}\ncontent-type: application/json");
        all.push(Request::new(format!("submit: {query}"), head).with("{}"));
    }
    for range in ["bytes={size}-", "bytes=1000000-2000000", "bytes=-0", "bytes=18446744073709551615-"] {
        let head = format!("GET /v1/jobs/{{done}}/image\nrange: {range}");
        all.push(Request::new(format!("no such range: {range}"), head));
    }
    for range in ["bytes=9-0", "bytes=x-y", "lines=0-1", "bytes=0-1,3-4", "bytes", "bytes=18446744073709551616-"] {
        let head = format!("GET /v1/jobs/{{done}}/image\nrange: {range}");
        all.push(Request::new(format!("range that says nothing: {range}"), head).foreign());
    }
    all
}
