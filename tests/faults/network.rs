//! Tests all faults of a network between a remote worker and its server, and workers that are suspended: messages that
//! arrive twice, late, or not at all change no picture.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, AtomicUsize, Ordering};
use std::time::Duration;

use rustix::process::Signal;
use serde_json::Value;

use crate::jobs;
use crate::skip::skip;
use crate::support::{Farm, eventually, rendered_here, sdfarm, send_signal, wait};

/// Uses the shortest possible leases.
const FLAGS: [&str; 6] = ["--workers", "0", "--tile", "96", "--lease-seconds", "1"];

/// Behavior of a proxy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mood {
    /// Forwards everything.
    Honest,
    /// Accepts connections and forwards nothing.
    Silent,
    /// Forwards requests and cuts off responses: the worker cannot know that its request arrived.
    Deaf,
    /// Cuts off requests midway.
    Cut,
    /// Forwards everything late.
    Slow,
}

const MOODS: [Mood; 5] = [Mood::Honest, Mood::Silent, Mood::Deaf, Mood::Cut, Mood::Slow];

/// Proxy between a worker and its server.
struct Proxy {
    address: String,
    mood: Arc<AtomicU8>,
    /// Number of disturbed connections.
    spoilt: Arc<AtomicUsize>,
}

impl Proxy {
    fn start(server: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let address = format!("http://{}", listener.local_addr().expect("bound"));
        let (mood, spoilt) = (Arc::new(AtomicU8::new(0)), Arc::new(AtomicUsize::new(0)));
        let server = server.strip_prefix("http://").expect("an address").to_owned();
        let (moods, count) = (Arc::clone(&mood), Arc::clone(&spoilt));
        std::thread::spawn(move || {
            for client in listener.incoming().flatten() {
                let (server, moods, count) = (server.clone(), Arc::clone(&moods), Arc::clone(&count));
                std::thread::spawn(move || carry(&client, &server, &moods, &count));
            }
        });
        Self { address, mood, spoilt }
    }

    fn set(&self, mood: Mood) {
        let place = MOODS.iter().position(|&other| other == mood).expect("all are there");
        self.mood.store(place as u8, Ordering::SeqCst);
    }
}

fn mood(moods: &AtomicU8) -> Mood {
    MOODS[usize::from(moods.load(Ordering::SeqCst))]
}

/// Forwards a connection both ways, with the current behavior.
fn carry(client: &TcpStream, server: &str, moods: &Arc<AtomicU8>, spoilt: &Arc<AtomicUsize>) {
    let Ok(upstream) = TcpStream::connect(server) else { return };
    let back = {
        let (from, to) = (upstream.try_clone().expect("a socket"), client.try_clone().expect("a socket"));
        let (moods, spoilt) = (Arc::clone(moods), Arc::clone(spoilt));
        std::thread::spawn(move || pipe(&from, &to, &moods, &spoilt, true))
    };
    pipe(client, &upstream, moods, spoilt, false);
    // The thread has ended with or without an error.
    let _ = back.join();
}

fn pipe(mut from: &TcpStream, mut to: &TcpStream, moods: &AtomicU8, spoilt: &AtomicUsize, answers: bool) {
    let mut bytes = [0; 4096];
    while let Ok(read) = from.read(&mut bytes) {
        let mood = mood(moods);
        let passes = match (mood, answers) {
            (Mood::Honest, _) | (Mood::Deaf, false) | (Mood::Cut, true) => read,
            (Mood::Slow, _) => {
                std::thread::sleep(Duration::from_millis(50));
                read
            }
            (Mood::Silent, _) => {
                spoilt.fetch_add(1, Ordering::SeqCst);
                continue_silently(from, moods);
                break;
            }
            (Mood::Cut, false) => read / 2,
            (Mood::Deaf, true) => 0,
        };
        if read == 0 || to.write_all(&bytes[..passes]).is_err() || passes < read {
            spoilt.fetch_add(usize::from(passes < read), Ordering::SeqCst);
            break;
        }
    }
    // Both ends are closed, so that the other direction ends as well; they may be closed already.
    let _ = from.shutdown(Shutdown::Both);
    let _ = to.shutdown(Shutdown::Both);
}

/// Keeps a connection half open: nothing is forwarded until the behavior changes or a side closes it.
fn continue_silently(mut from: &TcpStream, moods: &AtomicU8) {
    let mut bytes = [0; 4096];
    from.set_read_timeout(Some(Duration::from_millis(20))).expect("settable");
    while mood(moods) == Mood::Silent {
        match from.read(&mut bytes) {
            Ok(0) => return,
            Ok(_) => {}
            Err(error) if [std::io::ErrorKind::WouldBlock, std::io::ErrorKind::TimedOut].contains(&error.kind()) => {}
            Err(_) => return,
        }
    }
}

/// Remote worker that is killed on drop.
struct Worker(Child);

impl Worker {
    fn start(server: &str) -> Self {
        Self::start_by(sdfarm(&["worker"]), server)
    }

    fn start_by(mut command: Command, server: &str) -> Self {
        command.args(["--server", server, "--device", "cpu", "--threads", "1"]);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        Self(command.spawn().expect("the program starts"))
    }

    fn signal(&self, signal: Signal) {
        send_signal(self.0.id(), signal);
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.signal(Signal::KILL);
        wait(&mut self.0);
    }
}

/// Job whose frames are stitched, and which still runs when the network fails.
fn job(seed: u64) -> Value {
    jobs::seeded(&jobs::as_png(&jobs::sized(&jobs::named("csg"), 288, 100)), seed)
}

/// Number of expired leases.
fn expired(farm: &Farm) -> u64 {
    let metrics = farm.get("/metrics").text();
    let count = metrics.lines().find_map(|line| line.strip_prefix("sdfarm_leases_expired_total "));
    count.expect("a metric").parse().expect("a count")
}

fn is_running(farm: &Farm, id: &str) -> bool {
    ["queued", "running"].contains(&farm.get(&format!("/v1/jobs/{id}")).json()["state"].as_str().expect("a state"))
}

fn check(farm: &Farm, id: &str, job: &Value) {
    farm.succeeded(id);
    assert!(farm.picture(id) == rendered_here(job, 0), "other bytes than an undisturbed run's");
    assert!(!farm.log().contains("panicked") && !farm.log().contains("nondeterministic"), "{}", farm.log());
}

#[test]
fn failing_network_changes_no_picture() {
    let farm = Farm::start(&FLAGS);
    let proxies = [Proxy::start(&farm.address), Proxy::start(&farm.address)];
    let _workers = proxies.each_ref().map(|proxy| Worker::start(&proxy.address));
    farm.joined(2);
    for (seed, mood) in MOODS[1..].iter().copied().enumerate() {
        let job = job(seed as u64);
        let id = farm.accept(&job.to_string());
        eventually("it runs", || (farm.get(&format!("/v1/jobs/{id}")).json()["state"] != "queued").then_some(()));
        let expired_before = expired(&farm);
        let before: usize = proxies.iter().map(|proxy| proxy.spoilt.load(Ordering::SeqCst)).sum();
        for proxy in &proxies {
            proxy.set(mood);
        }
        if mood != Mood::Slow {
            eventually("something is spoilt", || {
                let spoilt: usize = proxies.iter().map(|proxy| proxy.spoilt.load(Ordering::SeqCst)).sum();
                (spoilt > before).then_some(())
            });
        }
        // Leases expire while the network is down; if it is slow, or all requests arrived, the job may finish.
        eventually("a lease runs out, or the job ends", || {
            (expired(&farm) > expired_before || !is_running(&farm, &id)).then_some(())
        });
        for proxy in &proxies {
            proxy.set(Mood::Honest);
        }
        check(&farm, &id, &job);
    }
}

#[test]
fn worker_suspended_for_two_leases_has_no_effect() {
    let farm = Farm::start(&FLAGS);
    let sleeper = Worker::start(&farm.address);
    farm.joined(1);
    let job = job(100);
    let id = farm.accept(&job.to_string());
    eventually("it runs", || {
        let workers = farm.get("/v1/workers").json();
        (workers["workers"][0]["leases"].as_u64() > Some(0)).then_some(())
    });
    let before = expired(&farm);
    sleeper.signal(Signal::STOP);
    eventually("its leases run out", || (expired(&farm) > before).then_some(()));
    let heir = Worker::start(&farm.address);
    check(&farm, &id, &job);
    let done = farm.get(&format!("/v1/jobs/{id}")).json();
    sleeper.signal(Signal::CONT);
    // The farm no longer knows the worker, so its report has no effect, and it registers again.
    farm.joined(2);
    assert_eq!(farm.get(&format!("/v1/jobs/{id}")).json(), done, "nothing changed");
    drop(heir);
    let next = self::job(101);
    let id = farm.accept(&next.to_string());
    check(&farm, &id, &next);
}

/// Network namespace with a lossy link to it, which is deleted on drop.
struct Namespace(&'static str);

impl Namespace {
    fn new(name: &'static str) -> Option<Self> {
        let made = ip(&["netns", "add", name]).then_some(Self(name))?;
        let is_linked = ip(&["link", "add", "sdfarm-out", "type", "veth", "peer", "name", "sdfarm-in", "netns", name])
            && ip(&["addr", "add", "10.213.7.1/24", "dev", "sdfarm-out"])
            && ip(&["link", "set", "sdfarm-out", "up"])
            && ip(&["-n", name, "addr", "add", "10.213.7.2/24", "dev", "sdfarm-in"])
            && ip(&["-n", name, "link", "set", "sdfarm-in", "up"]);
        is_linked.then_some(made)
    }

    /// Drops this percentage of packets, in both directions.
    fn lose(&self, percent: u32) -> bool {
        let loss = format!("{percent}%");
        run("tc", &["-n", self.0, "qdisc", "replace", "dev", "sdfarm-in", "root", "netem", "loss", &loss])
            && run("tc", &["qdisc", "replace", "dev", "sdfarm-out", "root", "netem", "loss", &loss])
    }

    /// Takes the link down or up; neither end is notified.
    fn part(&self, is_parted: bool) {
        let state = if is_parted { "down" } else { "up" };
        assert!(ip(&["-n", self.0, "link", "set", "sdfarm-in", state]), "the link cannot be set {state}");
    }
}

impl Drop for Namespace {
    fn drop(&mut self) {
        // Deleting the namespace deletes both ends; it may be incomplete.
        let _ = ip(&["link", "del", "sdfarm-out"]);
        let _ = ip(&["netns", "del", self.0]);
    }
}

fn ip(arguments: &[&str]) -> bool {
    run("ip", arguments)
}

fn run(program: &str, arguments: &[&str]) -> bool {
    Command::new(program).args(arguments).output().is_ok_and(|output| output.status.success())
}

#[test]
fn lossy_and_partitioned_networks_change_no_picture() {
    let Some(namespace) = Namespace::new("sdfarm-proof") else {
        return skip("netns", "a network namespace needs `ip netns`, which is not available here");
    };
    let farm = Farm::start_beyond_loopback(&FLAGS);
    let port = farm.address.rsplit(':').next().expect("a port");
    let mut command = Command::new("ip");
    command.args(["netns", "exec", "sdfarm-proof", crate::support::PROGRAM, "worker"]);
    let _worker = Worker::start_by(command, &format!("http://10.213.7.1:{port}"));
    farm.joined(1);
    for seed in 200..202 {
        let job = job(seed);
        let id = farm.accept(&job.to_string());
        eventually("it runs", || (farm.get(&format!("/v1/jobs/{id}")).json()["state"] != "queued").then_some(()));
        let before = expired(&farm);
        namespace.part(true);
        eventually("a lease runs out", || (expired(&farm) > before).then_some(()));
        namespace.part(false);
        check(&farm, &id, &job);
    }
    for (seed, percent) in [(210, 10), (211, 25)] {
        if !namespace.lose(percent) {
            return skip("netem", "dropping packets needs `tc` with netem, which is not available here");
        }
        let job = job(seed);
        let id = farm.accept(&job.to_string());
        check(&farm, &id, &job);
    }
}
