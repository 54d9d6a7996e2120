//! Tests client commands: following a job across a server crash, saving animations, changing and deleting jobs.

use std::fs;
use std::io;
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Command, Output};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use serde_json::{Value, json};

use crate::jobs;
use crate::skip::skip;
use crate::support::{Farm, eventually, finish, sdfarm, succeed, text};

/// Proxy with a fixed address for a server that is restarted.
struct Door {
    address: String,
    behind: Arc<Mutex<Option<String>>>,
    callers: Arc<AtomicUsize>,
}

impl Door {
    fn open() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let address = format!("http://{}", listener.local_addr().expect("an address"));
        let behind: Arc<Mutex<Option<String>>> = Arc::default();
        let callers: Arc<AtomicUsize> = Arc::default();
        let (target, count) = (Arc::clone(&behind), Arc::clone(&callers));
        std::thread::spawn(move || {
            for caller in listener.incoming().flatten() {
                let address = target.lock().expect("no panic").clone();
                // Without a server, the connection is closed.
                let Some(Ok(server)) = address.map(TcpStream::connect) else { continue };
                count.fetch_add(1, Ordering::SeqCst);
                pass_on(&caller, &server);
                pass_on(&server, &caller);
            }
        });
        Self { address, behind, callers }
    }

    fn lead_to(&self, farm: Option<&Farm>) {
        *self.behind.lock().expect("no panic") = farm.map(|farm| farm.address.replace("http://", ""));
    }
}

fn pass_on(from: &TcpStream, to: &TcpStream) {
    let (mut from, mut to) = (from.try_clone().expect("a socket"), to.try_clone().expect("a socket"));
    std::thread::spawn(move || {
        // Both sides are closed, with or without an error.
        let _ = io::copy(&mut from, &mut to);
        let _ = to.shutdown(std::net::Shutdown::Both);
    });
}

#[test]
fn watch_continues_after_a_server_crash() {
    let folder = tempfile::tempdir().expect("a folder");
    let door = Door::open();
    let first = Farm::start_on(folder.path(), &["--workers", "0"]);
    door.lead_to(Some(&first));
    let id = first.accept(&jobs::quick().to_string());
    let watching = std::thread::spawn({
        let (id, address) = (id.clone(), door.address.clone());
        move || finish(sdfarm(&["watch", &id, "--server", &address]), b"")
    });
    eventually("somebody follows", || (door.callers.load(Ordering::SeqCst) > 0).then_some(()));
    // Kills the server immediately.
    drop(first);
    door.lead_to(None);
    let second = Farm::start_on(folder.path(), &["--workers", "1"]);
    door.lead_to(Some(&second));
    let watched = watching.join().expect("no panic");
    assert!(watched.status.success(), "{}\n{}", text(&watched.stderr), second.log());
    assert!(text(&watched.stdout).contains("succeeded"));
}

fn on(farm: &Farm, folder: &Path, arguments: &[&str]) -> Output {
    let mut command = sdfarm(&[arguments, &["--server", &farm.address]].concat());
    command.current_dir(folder);
    finish(command, b"")
}

fn good(output: &Output) -> String {
    assert!(output.status.success(), "{}", text(&output.stderr));
    text(&output.stdout).trim().to_owned()
}

fn animation() -> Value {
    let mut job = jobs::sized(&jobs::quick(), 64, 1);
    job["name"] = "walk".into();
    job["frames"] = json!({ "count": 3, "fps": 24 });
    job
}

#[test]
fn all_frames_are_saved_as_files_and_as_an_archive() {
    let farm = Farm::start(&["--workers", "1"]);
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("job.json"), animation().to_string()).expect("written");
    let id = good(&on(&farm, folder.path(), &["submit", "job.json", "--wait"]));
    good(&on(&farm, folder.path(), &["fetch", &id, "--all", "-o", "frames"]));
    good(&on(&farm, folder.path(), &["fetch", &id, "-o", "frames.zip"]));
    for frame in 0..3 {
        let saved = fs::read(folder.path().join(format!("frames/walk.{frame:04}.png"))).expect("saved");
        assert!(saved == farm.get(&format!("/v1/jobs/{id}/frames/{frame}/image")).body, "frame {frame}");
    }
    match Command::new("unzip").arg("-t").arg(folder.path().join("frames.zip")).output() {
        Ok(tested) => {
            let printed = text(&tested.stdout);
            assert!(tested.status.success() && printed.contains("walk.0002.png"), "{printed}");
        }
        Err(_) => skip("unzip", "unzip is not installed; the archive is not tested"),
    }
    let printed = good(&on(&farm, folder.path(), &["delete", &id, "--dry-run"]));
    assert!(printed.starts_with("would delete 3 pictures"), "{printed}");
    good(&on(&farm, folder.path(), &["delete", &id]));
    assert_eq!(farm.get(&format!("/v1/jobs/{id}")).status, 404);
}

#[test]
fn priority_changes_and_only_failed_jobs_are_retried() {
    let farm = Farm::start(&["--workers", "0"]);
    let folder = tempfile::tempdir().expect("a folder");
    let id = farm.accept(&animation().to_string());
    assert!(good(&on(&farm, folder.path(), &["priority", &id, "-7"])).contains(&id[28..]));
    let refused = on(&farm, folder.path(), &["retry", &id]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(text(&refused.stderr).contains("only failed jobs can be retried"), "{}", text(&refused.stderr));
    assert_eq!(on(&farm, folder.path(), &["priority", &id, "101"]).status.code(), Some(2));
    let early = on(&farm, folder.path(), &["fetch", &id, "-o", "frames.zip"]);
    assert_eq!(early.status.code(), Some(1));
    assert!(!folder.path().join("frames.zip").exists(), "no partial file is left");
}

#[test]
fn webhook_secret_is_printed_from_the_data_folder() {
    let folder = tempfile::tempdir().expect("a folder");
    let farm = Farm::start_on(folder.path(), &["--workers", "0"]);
    let data = folder.path().join("data");
    let secret = succeed(&["webhook", "secret", "--data", data.to_str().expect("plain")]);
    assert!(secret.starts_with("whsec_"), "{secret}");
    assert!(!farm.log().contains(secret.trim()), "the secret is not in the log");
}
