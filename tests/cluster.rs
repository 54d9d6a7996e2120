//! Several servers on one PostgreSQL database and one S3 store. The tests need the server of `tests/on_postgres`.

use std::net::TcpListener;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rustix::process::Signal;
use serde_json::Value;
use tempfile::TempDir;

use crate::seaweedfs::SeaweedFs;
use crate::slow_network::SlowNetwork;
use crate::support::{Answer, Farm, eventually, finish, rendered_here, sdfarm, send_signal, text, try_send};
use crate::{jobs, postgres_server};

const SECRET: &str = "a secret of the servers of one farm";

/// Servers of one farm, each on its own port.
struct Cluster {
    s3: SeaweedFs,
    folder: TempDir,
    database: String,
    addresses: Vec<String>,
}

impl Cluster {
    /// Prepares places for servers, or skips the test.
    fn new(servers: usize) -> Option<Self> {
        postgres_server::required()?;
        let s3 = SeaweedFs::start()?;
        s3.make_bucket("renders");
        let folder = tempfile::tempdir().expect("a folder");
        let database = postgres_server::database_of(folder.path()).expect("a database");
        let held: Vec<_> = (0..servers).map(|_| TcpListener::bind("127.0.0.1:0").expect("a port")).collect();
        let addresses = held.iter().map(|port| port.local_addr().expect("an address").to_string()).collect();
        Some(Self { s3, folder, database, addresses })
    }

    fn command(&self, arguments: &[&str], secret: &str) -> Command {
        let mut command = sdfarm(arguments);
        command.envs(self.s3.environment());
        command.env("SDFARM_DATABASE", &self.database).env("SDFARM_CLUSTER_SECRET", secret);
        command
    }

    /// Starts the server of a place.
    fn start(&self, place: usize, workers: &str) -> Farm {
        self.start_with(place, workers, "")
    }

    /// Starts the server of a place with fail points.
    fn start_with(&self, place: usize, workers: &str, fail_points: &str) -> Farm {
        let folder = self.folder.path().join(place.to_string());
        std::fs::create_dir_all(&folder).expect("a folder");
        let flags = ["--device", "cpu", "--workers", workers, "--tile", "32", "--store", "s3://renders/farm"];
        let mut command = self.command(&["serve"], SECRET);
        if !fail_points.is_empty() {
            command.arg(proto::fail_point::FLAG).env(proto::fail_point::ENV_VAR, fail_points);
        }
        Farm::start_at(&self.addresses[place], command, &folder, &flags)
    }

    /// Starts a worker that calls any of the servers.
    fn worker(&self) -> Worker {
        let servers: Vec<String> = self.addresses.iter().map(|address| format!("http://{address}")).collect();
        let mut command = sdfarm(&["worker", "--device", "cpu", "--threads", "1", "--server", &servers.join(",")]);
        Worker(command.stdin(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts"))
    }
}

/// A worker that is killed on drop.
struct Worker(Child);

impl Drop for Worker {
    fn drop(&mut self) {
        // Both fail only if it has exited already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn small(seed: u64) -> Value {
    jobs::seeded(&jobs::as_png(&jobs::sized(&jobs::named("csg"), 64, 2)), seed)
}

fn state(server: &Farm, id: &str) -> String {
    server.get(&format!("/v1/jobs/{id}")).json()["state"].as_str().expect("a state").to_owned()
}

#[test]
fn what_one_server_accepts_another_renders_and_a_third_serves() {
    let Some(cluster) = Cluster::new(3) else { return };
    let (first, second, third) = (cluster.start(0, "0"), cluster.start(1, "1"), cluster.start(2, "0"));
    second.ready(1);
    let id = first.accept(&small(1).to_string());
    third.succeeded(&id);
    let wanted = rendered_here(&small(1), 0);
    for server in [&first, &second, &third] {
        assert!(server.picture(&id) == wanted, "every server has the picture");
    }
    let events = |server: &Farm| server.get(&format!("/v1/jobs/{id}/events")).text();
    assert!(events(&first).contains("succeeded") && events(&first) == events(&third));

    let link =
        first.send("POST", &format!("/v1/jobs/{id}/frames/0/link"), &[], br#"{"expires_in_seconds": 60}"#.to_vec());
    assert_eq!(link.status, 200, "{}", link.text());
    let url = link.json()["url"].as_str().expect("a link").to_owned();
    let path = &url[url.find("/v1").expect("a path")..];
    assert!(third.get(path).body == wanted, "a link that one server has signed is valid at another: {url}");

    // A cancel at one server stops the worker of another.
    let heavy = first.accept(&jobs::sized(&jobs::named("mandelbulb"), 2048, 256).to_string());
    eventually("it runs", || (state(&third, &heavy) == "running").then_some(()));
    assert_eq!(third.send("POST", &format!("/v1/jobs/{heavy}/cancel"), &[], Vec::new()).status, 200);
    first.succeeded(&first.accept(&small(2).to_string()));
}

#[test]
fn a_worker_goes_on_at_another_server_if_its_own_is_killed() {
    let Some(cluster) = Cluster::new(2) else { return };
    let (mut first, second) = (cluster.start(0, "0"), cluster.start(1, "0"));
    let worker = cluster.worker();
    second.joined(1);
    let id = first.accept(&jobs::sized(&jobs::named("csg"), 512, 64).to_string());
    eventually("it runs", || (state(&second, &id) == "running").then_some(()));
    send_signal(first.process(), Signal::KILL);
    eventually("the server has ended", || first.has_ended().then_some(()));
    second.succeeded(&id);
    let workers = second.get("/v1/workers").json();
    assert_eq!(workers["workers"].as_array().map(Vec::len), Some(1), "it did not register again: {workers}");
    drop(worker);
}

#[test]
fn the_pool_of_a_server_that_is_killed_loses_its_leases_and_nothing_else() {
    let Some(cluster) = Cluster::new(2) else { return };
    let (first, second) = (cluster.start(0, "1"), cluster.start(1, "0"));
    first.ready(1);
    let id = second.accept(&jobs::sized(&jobs::named("mandelbulb"), 1024, 16).to_string());
    eventually("it runs", || (state(&second, &id) == "running").then_some(()));
    send_signal(first.process(), Signal::KILL);
    // Leases last for 30 s; leases of a pool whose server has ended are handed back within about ten.
    let start = Instant::now();
    eventually("its worker is gone", || {
        let workers = second.get("/v1/workers").json();
        workers["workers"]
            .as_array()
            .is_some_and(|list| list.iter().all(|worker| worker["state"] != "ready"))
            .then_some(())
    });
    assert!(start.elapsed() < Duration::from_secs(20), "{:?}", start.elapsed());
    second.send("POST", &format!("/v1/jobs/{id}/cancel"), &[], Vec::new());
    second.set_pool(1);
    second.succeeded(&second.accept(&small(3).to_string()));
}

#[test]
fn a_server_that_stops_within_a_transaction_delays_the_others_for_ten_seconds() {
    let Some(cluster) = Cluster::new(2) else { return };
    let second = cluster.start(1, "0");
    // Among its first commits is one that takes 20 s.
    let first = cluster.start_with(0, "0", "database_commit=slow:20000@9");
    let start = Instant::now();
    eventually("its ninth commit begins", || first.log().contains("triggered at pass 9").then_some(()));
    let accepted = second.accept(&small(1).to_string());
    let waited = start.elapsed();
    assert!(waited < Duration::from_secs(18), "{waited:?}");
    // Its transaction was rolled back, and it goes on.
    eventually("it is ready again", || (first.get("/readyz").status == 200).then_some(()));
    let answer = ask(
        &cluster.addresses[..1],
        0,
        "POST",
        "/v1/jobs",
        &[("content-type", "application/json")],
        small(2).to_string().as_bytes(),
    );
    assert_eq!(answer.status, 201, "{}", answer.text());
    let listed = second.get("/v1/jobs").json();
    assert_eq!(listed["jobs"].as_array().map(Vec::len), Some(2), "{listed}");
    assert!(listed.to_string().contains(&accepted));
    assert!(first.log().contains("the connection to the database has ended"), "{}", first.log());
}

#[test]
fn a_database_that_is_away_for_longer_than_a_lease_ends_none() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some(_) = postgres_server::required() else { return };
    let database = postgres_server::database_of(folder.path()).expect("a database");
    let network = SlowNetwork::to(&database, Duration::ZERO);
    let mut command = sdfarm(&["serve"]);
    command.env("SDFARM_DATABASE", network.address());
    let server = Farm::start_by(command, folder.path(), &["--workers", "0", "--lease-seconds", "4", "--tile", "64"]);
    let mut worker = sdfarm(&["worker", "--device", "cpu", "--threads", "1", "--server", &server.address]);
    let _worker = Worker(worker.stdin(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts"));
    let job = jobs::as_png(&jobs::sized(&jobs::named("csg"), 512, 16));
    let id = server.accept(&job.to_string());
    eventually("it runs", || (state(&server, &id) == "running").then_some(()));
    network.cut();
    let unreachable = eventually("reads fail", || {
        let answer = server.get(&format!("/v1/jobs/{id}"));
        (answer.status != 200).then_some(answer)
    });
    unreachable.problem(503, "database_unreachable");
    // The worker stops what it cannot renew, and returns it later.
    std::thread::sleep(Duration::from_secs(8));
    network.mend();
    eventually("reads succeed", || (server.get(&format!("/v1/jobs/{id}")).status == 200).then_some(()));
    server.succeeded(&id);
    assert!(server.picture(&id) == rendered_here(&job, 0));
    assert!(!server.log().contains("lease expired"), "{}", server.log());
    let workers = server.get("/v1/workers").json();
    assert_eq!(workers["workers"].as_array().map(Vec::len), Some(1), "it did not register again: {workers}");
}

#[test]
fn servers_with_different_secrets_or_without_one_exclude_each_other() {
    let Some(cluster) = Cluster::new(1) else { return };
    let _server = cluster.start(0, "0");
    let flags = ["--listen", "127.0.0.1:0", "--workers", "0", "--store", "s3://renders/farm", "--data"];
    let refused = |secret: &str, arguments: &[&str]| {
        let data = cluster.folder.path().join("other");
        let mut command = cluster.command(&["serve"], secret);
        if secret.is_empty() {
            command.env_remove("SDFARM_CLUSTER_SECRET");
        }
        let output = finish(
            {
                command.args(arguments).arg(data);
                command
            },
            b"",
        );
        assert!(!output.status.success());
        text(&output.stderr)
    };
    let other = refused("another secret of the servers of a farm", &flags);
    assert!(other.contains("another cluster secret") && other.contains("same SDFARM_CLUSTER_SECRET"), "{other}");
    let none = refused("", &flags);
    assert!(none.contains("another server uses it") && none.contains("SDFARM_CLUSTER_SECRET"), "{none}");
    let short = refused("short", &flags);
    assert!(short.contains("at least 32") && !short.contains("short\""), "{short}");
    let no_store = refused(SECRET, &["--data"]);
    assert!(no_store.contains("--store"), "{no_store}");
}

/// Sends a request to a server, and once more to the next one if it was not answered, or by a failure of the server.
fn ask(addresses: &[String], turn: usize, method: &str, path: &str, headers: &[(&str, &str)], body: &[u8]) -> Answer {
    let send = |turn: usize| {
        let address = format!("http://{}", addresses[turn % addresses.len()]);
        try_send(&address, method, path, headers, body.to_vec())
    };
    match send(turn) {
        Ok(answer) if answer.status < 500 => answer,
        Ok(_) | Err(_) => send(turn + 1).unwrap_or_else(|error| panic!("{method} {path} failed twice: {error}")),
    }
}

#[test]
fn servers_are_replaced_one_by_one_without_a_failed_request() {
    let Some(cluster) = Cluster::new(3) else { return };
    let mut servers: Vec<Option<Farm>> = (0..3).map(|place| Some(cluster.start(place, "0"))).collect();
    let _workers = [cluster.worker(), cluster.worker()];
    let is_over = AtomicBool::new(false);
    let (addresses, is_over) = (&cluster.addresses, &is_over);
    let client = |number: usize| {
        move || {
            let mut accepted = Vec::new();
            for turn in 0_usize.. {
                if is_over.load(Ordering::Relaxed) {
                    break;
                }
                let key = format!("{number}-{turn}");
                let headers = [("content-type", "application/json"), ("idempotency-key", key.as_str())];
                let job = small((number * 1000 + turn) as u64).to_string();
                let answer = ask(addresses, turn, "POST", "/v1/jobs", &headers, job.as_bytes());
                assert_eq!(answer.status, 201, "{}", answer.text());
                let id = answer.json()["id"].as_str().expect("an id").to_owned();
                for turn in turn..turn + 6 {
                    let answer = ask(addresses, turn, "GET", &format!("/v1/jobs/{id}"), &[], b"");
                    assert_eq!(answer.status, 200, "{}", answer.text());
                }
                accepted.push(id);
            }
            accepted
        }
    };
    let accepted: Vec<String> = std::thread::scope(|scope| {
        let clients: Vec<_> = (0..3).map(|number| scope.spawn(client(number))).collect();
        for (place, server) in servers.iter_mut().enumerate() {
            std::thread::sleep(Duration::from_secs(1));
            let old = server.take().expect("it runs");
            assert!(old.terminate().success());
            let new = cluster.start(place, "0");
            eventually("it is ready", || (new.get("/readyz").status == 200).then_some(()));
            *server = Some(new);
        }
        std::thread::sleep(Duration::from_secs(1));
        is_over.store(true, Ordering::Relaxed);
        clients.into_iter().flat_map(|client| client.join().expect("no request fails twice")).collect()
    });
    assert!(accepted.len() >= 30, "only {} jobs were submitted", accepted.len());
    let server = servers[0].as_ref().expect("it runs");
    for id in &accepted {
        server.succeeded(id);
    }
    eprintln!("{} jobs were accepted while three servers were replaced", accepted.len());
}

#[test]
fn the_secret_of_webhooks_is_that_of_every_server() {
    let secret = |cluster: &str| {
        let mut command = sdfarm(&["webhook", "secret"]);
        command.env("SDFARM_CLUSTER_SECRET", cluster);
        let output = finish(command, b"");
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let derived = secret(SECRET);
    assert!(derived.starts_with("whsec_") && derived == secret(SECRET) && derived != secret(&SECRET.replace('a', "b")));
}
