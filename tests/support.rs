//! Shared helpers of the tests: running the binary, sending HTTP requests, and waiting with a deadline.
//! Every process started here is killed on drop, and every wait has a deadline.

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use tempfile::TempDir;

use crate::postgres_server;

/// The binary under test.
pub(crate) const PROGRAM: &str = env!("CARGO_BIN_EXE_sdfarm");
/// Deadline of all waits, longer than any step needs on a slow machine.
pub(crate) const DEADLINE: Duration = Duration::from_mins(15);
const POLL_INTERVAL: Duration = Duration::from_millis(5);

/// Polls until there is a value; panics at the deadline.
pub(crate) fn eventually<T>(what: &str, mut ask: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(answer) = ask() {
            return answer;
        }
        assert!(start.elapsed() < DEADLINE, "not within {DEADLINE:?}: {what}");
        std::thread::sleep(POLL_INTERVAL);
    }
}

/// Polls a job's view, with these headers, until its state is as asked for.
pub(crate) fn wait_for_state(
    farm: &Farm,
    path: &str,
    headers: &[(&str, &str)],
    what: &str,
    is_reached: impl Fn(&str) -> bool,
) {
    eventually(&format!("{path} has {what}"), || {
        let answer = farm.send("GET", path, headers, Vec::new());
        assert_eq!(answer.status, 200, "{}", answer.text());
        is_reached(answer.json()["state"].as_str().expect("a state")).then_some(())
    });
}

/// Root folder of the project.
pub(crate) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("cli/ lies in the root")
}

/// Command of the program, without variables that set its flags.
pub(crate) fn sdfarm(arguments: &[&str]) -> Command {
    let mut command = Command::new(PROGRAM);
    clean(&mut command).args(arguments);
    command
}

/// Removes every variable that sets a flag of the program.
pub(crate) fn clean(command: &mut Command) -> &mut Command {
    for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("SDFARM_")) {
        command.env_remove(name);
    }
    command
}

/// Runs a command to its end, within the deadline.
pub(crate) fn finish(mut command: Command, input: &[u8]) -> Output {
    let mut child = command
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut stdin = child.stdin.take().expect("piped");
    let input = input.to_owned();
    // A program that rejects its input may close it early.
    let writer = std::thread::spawn(move || drop(stdin.write_all(&input)));
    let stdout = drain(child.stdout.take().expect("piped"));
    let stderr = drain(child.stderr.take().expect("piped"));
    let status = wait(&mut child);
    writer.join().expect("written");
    Output { status, stdout: stdout.join().expect("read"), stderr: stderr.join().expect("read") }
}

/// Runs `sdfarm` to its end.
pub(crate) fn run(arguments: &[&str]) -> Output {
    finish(sdfarm(arguments), b"")
}

/// Runs `sdfarm`, which must succeed; returns its standard output.
pub(crate) fn succeed(arguments: &[&str]) -> String {
    let output = run(arguments);
    assert!(output.status.success(), "sdfarm {arguments:?}: {}", text(&output.stderr));
    text(&output.stdout)
}

/// Creates a key of the farm in a folder, on PostgreSQL if its server is; returns its `Authorization` header.
pub(crate) fn new_key(folder: &Path, name: &str, scope: &str) -> String {
    let data = folder.join("data");
    let mut command = sdfarm(&["key", "new", name, "--scope", scope, "--data"]);
    command.arg(&data);
    if let Some(database) = postgres_server::database_of(&data) {
        command.env("SDFARM_DATABASE", database);
    }
    let output = finish(command, b"");
    assert!(output.status.success(), "a key for {name}: {}", text(&output.stderr));
    format!("Bearer {}", text(&output.stdout).trim())
}

/// Waits for a child until the deadline, then kills it.
pub(crate) fn wait(child: &mut Child) -> ExitStatus {
    let start = Instant::now();
    loop {
        if let Some(status) = child.try_wait().expect("a child process") {
            return status;
        }
        if start.elapsed() > DEADLINE {
            child.kill().expect("a child process");
            panic!("process {} did not end within {DEADLINE:?}", child.id());
        }
        std::thread::sleep(POLL_INTERVAL);
    }
}

fn drain(mut from: impl Read + Send + 'static) -> std::thread::JoinHandle<Vec<u8>> {
    std::thread::spawn(move || {
        let mut bytes = Vec::new();
        from.read_to_end(&mut bytes).expect("readable");
        bytes
    })
}

/// Converts bytes to text, for messages.
pub(crate) fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Sends a signal to a process; no error if it has already exited.
pub(crate) fn send_signal(process: u32, signal: Signal) {
    let process = Pid::from_raw(process.cast_signed()).expect("no process has id 0");
    // The process may have exited since its id was read.
    let _ = kill_process(process, signal);
}

/// Whether a process exists and is not a zombie.
pub(crate) fn is_alive(process: u32) -> bool {
    status_field(process, 0).is_some_and(|state| state != "Z" && state != "X")
}

/// Child processes of this process, without those that read jobs.
pub(crate) fn children(parent: u32) -> Vec<u32> {
    all_children(parent).into_iter().filter(|process| !is_reader(*process)).collect()
}

/// Processes that read jobs for a server.
pub(crate) fn readers(server: u32) -> Vec<u32> {
    all_children(server).into_iter().filter(|process| is_reader(*process)).collect()
}

fn is_reader(process: u32) -> bool {
    let command = fs::read(format!("/proc/{process}/cmdline")).unwrap_or_default();
    command.split(|byte| *byte == 0).any(|word| word == server::READER_COMMAND.as_bytes())
}

fn all_children(parent: u32) -> Vec<u32> {
    let processes = fs::read_dir("/proc").expect("Linux has /proc").flatten();
    let ids = processes.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    ids.filter(|&process| is_alive(process) && status_field(process, 1) == Some(parent.to_string())).collect()
}

/// A field of `/proc/ID/stat` after the name: 0 the state, 1 the parent.
fn status_field(process: u32, field: usize) -> Option<String> {
    let stat = fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    let (_, after_name) = stat.rsplit_once(')')?;
    after_name.split_whitespace().nth(field).map(str::to_owned)
}

/// Server process on a free port.
pub(crate) struct Farm {
    child: Child,
    /// `http://127.0.0.1:PORT`, or `https://…` if it has a certificate.
    pub(crate) address: String,
    log: PathBuf,
    folder: Option<TempDir>,
}

impl Farm {
    /// Starts a server in a new folder.
    pub(crate) fn start(arguments: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let mut farm = Self::start_on(folder.path(), arguments);
        farm.folder = Some(folder);
        farm
    }

    /// Starts a server on `FOLDER/data`, logging to `FOLDER/log`, and waits until it reports that it serves.
    pub(crate) fn start_on(folder: &Path, arguments: &[&str]) -> Self {
        Self::start_by(sdfarm(&["serve"]), folder, arguments)
    }

    /// Starts a server by a command with its own environment.
    pub(crate) fn start_by(command: Command, folder: &Path, arguments: &[&str]) -> Self {
        Self::start_at("127.0.0.1:0", command, folder, arguments)
    }

    /// Starts a server in a new folder that listens on every address.
    pub(crate) fn start_beyond_loopback(arguments: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let arguments = [&["--insecure"][..], arguments].concat();
        let mut farm = Self::start_at("0.0.0.0:0", sdfarm(&["serve"]), folder.path(), &arguments);
        farm.folder = Some(folder);
        farm
    }

    /// Starts a server on this address.
    pub(crate) fn start_at(listen: &str, mut command: Command, folder: &Path, arguments: &[&str]) -> Self {
        let log = folder.join("log");
        // On PostgreSQL, unless the caller has chosen a database.
        if command.get_envs().all(|(name, _)| name != "SDFARM_DATABASE")
            && let Some(database) = postgres_server::database_of(&folder.join("data"))
        {
            command.env("SDFARM_DATABASE", database);
        }
        command.args(["--listen", listen, "--data"]).arg(folder.join("data")).args(arguments);
        let log_file = fs::File::options().create(true).append(true).open(&log).expect("a log");
        let mut child =
            command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(log_file).spawn().expect("the program starts");
        let mut out = BufReader::new(child.stdout.take().expect("piped"));
        let (sender, receiver) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            let mut line = String::new();
            // The end of the output is an empty line, which names no address.
            let _ = out.read_line(&mut line);
            let _ = sender.send(line);
            let _ = std::io::copy(&mut out, &mut std::io::sink());
        });
        let line = receiver.recv_timeout(DEADLINE).expect("the server prints a line");
        let address = line.split_whitespace().find(|word| word.contains("://"));
        let Some(address) = address.map(str::to_owned) else {
            // Reaped before the panic, so that no process outlives the test.
            let _ = child.kill();
            let _ = child.wait();
            panic!("the server printed no address: {line:?}; {}", read_log(&log));
        };
        Self { child, address, log, folder: None }
    }

    /// Number of tile blobs in its data folder.
    pub(crate) fn blobs(&self) -> usize {
        let folder = self.folder.as_ref().expect("a farm in a folder of its own").path().join("data/tiles");
        let names =
            fs::read_dir(folder).expect("the folder of tiles").map(|entry| entry.expect("an entry").file_name());
        names.filter(|name| !name.to_string_lossy().contains('#')).count()
    }

    /// Process id of the server.
    pub(crate) fn process(&self) -> u32 {
        self.child.id()
    }

    /// Whether the server has exited.
    pub(crate) fn has_ended(&mut self) -> bool {
        self.child.try_wait().expect("a child process").is_some()
    }

    /// Process ids of the pool's workers.
    pub(crate) fn workers(&self) -> Vec<u32> {
        children(self.process())
    }

    /// Text of the log so far.
    pub(crate) fn log(&self) -> String {
        read_log(&self.log)
    }

    /// Sends SIGTERM, and waits until the server has exited.
    pub(crate) fn terminate(mut self) -> ExitStatus {
        send_signal(self.process(), Signal::TERM);
        wait(&mut self.child)
    }

    /// Sends a GET request.
    pub(crate) fn get(&self, path: &str) -> Answer {
        self.send("GET", path, &[], Vec::new())
    }

    /// Posts a job.
    pub(crate) fn post(&self, job: &str) -> Answer {
        self.send("POST", "/v1/jobs", &[("content-type", "application/json")], job.as_bytes().to_vec())
    }

    /// Posts a job that must be accepted; returns its id.
    pub(crate) fn accept(&self, job: &str) -> String {
        let answer = self.post(job);
        assert_eq!(answer.status, 201, "{}", answer.text());
        answer.json()["id"].as_str().expect("a job has an id").to_owned()
    }

    /// Waits until a job has succeeded; any other final state fails the test. Returns its view.
    pub(crate) fn succeeded(&self, id: &str) -> Value {
        let start = Instant::now();
        let job = loop {
            let job = self.get(&format!("/v1/jobs/{id}")).json();
            if !["queued", "running"].contains(&job["state"].as_str().expect("a state")) {
                break job;
            }
            let workers = || self.get("/v1/workers").text();
            assert!(start.elapsed() < DEADLINE, "does not finish: {job}\n{}\n{}", workers(), self.log());
            std::thread::sleep(POLL_INTERVAL);
        };
        assert_eq!(job["state"], "succeeded", "{job}\n{}", self.log());
        job
    }

    /// The stored picture of frame 0.
    pub(crate) fn picture(&self, id: &str) -> Vec<u8> {
        let answer = self.get(&format!("/v1/jobs/{id}/frames/0/image"));
        assert_eq!(answer.status, 200, "{}", answer.text());
        answer.body
    }

    /// Sets the pool's size and waits until this number of workers is ready.
    pub(crate) fn set_pool(&self, workers: u32) {
        let body = format!("{{\"workers\": {workers}}}").into_bytes();
        let answer = self.send("PUT", "/v1/pool", &[("content-type", "application/json")], body);
        assert_eq!(answer.status, 200, "{}", answer.text());
        self.ready(workers);
    }

    /// Waits until this number of pool workers is ready.
    pub(crate) fn ready(&self, workers: u32) {
        eventually(&format!("{workers} workers are ready"), || {
            let pool = self.get("/v1/pool").json();
            (pool["ready"] == workers && pool["workers"] == workers).then_some(())
        });
    }

    /// Waits until this number of workers, local or remote, is ready.
    pub(crate) fn joined(&self, workers: usize) {
        eventually(&format!("{workers} workers have joined"), || {
            let list = self.get("/v1/workers").json();
            let list = list["workers"].as_array().expect("workers");
            (list.iter().filter(|worker| worker["state"] == "ready").count() == workers).then_some(())
        });
    }

    /// Sends any request to a server that may exit during it; then there is no response.
    pub(crate) fn try_send(&self, method: &str, path: &str, headers: &[(&str, &str)], body: Vec<u8>) -> Option<Answer> {
        try_send(&self.address, method, path, headers, body).ok()
    }

    /// Sends any request.
    pub(crate) fn send(&self, method: &str, path: &str, headers: &[(&str, &str)], body: Vec<u8>) -> Answer {
        send(&self.address, method, path, headers, body)
    }
}

impl Drop for Farm {
    fn drop(&mut self) {
        let workers = self.workers();
        // Both fail only if the process has already exited.
        let _ = self.child.kill();
        let _ = self.child.wait();
        for worker in workers {
            send_signal(worker, Signal::KILL);
        }
    }
}

fn read_log(log: &Path) -> String {
    fs::read_to_string(log).unwrap_or_default()
}

/// HTTP response.
pub(crate) struct Answer {
    /// Status of the response.
    pub(crate) status: u16,
    /// Headers of the response.
    pub(crate) headers: reqwest::header::HeaderMap,
    /// Body of the response.
    pub(crate) body: Vec<u8>,
}

impl Answer {
    /// Parses the body as JSON.
    pub(crate) fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|error| panic!("{error}: {}", self.text()))
    }

    /// Returns the body as text.
    pub(crate) fn text(&self) -> String {
        text(&self.body)
    }

    /// Value of a header, or "".
    pub(crate) fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", |value| value.to_str().expect("plain text"))
    }

    /// Parses the body as a problem, and asserts its status and code.
    pub(crate) fn problem(&self, status: u16, code: &str) -> Value {
        assert_eq!(self.status, status, "{}", self.text());
        assert_eq!(self.header("content-type"), "application/problem+json", "{}", self.text());
        let problem = self.json();
        assert_eq!(problem["status"], status, "{problem}");
        assert_eq!(problem["code"], code, "{problem}");
        assert!(!problem["detail"].as_str().expect("words").is_empty(), "{problem}");
        problem
    }
}

/// Sends a request to any address.
pub(crate) fn send(address: &str, method: &str, path: &str, headers: &[(&str, &str)], body: Vec<u8>) -> Answer {
    try_send(address, method, path, headers, body).unwrap_or_else(|error| panic!("{path}: {error:?}"))
}

/// Sends a request over connections that no other request of these tests uses.
pub(crate) fn try_send_apart(
    address: &str,
    method: &str,
    path: &str,
    headers: &[(&str, &str)],
    body: Vec<u8>,
) -> Option<Answer> {
    static CLIENT: OnceLock<Client> = OnceLock::new();
    try_send_by(&CLIENT, address, method, path, headers, body).ok()
}

pub(crate) fn try_send(
    address: &str,
    method: &str,
    path: &str,
    headers: &[(&str, &str)],
    body: Vec<u8>,
) -> reqwest::Result<Answer> {
    static CLIENT: OnceLock<Client> = OnceLock::new();
    try_send_by(&CLIENT, address, method, path, headers, body)
}

/// Client with its own connections.
type Client = (tokio::runtime::Runtime, reqwest::Client);

fn try_send_by(
    client: &'static OnceLock<Client>,
    address: &str,
    method: &str,
    path: &str,
    headers: &[(&str, &str)],
    body: Vec<u8>,
) -> reqwest::Result<Answer> {
    let (runtime, client) = client.get_or_init(|| {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
        (runtime.expect("threads"), proto::client_auth::client_builder().build().expect("a client"))
    });
    let method = method.parse().expect("a method");
    let mut request = client.request(method, format!("{address}{path}")).timeout(DEADLINE).body(body);
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    runtime.block_on(async {
        let answer = request.send().await?;
        let (status, headers) = (answer.status().as_u16(), answer.headers().clone());
        let body = answer.bytes().await?.to_vec();
        Ok(Answer { status, headers, body })
    })
}

/// Renders a frame's picture with `sdfarm render`.
pub(crate) fn rendered_here(job: &Value, frame: u32) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("picture").with_extension(job["image"]["format"].as_str().unwrap_or("png"));
    let arguments = ["render", "-", "-o", path.to_str().expect("plain"), "--frame", &frame.to_string()];
    let output = finish(sdfarm(&arguments), job.to_string().as_bytes());
    assert!(output.status.success(), "{}", text(&output.stderr));
    fs::read(path).expect("a picture")
}
