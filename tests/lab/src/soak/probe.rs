//! Sends minimal HTTP requests: one path on its own connection, reading only the status of the response.
//! A soak uses it to measure the result of an operator's health check.

use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

/// Time limit of a request.
const PROBE_TIMEOUT: Duration = Duration::from_secs(5);
/// `HTTP/1.1 200`
const STATUS_LINE_BYTES: usize = 12;

/// Status of `GET path`; `None` without a response.
pub(super) async fn status(address: &str, path: &str) -> Option<u16> {
    let host = address.strip_prefix("http://")?;
    let request = format!("GET {path} HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\n\r\n");
    let asked = async {
        let mut connection = TcpStream::connect(host).await?;
        connection.write_all(request.as_bytes()).await?;
        let mut line = [0; STATUS_LINE_BYTES];
        connection.read_exact(&mut line).await?;
        std::io::Result::Ok(line)
    };
    let line = tokio::time::timeout(PROBE_TIMEOUT, asked).await.ok()?.ok()?;
    std::str::from_utf8(&line[9..]).ok()?.parse().ok()
}

/// Status of a POST of JSON, and whether the response has a Retry-After.
pub(super) async fn post(address: &str, path: &str, body: &[u8]) -> Option<(u16, bool)> {
    let host = address.strip_prefix("http://")?;
    let head = format!(
        "POST {path} HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\ncontent-type: application/json\r\n\
         cache-control: no-cache\r\ncontent-length: {}\r\n\r\n",
        body.len()
    );
    let asked = async {
        let mut connection = TcpStream::connect(host).await?;
        connection.write_all(head.as_bytes()).await?;
        connection.write_all(body).await?;
        let mut answer = Vec::new();
        connection.read_to_end(&mut answer).await?;
        std::io::Result::Ok(answer)
    };
    let answer = tokio::time::timeout(PROBE_TIMEOUT, asked).await.ok()?.ok()?;
    let head = String::from_utf8_lossy(&answer).to_lowercase();
    let status = head.get(9..STATUS_LINE_BYTES)?.parse().ok()?;
    Some((status, head.contains("\r\nretry-after:")))
}
