//! Attacks by callers with a key that may submit, with a key of a worker, or with none. While each runs, a second
//! user submits tiny jobs and an operator asks for the server's health: both must be served.
//!
//! Every test run makes a few attacks for a moment each, and checks states only. The long test makes all of them, and
//! also checks the memory that docs/security.md promises, and with `SDFARM_CHECK_TIMES=1`, for which it needs an idle
//! machine to itself, the times.

mod bombs;
mod floods;
mod protocol;

use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use rustix::process::nice;
use serde_json::{Value, json};

use crate::jobs;
use crate::support::{Answer, Farm, new_key, try_send_apart, wait_for_state};

/// Length of a lease on an attacked farm.
const LEASE: Duration = Duration::from_secs(3);
/// A tiny job of another user starts within this time.
const MAX_START: Duration = LEASE.saturating_mul(2);
/// Limit of the 99th percentile of `/livez`.
const MAX_HEALTH: Duration = Duration::from_millis(100);
/// Limit of the server's resident memory, in KiB.
const MAX_MEMORY_KIB: u64 = 512 << 10;
/// Duration of an attack in every test run.
const SHORT_ATTACK: Duration = Duration::from_millis(700);
/// Duration of an attack in the long test; `SDFARM_ATTACK_SECONDS` sets another, and
/// `SDFARM_ATTACK` chooses those with some words in their name.
const WHILE: Duration = Duration::from_secs(8);
/// Pause between two jobs of the second user, and between two health checks.
const PAUSE: Duration = Duration::from_millis(50);

/// One attack.
struct Attack {
    /// Name, for the table.
    name: &'static str,
    /// Does it until the time is over.
    run: fn(&Attacker<'_>),
}

/// An attacker: its knowledge and its keys.
struct Attacker<'a> {
    farm: &'a Farm,
    /// `Authorization` of a key that may submit and read.
    submitter: String,
    /// `Authorization` of a worker's key.
    worker: String,
    time: Duration,
    /// Start of the attack, after its preparations.
    begun: OnceLock<Instant>,
    sent: AtomicU64,
}

impl Attacker<'_> {
    fn goes_on(&self) -> bool {
        self.begun.get_or_init(Instant::now).elapsed() < self.time
    }

    /// Sends a request as a submitter; there is no response if the server closed the connection.
    fn send(&self, method: &str, path: &str, body: impl Into<Vec<u8>>) -> Option<Answer> {
        self.send_as(&self.submitter, method, path, body)
    }

    fn send_as(&self, key: &str, method: &str, path: &str, body: impl Into<Vec<u8>>) -> Option<Answer> {
        self.sent.fetch_add(1, Ordering::Relaxed);
        let headers = [("authorization", key), ("content-type", "application/json")];
        // A server that refuses a body closes its connection, which only the attacker may lose.
        try_send_apart(&self.farm.address, method, path, &headers, body.into())
    }

    /// Submits a job; returns its id if it was accepted.
    fn submit(&self, job: &Value) -> Option<String> {
        let answer = self.send("POST", "/v1/jobs", job.to_string()).filter(|answer| answer.status == 201)?;
        Some(answer.json()["id"].as_str()?.to_owned())
    }

    /// Repeats something on this number of threads until the time is over; its argument counts from 0.
    fn flood(&self, threads: u64, act: impl Fn(u64) + Sync) {
        let count = AtomicU64::new(0);
        std::thread::scope(|scope| {
            for _ in 0..threads {
                scope.spawn(|| {
                    // Attackers have machines of their own: this thread must not take the farm's.
                    nice(19).expect("any thread may lower its priority");
                    while self.goes_on() {
                        act(count.fetch_add(1, Ordering::Relaxed));
                    }
                });
            }
        });
    }

    /// Opens a connection and sends some bytes; `None` if the server refuses it.
    fn connect(&self, bytes: &[u8]) -> Option<TcpStream> {
        self.sent.fetch_add(1, Ordering::Relaxed);
        let address = self.farm.address.strip_prefix("http://").expect("an address");
        let mut connection = TcpStream::connect(address).ok()?;
        connection.write_all(bytes).ok()?;
        Some(connection)
    }

    /// Head of a request by the submitter, without its last empty line.
    fn head(&self, method: &str, path: &str) -> String {
        format!("{method} {path} HTTP/1.1\r\nhost: 127.0.0.1\r\nauthorization: {}\r\n", self.submitter)
    }

    /// Keeps as many connections open as the server takes, and reads from each only slowly.
    fn hold(&self, count: usize, bytes: &[u8]) {
        let mut held = Vec::new();
        while self.goes_on() {
            if held.len() < count {
                held.extend(self.connect(bytes));
            }
            for connection in held.iter_mut().rev().take(8) {
                let timeout = connection.set_read_timeout(Some(Duration::from_millis(1)));
                // A closed connection stays in the list: a new one would only take its place.
                let _ = timeout.and_then(|()| connection.read(&mut [0; 64]));
            }
        }
    }
}

/// Times of the second user and the operator during one attack.
#[derive(Debug, Default)]
struct Witness {
    starts: Vec<Duration>,
    health: Vec<Duration>,
}

/// A farm with keys, two workers, and the secrets of its users.
struct Siege {
    farm: Farm,
    folder: tempfile::TempDir,
    anna: String,
    mallory: String,
    worker: String,
}

impl Siege {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let key = |name, scope| new_key(folder.path(), name, scope);
        // The first key of a farm is an admin's.
        key("ops", "admin");
        let (anna, mallory, worker) =
            (key("anna", "submit,read"), key("mallory", "submit,read"), key("node", "worker"));
        let lease = LEASE.as_secs().to_string();
        let flags =
            ["--workers", "2", "--threads", "2", "--lease-seconds", &lease, "--allow-webhook-to", "127.0.0.0/8"];
        let farm = Farm::start_on(folder.path(), &flags);
        Self { farm, folder, anna, mallory, worker }
    }

    /// Makes an attack for a while.
    fn make(&self, attack: &Attack, time: Duration, seeds: &AtomicU64) -> Witness {
        let attacker = Attacker {
            farm: &self.farm,
            submitter: self.mallory.clone(),
            worker: self.worker.clone(),
            time,
            begun: OnceLock::new(),
            sent: AtomicU64::new(0),
        };
        let over = AtomicBool::new(false);
        let mut witness = Witness::default();
        std::thread::scope(|scope| {
            let user = scope.spawn(|| {
                let mut starts = Vec::new();
                // The last job is submitted when the attack is over, so that there always is one.
                loop {
                    let last = over.load(Ordering::SeqCst);
                    starts.push(self.start_of_a_job(seeds.fetch_add(1, Ordering::SeqCst)));
                    if last {
                        return starts;
                    }
                    std::thread::sleep(PAUSE);
                }
            });
            let operator = scope.spawn(|| {
                let mut times = Vec::new();
                while !over.load(Ordering::SeqCst) {
                    let begun = Instant::now();
                    assert_eq!(self.farm.get("/livez").status, 200, "{}: /livez", attack.name);
                    times.push(begun.elapsed());
                    std::thread::sleep(PAUSE);
                }
                times
            });
            (attack.run)(&attacker);
            over.store(true, Ordering::SeqCst);
            witness.starts = user.join().unwrap_or_else(|_| panic!("{}: the second user was not served", attack.name));
            witness.health = operator.join().unwrap_or_else(|_| panic!("{}: /livez failed", attack.name));
        });
        assert!(attacker.sent.load(Ordering::SeqCst) > 0, "{} did nothing", attack.name);
        assert!(!self.farm.log().contains("panicked"), "{}: {}", attack.name, self.farm.log());
        witness
    }

    /// Submits a tiny job of the second user, and returns the time until it started; it must succeed.
    fn start_of_a_job(&self, seed: u64) -> Duration {
        let headers = [("authorization", self.anna.as_str()), ("content-type", "application/json")];
        let job = jobs::seeded(&jobs::as_png(&jobs::sized(&jobs::named("csg"), 32, 1)), seed).to_string();
        let begun = Instant::now();
        let answer = self.farm.send("POST", "/v1/jobs", &headers, job.into_bytes());
        assert_eq!(answer.status, 201, "{}", answer.text());
        let path = format!("/v1/jobs/{}", answer.json()["id"].as_str().expect("an id"));
        let view = |what: &str, is_reached: fn(&str) -> bool| {
            wait_for_state(&self.farm, &path, &headers[..1], what, is_reached);
            begun.elapsed()
        };
        let started = view("started", |state| state != "queued");
        view("ended", |state| state == "succeeded");
        started
    }

    /// Greatest resident memory of the server since its start, in KiB.
    fn memory_kib(&self) -> u64 {
        let status = fs::read_to_string(format!("/proc/{}/status", self.farm.process())).expect("it runs");
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).expect("Linux states it");
        line.trim().trim_end_matches(" kB").parse().expect("a number")
    }
}

/// Whether times are checked, because the machine is idle.
fn checks_times() -> bool {
    std::env::var_os("SDFARM_CHECK_TIMES").is_some()
}

/// All attacks.
fn attacks() -> Vec<Attack> {
    [floods::attacks(), protocol::attacks(), bombs::attacks()].into_iter().flatten().collect()
}

fn percentile_99(times: &mut [Duration]) -> Duration {
    times.sort();
    times[(times.len() * 99).div_ceil(100).max(1) - 1]
}

#[test]
fn some_attacks_do_not_stop_another_user() {
    let (siege, seeds) = (Siege::new(), AtomicU64::new(0));
    for attack in attacks().iter().step_by(7) {
        siege.make(attack, SHORT_ATTACK, &seeds);
    }
    assert!(siege.folder.path().exists());
}

#[test]
#[ignore = "long: all attacks, with times and memory; 8 min"]
fn no_attack_stops_another_user() {
    let time = std::env::var("SDFARM_ATTACK_SECONDS").ok().and_then(|seconds| seconds.parse().ok());
    let time = time.map_or(WHILE, Duration::from_secs);
    let seeds = AtomicU64::new(0);
    let mut wrong = Vec::new();
    eprintln!("| Attack | start of another user's job | `/livez`, p99 | memory |\n|---|---|---|---|");
    let chosen = std::env::var("SDFARM_ATTACK").unwrap_or_default();
    for attack in attacks().into_iter().filter(|attack| attack.name.contains(&chosen)) {
        // A new farm for each, so that its memory is that of this attack.
        let siege = Siege::new();
        let mut witness = siege.make(&attack, time, &seeds);
        let (start, health) = (percentile_99(&mut witness.starts), percentile_99(&mut witness.health));
        let memory_kib = siege.memory_kib();
        let row = format!(
            "| {} | {} ms | {} ms | {} MiB |",
            attack.name,
            start.as_millis(),
            health.as_millis(),
            memory_kib >> 10
        );
        let is_slow = checks_times() && (start > MAX_START || health > MAX_HEALTH);
        if is_slow || memory_kib > MAX_MEMORY_KIB {
            wrong.push(row.clone());
        }
        eprintln!("{row}");
    }
    assert!(wrong.is_empty(), "over a limit:\n{}", wrong.join("\n"));
}

/// A job of one gray ball around which an attack is written.
fn ball() -> Value {
    json!({
        "scene": {
            "camera": { "position": [0, 0.5, 4], "look_at": [0, 0, 0] },
            "objects": [{ "shape": { "sphere": { "radius": 1 } }, "material": { "diffuse": {} } }],
        },
        "image": { "width": 16, "height": 16, "samples": 1 },
    })
}
