//! The processes that read job files: what a submitter wrote ends at most one of them, and delays no other submitter.

use std::fs;
use std::process::Command;
use std::time::Duration;

use rustix::process::Signal;
use serde_json::json;

use crate::jobs;
use crate::support::{Farm, eventually, finish, is_alive, new_key, readers, send_signal};

fn tiny(seed: u64) -> String {
    jobs::seeded(&jobs::sized(&jobs::named("csg"), 8, 1), seed).to_string()
}

#[test]
fn a_small_text_that_takes_long_to_read_is_refused_and_delays_no_other_user() {
    let folder = tempfile::tempdir().expect("a folder");
    let key = |name, scope| new_key(folder.path(), name, scope);
    key("admin", "admin");
    let (anna, bert) = (key("anna", "submit"), key("bert", "submit"));
    let farm = Farm::start_on(folder.path(), &["--workers", "0"]);
    let text = jobs::of_noisy_copies(900_000).to_string();
    let submit = |bearer: &str, text: &str| {
        farm.send("POST", "/v1/jobs?dry_run=true", &[("authorization", bearer)], text.as_bytes().to_vec())
    };
    std::thread::scope(|scope| {
        let costly: Vec<_> = (0..2).map(|_| scope.spawn(|| submit(&anna, &text))).collect();
        std::thread::sleep(Duration::from_millis(500));
        let answer = farm.send("POST", "/v1/jobs", &[("authorization", &bert)], tiny(1).into());
        assert_eq!(answer.status, 201, "{}", answer.text());
        // They have occupied every process for a moment, and are then read one after the other.
        assert!(costly.iter().all(|costly| !costly.is_finished()), "the other user did not wait for them");
        for answer in costly {
            let answer = answer.join().expect("a response");
            let problem = answer.problem(422, "wrong_job");
            assert!(problem["errors"][0]["message"].as_str().expect("text").contains("s to read"), "{problem}");
        }
    });
    assert_eq!(farm.get("/livez").status, 200);
}

#[test]
fn readers_may_be_killed_at_any_time() {
    let farm = Farm::start(&["--workers", "1"]);
    let first = farm.accept(&tiny(0));
    farm.succeeded(&first);
    let ids: Vec<String> = (1..40)
        .map(|seed| {
            for reader in readers(farm.process()) {
                send_signal(reader, Signal::KILL);
            }
            farm.accept(&tiny(seed))
        })
        .collect();
    for id in &ids {
        farm.succeeded(id);
    }
    let problem = farm.post(&json!({ "scene": 1 }).to_string()).problem(422, "wrong_job");
    assert!(!problem["errors"].as_array().expect("a list").is_empty(), "{problem}");
}

#[test]
fn a_killed_server_leaves_no_reader() {
    let mut farm = Farm::start(&["--workers", "0"]);
    farm.accept(&tiny(0));
    let idle = readers(farm.process());
    assert!(!idle.is_empty(), "one has read the job");
    send_signal(farm.process(), Signal::KILL);
    eventually("the server is dead", || farm.has_ended().then_some(()));
    eventually("its readers are dead", || idle.iter().all(|&process| !is_alive(process)).then_some(()));
}

#[test]
fn stored_jobs_that_this_release_rejects_delay_no_other_user() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let bearer = [("admin", "admin"), ("anna", "submit"), ("bert", "submit")]
        .map(|(name, scope)| new_key(folder.path(), name, scope));
    let accept = |farm: &Farm, bearer: &str, seed| {
        let answer = farm.send("POST", "/v1/jobs", &[("authorization", bearer)], tiny(seed).into());
        assert_eq!(answer.status, 201, "{}", answer.text());
        answer.json()["id"].as_str().expect("an id").to_owned()
    };
    let farm = Farm::start_on(folder.path(), &["--workers", "0"]);
    let annas: Vec<String> = (0..6).map(|seed| accept(&farm, &bearer[1], seed)).collect();
    farm.terminate();

    // An earlier release accepted a file that this one takes too long to read.
    let file = folder.path().join("costly.json");
    fs::write(&file, jobs::of_noisy_copies(900_000).to_string()).expect("writable");
    let program = "import sqlite3, sys
farm = sqlite3.connect(sys.argv[1])
farm.execute('UPDATE job_file SET text = ?', (open(sys.argv[2]).read(),))
farm.commit()";
    let mut python = Command::new("python3");
    python.args(["-c", program]).arg(data.join("farm.sqlite")).arg(&file);
    assert!(finish(python, b"").status.success());

    let farm = Farm::start_on(folder.path(), &["--workers", "1"]);
    let view = |id: &str| {
        let answer = farm.send("GET", &format!("/v1/jobs/{id}"), &[("authorization", &bearer[0])], Vec::new());
        answer.json()
    };
    let state = |id: &String| view(id)["state"].as_str().expect("a state").to_owned();
    for seed in 10..13 {
        let id = accept(&farm, &bearer[2], seed);
        eventually("it is rendered", || (state(&id) == "succeeded").then_some(()));
    }
    assert!(annas.iter().any(|id| state(id) == "queued"), "the other user waited for all that are rejected");
    // They are read one after the other, and say why they fail.
    let failed = eventually("one fails", || annas.iter().find(|id| state(id) == "failed"));
    assert!(view(failed)["errors"].to_string().contains("s to read"), "{}", view(failed));
}
