//! Access control of a real server: API keys, TLS, workers on another host, idle connections, and secrets in logs.

use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Output, Stdio};
use std::time::Duration;

use rcgen::{CertificateParams, KeyPair};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

use crate::support::{DEADLINE, Farm, eventually, finish, rendered_here, sdfarm, text};
use crate::{jobs, recorded};

/// Number of idle connections in every test run.
const FEW_IDLE: u64 = 200;
/// Number of idle connections in long test runs.
const IDLE: u64 = 2000;
/// Number of idle connections if the system permits enough open files.
const MANY_IDLE: u64 = 10_000;

/// Runs `sdfarm key` on a data folder.
fn key(data: &Path, arguments: &[&str]) -> Output {
    let mut command = sdfarm(&["key"]);
    command.args(arguments).arg("--data").arg(data);
    finish(command, b"")
}

/// Creates a key, and returns its secret.
fn new_key(data: &Path, name: &str, scope: &str) -> String {
    let made = key(data, &["new", name, "--scope", scope]);
    assert!(made.status.success(), "{}", text(&made.stderr));
    text(&made.stdout).trim().to_owned()
}

fn bearer(key: &str) -> String {
    format!("Bearer {key}")
}

/// Worker process that is killed on drop.
struct Worker(Child);

impl Drop for Worker {
    fn drop(&mut self) {
        // Both fail only if the process has already exited.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn keys_work_on_a_running_server_and_are_never_logged() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let admin = new_key(&data, "ops", "admin");
    let farm = Farm::start_on(folder.path(), &["--workers", "0", "-v"]);
    farm.get("/v1/jobs").problem(401, "missing_key");
    let anna = new_key(&data, "anna", "submit,read");
    let asked = |key: &str| farm.send("GET", "/v1/jobs", &[("authorization", &bearer(key))], Vec::new()).status;
    eventually("the server knows the key", || (asked(&anna) == 200).then_some(()));

    let mut submit = sdfarm(&["submit", "-", "--server", &farm.address]);
    submit.env("SDFARM_KEY", &anna);
    let submitted = finish(submit, jobs::quick().to_string().as_bytes());
    assert!(submitted.status.success(), "{}", text(&submitted.stderr));
    let listed = text(&key(&data, &["list"]).stdout);
    assert!(listed.contains("anna") && listed.contains("submit,read") && !listed.contains(&anna), "{listed}");

    let revoked = key(&data, &["revoke", "anna"]);
    assert!(revoked.status.success(), "{}", text(&revoked.stderr));
    eventually("the server knows that it is revoked", || (asked(&anna) == 401).then_some(()));
    let again = key(&data, &["revoke", "anna"]);
    assert_eq!(again.status.code(), Some(1), "{}", text(&again.stderr));
    let mut list = sdfarm(&["jobs", "--server", &farm.address]);
    list.env("SDFARM_KEY", &anna);
    let refused = finish(list, b"");
    assert_eq!(refused.status.code(), Some(1));
    assert!(text(&refused.stderr).contains("revoked"), "{}", text(&refused.stderr));

    eventually("the audit log tells it", || {
        let log = farm.send("GET", "/v1/audit", &[("authorization", &bearer(&admin))], Vec::new()).text();
        (log.contains("anna") && log.contains("missing_key")).then_some(())
    });
    let log = farm.log();
    assert!(log.contains("anna") && log.contains("DEBUG"), "the log names the key and the requests: {log}");
    for secret in [&admin, &anna] {
        assert!(!log.contains(&secret[4..]), "a secret is in the log");
    }
    let everything = fs::read(data.join("farm.sqlite")).expect("readable");
    assert!(!everything.windows(anna.len()).any(|window| window == anna.as_bytes()), "a secret is in the database");
}

#[test]
fn invalid_key_arguments_are_usage_errors() {
    let folder = tempfile::tempdir().expect("a folder");
    for (arguments, word) in [
        (&["new", "a b", "--scope", "read"][..], "dots"),
        (&["new", "anna", "--scope", "root"], "root"),
        (&["new", "anna"], "--scope"),
        (&["new", "anna", "--scope", "read", "--expires", "soon"], "90d"),
        (&["new", "anna", "--scope", "read", "--max-jobs", "0"], "jobs"),
        (&["new", "host-7", "--scope", "worker"], "sdfarm key new admin --scope admin"),
    ] {
        let output = key(folder.path(), arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", text(&output.stderr));
        assert!(text(&output.stderr).contains(word), "{arguments:?}: {}", text(&output.stderr));
    }
    let elsewhere = key(&folder.path().join("nowhere"), &["list"]);
    assert_eq!(elsewhere.status.code(), Some(1));
    assert!(text(&elsewhere.stderr).contains("--data"), "{}", text(&elsewhere.stderr));
}

/// Writes a self-signed certificate; returns the files of the certificate and its key.
fn certificate(folder: &Path) -> (PathBuf, PathBuf) {
    let key = KeyPair::generate().expect("a key");
    let names = vec!["localhost".to_owned(), "127.0.0.1".to_owned()];
    let certificate = CertificateParams::new(names).expect("names").self_signed(&key).expect("a certificate");
    let (certificate_file, key_file) = (folder.join("cert.pem"), folder.join("key.pem"));
    fs::write(&certificate_file, certificate.pem()).expect("written");
    fs::write(&key_file, key.serialize_pem()).expect("written");
    (certificate_file, key_file)
}

#[test]
fn remote_worker_renders_over_tls_with_its_key() {
    let folder = tempfile::tempdir().expect("a folder");
    let (certificate, secret) = certificate(folder.path());
    let data = folder.path().join("data");
    new_key(&data, "ops", "admin");
    let (anna, host) = (new_key(&data, "anna", "submit"), new_key(&data, "host-7", "worker"));
    let files = [certificate.to_str().expect("plain"), secret.to_str().expect("plain")];
    let farm = Farm::start_on(
        folder.path(),
        &["--workers", "0", "--tile", "64", "--tls-cert", files[0], "--tls-key", files[1]],
    );
    assert!(farm.address.starts_with("https://"), "{}", farm.address);
    let with = |arguments: &[&str], key: &str| {
        let mut command = sdfarm(arguments);
        command.args(["--server", &farm.address, "--ca", files[0]]).env("SDFARM_KEY", key);
        command
    };
    let mut worker = with(&["worker", "--device", "cpu", "--threads", "1"], &host);
    let _worker = Worker(worker.stdin(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts"));
    let picture = folder.path().join("out.png");
    let mut submit = with(&["submit", "-", "--wait"], &anna);
    submit.arg("-o").arg(&picture);
    let submitted = finish(submit, jobs::quick().to_string().as_bytes());
    assert!(submitted.status.success(), "{}\n{}", text(&submitted.stderr), farm.log());
    assert!(fs::read(&picture).expect("saved").starts_with(b"\x89PNG"));
    // It also reads what recorded jobs have kept.
    let mut scene = recorded::balls(12, "png");
    let recorded = finish(with(&["submit", "-", "--wait", "--record"], &anna), scene.to_string().as_bytes());
    assert!(recorded.status.success(), "{}\n{}", text(&recorded.stderr), farm.log());
    scene["scene"]["objects"][6]["material"]["diffuse"]["kd"] = serde_json::json!([0.1, 0.2, 0.8]);
    let mut edit = with(&["submit", "-", "--wait", "--based-on", text(&recorded.stdout).trim()], &anna);
    edit.arg("-o").arg(&picture);
    let edited = finish(edit, scene.to_string().as_bytes());
    let printed = text(&edited.stderr);
    assert!(printed.contains(" tiles are those of ") && !printed.contains("0 of "), "{printed}\n{}", farm.log());
    assert!(fs::read(&picture).expect("saved") == rendered_here(&scene, 0), "the bytes of a full render");
    let stranger = finish(with(&["worker", "--device", "cpu", "--threads", "1"], &anna), b"");
    assert_eq!(stranger.status.code(), Some(1));
    assert!(text(&stranger.stderr).contains("scope worker"), "{}", text(&stranger.stderr));
}

#[test]
fn pool_renders_behind_tls_and_keys() {
    let folder = tempfile::tempdir().expect("a folder");
    let (certificate, secret) = certificate(folder.path());
    let data = folder.path().join("data");
    new_key(&data, "ops", "admin");
    let anna = new_key(&data, "anna", "submit");
    let files = [certificate.to_str().expect("plain"), secret.to_str().expect("plain")];
    let serve = ["--workers", "1", "--device", "cpu", "--tls-cert", files[0], "--tls-key", files[1]];
    let farm = Farm::start_on(folder.path(), &serve);
    let mut submit = sdfarm(&["submit", "-", "--wait", "--server", &farm.address, "--ca", files[0]]);
    submit.env("SDFARM_KEY", &anna);
    let submitted = finish(submit, jobs::quick().to_string().as_bytes());
    assert!(submitted.status.success(), "{}\n{}", text(&submitted.stderr), farm.log());
}

/// Number of connections that can be opened, after raising the limit of open files.
fn granted() -> u64 {
    let limit = getrlimit(Resource::Nofile);
    // If the system rejects the change, the limit stays as it was.
    let _ = setrlimit(Resource::Nofile, Rlimit { current: limit.maximum, maximum: limit.maximum });
    getrlimit(Resource::Nofile).current.unwrap_or(u64::MAX)
}

/// Opens connections that send nothing.
fn idle_connections(address: &str, connections: u64) -> Vec<TcpStream> {
    eprintln!("{connections} idle connections");
    (0..connections).map(|_| TcpStream::connect(address).expect("the server takes every connection")).collect()
}

fn address(farm: &Farm) -> &str {
    farm.address.trim_start_matches("http://")
}

/// Asserts that a farm renders a job while this many connections are idle.
fn assert_served_among(connections: u64) {
    let farm = Farm::start(&["--workers", "1", "--device", "cpu"]);
    let idle = idle_connections(address(&farm), connections);
    let id = farm.accept(&jobs::quick().to_string());
    farm.succeeded(&id);
    assert_eq!(farm.get("/livez").status, 200);
    drop(idle);
    assert!(farm.terminate().success());
}

#[test]
fn farm_serves_with_hundreds_of_idle_connections() {
    assert_served_among(FEW_IDLE);
}

#[test]
#[ignore = "long: thousands of idle connections; a few seconds"]
fn farm_serves_with_thousands_of_idle_connections() {
    assert_served_among(if granted() >= MANY_IDLE + 2000 { MANY_IDLE } else { IDLE });
}

#[test]
#[ignore = "long: waits for the server's timeout of request headers; 30 s"]
fn client_that_sends_headers_too_slowly_is_disconnected() {
    let farm = Farm::start(&["--workers", "0"]);
    let mut slow = TcpStream::connect(address(&farm)).expect("connects");
    slow.set_read_timeout(Some(DEADLINE)).expect("a timeout");
    let head = b"GET /livez HTTP/1.1\r\nHost: localhost\r\nX-Slow: ".iter().chain(std::iter::repeat(&b'x'));
    for byte in head {
        if slow.write_all(&[*byte]).is_err() {
            break;
        }
        // The client sends one byte at a time until the server's timeout.
        std::thread::sleep(Duration::from_millis(250));
    }
    let mut answer = Vec::new();
    // The connection was reset or closed.
    let _ = slow.read_to_end(&mut answer);
    assert_eq!(farm.get("/livez").status, 200);
    assert!(farm.terminate().success());
}
