//! Requests as bytes, and answers as text: nothing is mended on the way.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::Duration;

use serde_json::Value;

/// Nobody answers later.
const PATIENCE: Duration = Duration::from_secs(30);
/// Headers that are a promise.
const KEPT: [&str; 6] = ["allow", "content-type", "content-range", "retry-after", "www-authenticate", "etag"];

/// A wrong request.
#[derive(Clone, Debug)]
pub(super) struct Request {
    /// What is wrong with it.
    pub(super) name: String,
    /// The request line, without the version, and the headers, each on a line.
    pub(super) head: String,
    /// The body.
    pub(super) body: Vec<u8>,
    /// Whether the farm answers it, with a problem; else the HTTP library refuses it, or it is no error.
    pub(super) is_ours: bool,
    /// Whether nothing more is sent after it, although more was promised.
    pub(super) stops: bool,
}

impl Request {
    /// One that the farm answers with a problem.
    pub(super) fn new(name: impl Into<String>, head: impl Into<String>) -> Self {
        Self { name: name.into(), head: head.into(), body: Vec::new(), is_ours: true, stops: false }
    }

    /// With a body.
    pub(super) fn with(self, body: impl Into<Vec<u8>>) -> Self {
        Self { body: body.into(), ..self }
    }

    /// One that is no problem of the farm's.
    pub(super) fn foreign(self) -> Self {
        Self { is_ours: false, ..self }
    }

    /// One that stops midway.
    pub(super) fn stopped(self) -> Self {
        Self { stops: true, ..self }
    }

    /// Its bytes on the wire. What the head does not say is filled in: host, length, and that the connection ends.
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

/// What came back.
pub(super) struct Answer {
    head: String,
    body: String,
}

/// Sends bytes, and reads until the other side has nothing more to say.
pub(super) fn exchange(address: &str, bytes: &[u8], stops: bool) -> Answer {
    let mut connection = TcpStream::connect(address.strip_prefix("http://").expect("an address")).expect("it listens");
    connection.set_read_timeout(Some(PATIENCE)).expect("settable");
    // A server that refuses early may not read all of it.
    let _ = connection.write_all(bytes);
    if stops {
        let _ = connection.shutdown(Shutdown::Write);
    }
    let mut answer = Vec::new();
    // One that closes with bytes unread resets the connection, after its answer.
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

    /// It is no fault of the server's; and if it is the farm's, a problem with a code, words, and its request's id.
    pub(super) fn check(&self, is_ours: bool) -> Result<(), &'static str> {
        let ensure = |is_so: bool, fault: &'static str| if is_so { Ok(()) } else { Err(fault) };
        ensure(self.status() < 500, "a fault of the server's")?;
        if !is_ours {
            return Ok(());
        }
        ensure(self.header("content-type") == Some("application/problem+json"), "no problem")?;
        let problem: Value = serde_json::from_str(&self.body).map_err(|_| "no JSON")?;
        ensure(problem["status"] == self.status(), "another status")?;
        let has = |key: &str| problem[key].as_str().is_some_and(|words| !words.is_empty());
        ensure(["code", "title", "detail", "type"].into_iter().all(has), "not every word")?;
        ensure(has("request_id") && problem["request_id"].as_str() == self.header("x-request-id"), "no request id")
    }

    /// The status, the headers that are a promise, and the body; JSON one key a line.
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
