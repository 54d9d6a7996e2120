//! Sends requests as raw bytes and reads responses as text, so that no library corrects them.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::Duration;

use serde_json::Value;

/// Time limit of a response.
const TIMEOUT: Duration = Duration::from_secs(30);
/// Headers that the API guarantees.
const KEPT: [&str; 7] =
    ["accept-encoding", "allow", "content-type", "content-range", "retry-after", "www-authenticate", "etag"];

/// Invalid request.
#[derive(Clone, Debug)]
pub(super) struct Request {
    /// Name of the error in the request.
    pub(super) name: String,
    /// The request line, without the version, and the headers, each on a line.
    pub(super) head: String,
    /// Body of the request.
    pub(super) body: Vec<u8>,
    /// Whether the farm responds with a problem; otherwise the HTTP library rejects the request, or it is no error.
    pub(super) is_ours: bool,
    /// Whether the body ends before its declared length.
    pub(super) stops: bool,
}

impl Request {
    /// Creates a request to which the farm responds with a problem.
    pub(super) fn new(name: impl Into<String>, head: impl Into<String>) -> Self {
        Self { name: name.into(), head: head.into(), body: Vec::new(), is_ours: true, stops: false }
    }

    /// Sets the body.
    pub(super) fn with(self, body: impl Into<Vec<u8>>) -> Self {
        Self { body: body.into(), ..self }
    }

    /// Marks a request to which the farm does not respond with a problem.
    pub(super) fn foreign(self) -> Self {
        Self { is_ours: false, ..self }
    }

    /// Marks a request whose body is incomplete.
    pub(super) fn stopped(self) -> Self {
        Self { stops: true, ..self }
    }

    /// Returns the bytes to send. Missing headers are added: host, content-length, and connection: close.
    pub(super) fn bytes(&self, fill: impl Fn(&str) -> String) -> Vec<u8> {
        let head = fill(&self.head);
        let (line, headers) = head.split_once('\n').unwrap_or((&head, ""));
        let body = match std::str::from_utf8(&self.body) {
            Ok(text) => fill(text).into_bytes(),
            Err(_) => self.body.clone(),
        };
        let version = if line.contains(" HTTP/") { "" } else { " HTTP/1.1" };
        let mut lines = vec![format!("{line}{version}")];
        lines.extend(headers.lines().map(str::to_owned));
        let lower = headers.to_lowercase();
        for (name, value) in [("host", "127.0.0.1".to_owned()), ("connection", "close".to_owned())] {
            if !lower.contains(&format!("{name}:")) && !lower.contains(&format!("no-{name}")) {
                lines.push(format!("{name}: {value}"));
            }
        }
        if !lower.contains("content-length") && !lower.contains("transfer-encoding") && !body.is_empty() {
            lines.push(format!("content-length: {}", body.len()));
        }
        let mut bytes = (lines.join("\r\n") + "\r\n\r\n").into_bytes();
        bytes.extend(body);
        bytes
    }
}

/// Response as received.
pub(super) struct Answer {
    head: String,
    body: String,
}

/// Sends bytes, and reads until the server closes the connection.
pub(super) fn exchange(address: &str, bytes: &[u8], stops: bool) -> Answer {
    let mut connection = TcpStream::connect(address.strip_prefix("http://").expect("an address")).expect("it listens");
    connection.set_read_timeout(Some(TIMEOUT)).expect("settable");
    // A server that rejects the request early may not read all of it.
    let _ = connection.write_all(bytes);
    if stops {
        let _ = connection.shutdown(Shutdown::Write);
    }
    let mut answer = Vec::new();
    // A server that closes with unread bytes resets the connection after its response.
    let _ = connection.read_to_end(&mut answer);
    let answer = String::from_utf8_lossy(&answer);
    let (head, body) = answer.split_once("\r\n\r\n").unwrap_or((&answer, ""));
    Answer { head: head.to_owned(), body: body.to_owned() }
}

impl Answer {
    fn status(&self) -> u16 {
        self.head.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0)
    }

    fn header(&self, wanted: &str) -> Option<&str> {
        let mut headers = self.head.lines().skip(1).filter_map(|line| line.split_once(": "));
        headers.find(|(name, _)| name.eq_ignore_ascii_case(wanted)).map(|(_, value)| value)
    }

    /// Checks that the status is not 5xx, and that a response of the farm is a problem with all members.
    pub(super) fn check(&self, is_ours: bool) -> Result<(), &'static str> {
        let ensure = |is_so: bool, fault: &'static str| if is_so { Ok(()) } else { Err(fault) };
        ensure(self.status() < 500, "a server error")?;
        if !is_ours {
            return Ok(());
        }
        ensure(self.header("content-type") == Some("application/problem+json"), "not a problem")?;
        let problem: Value = serde_json::from_str(&self.body).map_err(|_| "no JSON")?;
        ensure(problem["status"] == self.status(), "the statuses differ")?;
        let has = |key: &str| problem[key].as_str().is_some_and(|words| !words.is_empty());
        ensure(["code", "title", "detail", "type"].into_iter().all(has), "a member is missing")?;
        ensure(has("request_id") && problem["request_id"].as_str() == self.header("x-request-id"), "no request id")
    }

    /// Formats the status, the guaranteed headers, and the body; JSON with one member per line.
    pub(super) fn text(&self) -> String {
        let mut lines = vec![match self.status() {
            0 => "no answer".to_owned(),
            status => status.to_string(),
        }];
        lines.extend(KEPT.iter().filter_map(|name| Some(format!("{name}: {}", self.header(name)?))));
        match serde_json::from_str::<Value>(&self.body) {
            Ok(mut body) => {
                if let Some(id) = body.get_mut("request_id") {
                    *id = "{request}".into();
                }
                lines.push(format!("{body:#}"));
            }
            Err(_) => lines.extend(self.body.lines().next().map(str::to_owned)),
        }
        lines.join("\n")
    }
}
