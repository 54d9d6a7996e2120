//! A real S3 store for tests: `SeaweedFS` on loopback, in a temporary folder, with access keys. Packages that need one
//! include this file. `.ci/run` installs the program; without it the tests are skipped.

use std::fs;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use tempfile::TempDir;

use crate::skip::skip;

/// Key that may do everything.
pub(crate) const ACCESS_KEY: &str = "test-access";
/// Its secret.
pub(crate) const SECRET_KEY: &str = "test-secret";
/// Keys: one that may do everything, and one that may only read.
const IDENTITIES: &str = r#"{"identities": [
    {"name": "farm", "credentials": [{"accessKey": "test-access", "secretKey": "test-secret"}], "actions": ["Admin"]},
    {"name": "reader", "credentials": [{"accessKey": "test-reader", "secretKey": "test-secret"}], "actions": ["Read", "List"]}
]}"#;
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Two minutes.
const MAX_POLLS: u32 = 6000;
const ANSWER_TIMEOUT: Duration = Duration::from_mins(1);
/// A port may be taken by another program before `SeaweedFS` listens on it.
const MAX_STARTS: u32 = 5;

/// A running store; it is killed on drop.
pub(crate) struct SeaweedFs {
    child: Child,
    program: PathBuf,
    ports: Vec<u16>,
    folder: TempDir,
}

impl SeaweedFs {
    /// Starts a store, or skips the test.
    pub(crate) fn start() -> Option<Self> {
        let Some(program) = program() else {
            skip("seaweedfs", "SeaweedFS is not installed; the store in a bucket is not tested");
            return None;
        };
        Some((0..MAX_STARTS).find_map(|_| Self::try_start(&program)).expect("SeaweedFS starts"))
    }

    fn try_start(program: &Path) -> Option<Self> {
        let folder = tempfile::tempdir().expect("a folder");
        fs::write(folder.path().join("s3.json"), IDENTITIES).expect("writes");
        let ports = free_ports();
        let child = spawn(program, folder.path(), &ports);
        let mut this = Self { child, program: program.to_owned(), ports, folder };
        this.wait_until_ready().then_some(this)
    }

    /// Kills it; what it has stored is kept.
    pub(crate) fn stop(&mut self) {
        self.child.kill().expect("it runs");
        self.child.wait().expect("it ends");
    }

    /// Starts it again after [`SeaweedFs::stop`], on the same ports.
    pub(crate) fn start_again(&mut self) {
        let is_ready = (0..MAX_STARTS).any(|_| {
            self.child = spawn(&self.program, self.folder.path(), &self.ports);
            self.wait_until_ready()
        });
        assert!(is_ready, "it starts again");
    }

    /// Returns false if it exits first.
    fn wait_until_ready(&mut self) -> bool {
        for _ in 0..MAX_POLLS {
            if self.is_ready() {
                return true;
            }
            if self.child.try_wait().expect("a child process").is_some() {
                return false;
            }
            std::thread::sleep(POLL_INTERVAL);
        }
        false
    }

    /// Whether it rejects a request without a key, and its folders can be made.
    fn is_ready(&self) -> bool {
        http("GET", self.ports[6], "/").is_some_and(|answer| answer.contains(" 403 "))
            && http("POST", self.ports[4], "/buckets/ready/")
                // The folder is there already if it was started again.
                .is_some_and(|answer| answer.contains(" 201 ") || answer.contains(" 409 "))
    }

    /// Makes a bucket.
    pub(crate) fn make_bucket(&self, bucket: &str) {
        let answer = http("POST", self.ports[4], &format!("/buckets/{bucket}/")).expect("an answer");
        assert!(answer.contains(" 201 "), "{answer}");
    }

    /// Names of the objects below a prefix of a bucket.
    pub(crate) fn names(&self, folder: &str) -> Vec<String> {
        // A request without `Accept` would be answered by a page.
        let answer = http("GET", self.ports[4], &format!("/buckets/{folder}/?limit=1000")).expect("an answer");
        let names = answer.split("\"FullPath\":").skip(1).filter_map(|rest| rest.split('"').nth(1));
        names.map(|path| path.rsplit('/').next().unwrap_or_default().to_owned()).collect()
    }

    /// Address of its S3 API.
    pub(crate) fn endpoint(&self) -> String {
        format!("http://127.0.0.1:{}", self.ports[6])
    }

    /// Environment of a program that uses it.
    pub(crate) fn environment(&self) -> [(&'static str, String); 5] {
        [
            ("AWS_ACCESS_KEY_ID", ACCESS_KEY.to_owned()),
            ("AWS_SECRET_ACCESS_KEY", SECRET_KEY.to_owned()),
            ("AWS_REGION", "us-east-1".to_owned()),
            ("AWS_ENDPOINT_URL", self.endpoint()),
            ("AWS_ALLOW_HTTP", "true".to_owned()),
        ]
    }
}

impl Drop for SeaweedFs {
    fn drop(&mut self) {
        // Both fail only if the process has already exited.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn spawn(program: &Path, folder: &Path, ports: &[u16]) -> Child {
    let names = ["master", "volume", "filer", "s3"];
    let flags = names.iter().flat_map(|name| [format!("-{name}.port"), format!("-{name}.port.grpc")]);
    let log = fs::File::create(folder.join("log")).expect("a log");
    Command::new(program)
        .args(["-logtostderr=true", "server", "-ip=127.0.0.1", "-ip.bind=127.0.0.1", "-s3"])
        .args(["-master.telemetry=false", "-master.volumeSizeLimitMB=64", "-volume.max=100"])
        .args(["-master.electionTimeout=1s", "-s3.port.iceberg=0", "-s3.port.lance=0"])
        .arg(format!("-dir={}", folder.display()))
        .arg(format!("-s3.config={}", folder.join("s3.json").display()))
        .args(flags.zip(ports).map(|(flag, port)| format!("{flag}={port}")))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(log)
        .spawn()
        .expect("SeaweedFS starts")
}

/// The program, as `.ci/run` installs it or on the path.
fn program() -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("a package lies in the root");
    let path = std::env::var_os("PATH").unwrap_or_default();
    std::iter::once(root.join(".whl/seaweedfs/bin"))
        .chain(std::env::split_paths(&path))
        .map(|folder| folder.join("weed"))
        .find(|program| program.is_file())
}

fn free_ports() -> Vec<u16> {
    // All are held until the last is chosen, so that they differ.
    let held: Vec<_> = (0..8).map(|_| TcpListener::bind("127.0.0.1:0").expect("a port")).collect();
    held.iter().map(|listener| listener.local_addr().expect("an address").port()).collect()
}

/// Sends a request without a body; `None` if there is no answer.
fn http(method: &str, port: u16, path: &str) -> Option<String> {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).ok()?;
    stream.set_read_timeout(Some(ANSWER_TIMEOUT)).ok()?;
    let host =
        format!("Host: 127.0.0.1:{port}\r\nContent-Length: 0\r\nAccept: application/json\r\nConnection: close\r\n\r\n");
    write!(stream, "{method} {path} HTTP/1.1\r\n{host}").ok()?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer).ok()?;
    Some(answer)
}
