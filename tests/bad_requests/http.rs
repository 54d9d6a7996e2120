//! Invalid HTTP: request lines, headers, hosts, origins, lengths, and encodings.
//! The HTTP library rejects some requests itself, without a problem body; those responses are recorded as well.

use super::raw::Request;

/// Invalid requests of this file.
pub(super) fn requests() -> Vec<Request> {
    let mut all = hosts();
    all.extend(lengths());
    all.extend(lines());
    all
}

fn hosts() -> Vec<Request> {
    let mut all = Vec::new();
    for host in
        ["evil.example", "evil.example:80", "localhost.evil.example", "127.0.0.1.evil.example", "", "a b", "[::1"]
    {
        all.push(Request::new(format!("host: {host:?}"), format!("GET /v1/jobs\nhost: {host}")));
    }
    all.push(Request::new("two hosts", "GET /v1/jobs\nhost: 127.0.0.1\nhost: evil.example"));
    all.push(Request::new("no host", "GET /v1/jobs\nx-no-host: 1").foreign());
    for origin in ["http://evil.example", "null", "https://127.0.0.1.evil.example", "file://"] {
        for head in ["POST /v1/jobs", "PUT /v1/pool", "DELETE /v1/jobs/{job}", "POST /v1/jobs/{job}/cancel"] {
            all.push(Request::new(
                format!("{head} from a page of {origin}"),
                format!("{head}\norigin: {origin}\ncontent-type: application/json"),
            ));
        }
    }
    all
}

fn lengths() -> Vec<Request> {
    let submit = |name: &str, headers: &str, body: &[u8]| {
        Request::new(name, format!("POST /v1/jobs\ncontent-type: application/json\n{headers}")).with(body)
    };
    vec![
        submit("a body shorter than its length", "content-length: 100", b"{}").stopped(),
        submit("a negative length", "content-length: -1", b"{}").foreign(),
        submit("a length that is not a number", "content-length: two", b"{}").foreign(),
        submit("two lengths", "content-length: 2\ncontent-length: 3", b"{}").foreign(),
        submit("a length and chunks", "content-length: 2\ntransfer-encoding: chunked", b"2\r\n{}\r\n0\r\n\r\n")
            .foreign(),
        submit("a chunk with an invalid length", "transfer-encoding: chunked", b"zz\r\n{}\r\n0\r\n\r\n"),
        submit("incomplete chunks", "transfer-encoding: chunked", b"ff\r\n{}").stopped(),
        submit("an unknown transfer encoding", "transfer-encoding: rot13", b"{}").foreign(),
        submit("a length out of range", "content-length: 18446744073709551615", b"{}").foreign(),
    ]
}

fn lines() -> Vec<Request> {
    let mut all = vec![
        Request::new("no request", "nonsense").foreign(),
        Request::new("an unknown method", "BREW /v1/jobs"),
        Request::new("a lower-case method", "get /v1/jobs"),
        Request::new("an invalid method", "G(T /v1/jobs").foreign(),
        Request::new("a TRACE request", "TRACE /v1/jobs"),
        Request::new("OPTIONS of all routes", "OPTIONS *"),
        Request::new("a CONNECT request", "CONNECT evil.example:443").foreign(),
        Request::new("a path without a slash", "GET v1/jobs").foreign(),
        Request::new("an absolute URL", "GET http://evil.example/v1/jobs"),
        Request::new("an unsupported HTTP version", "GET /v1/jobs HTTP/3.0").foreign(),
        Request::new("the HTTP/2 preface", "PRI * HTTP/2.0").foreign(),
        Request::new("a header without a colon", "GET /v1/jobs\nnonsense").foreign(),
        Request::new("a header without a name", "GET /v1/jobs\n: value").foreign(),
        Request::new("a header with a space in its name", "GET /v1/jobs\nx y: z").foreign(),
        Request::new("a header with NUL", "GET /v1/jobs\nx-y: a\0b").foreign(),
        Request::new("a folded header", "GET /v1/jobs\nx-y: a\n b").foreign(),
        Request::new("a path of 9000 letters", format!("GET /v1/jobs/{}", "x".repeat(9000))),
        Request::new("a path of 70000 letters", format!("GET /v1/jobs/{}", "x".repeat(70_000))).foreign(),
        Request::new("a header of a megabyte", format!("GET /v1/jobs\nx-y: {}", "z".repeat(1 << 20))).foreign(),
        Request::new("a thousand headers", format!("GET /v1/jobs{}", "\nx-y: z".repeat(1000))).foreign(),
        Request::new("a request id of control characters", "GET /v1/jobs/x\nx-request-id: a\x01b").foreign(),
        Request::new("a request id too long", format!("GET /v1/jobs/x\nx-request-id: {}", "x".repeat(65))),
    ];
    for tag in ["*", "\"nonsense\", *", "W/*"] {
        let head = format!("GET /v1/jobs/{{done}}/image\nif-none-match: {tag}");
        all.push(Request::new(format!("condition: {tag}"), head).foreign());
    }
    all
}
