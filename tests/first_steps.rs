//! Tests a new user's first steps: the demo, visible pauses, saving several frames, and messages with fixes.

use std::fs;
use std::path::Path;
use std::process::Output;

use serde_json::{Value, json};

use crate::jobs;
use crate::support::{Farm, finish, root, sdfarm, text};

fn run_in(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = sdfarm(arguments);
    command.current_dir(folder);
    finish(command, b"")
}

/// Runs a command that must succeed; returns its standard output and its standard error.
fn done(folder: &Path, arguments: &[&str]) -> (String, String) {
    let output = run_in(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
    (text(&output.stdout), text(&output.stderr))
}

fn names_in(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("readable").flatten();
    let mut names: Vec<String> = entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// Creates a folder with `job.json`, a job of `count` frames.
fn folder_with_frames(count: u32) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let mut job = jobs::quick();
    job["name"] = json!("turn");
    job["frames"] = json!({ "count": count });
    fs::write(folder.path().join("job.json"), job.to_string()).expect("written");
    folder
}

#[test]
fn demo_prints_the_path_the_time_and_the_next_steps() {
    let folder = tempfile::tempdir().expect("a folder");
    let (said, remarks) = done(folder.path(), &["demo", "--width", "32"]);
    let path = fs::canonicalize(folder.path()).expect("there").join("fjord.png");
    assert!(said.starts_with(&format!("saved {} after ", path.display())) && said.ends_with(" s\n"), "{said}");
    assert!(remarks.contains("fjord: 32×16") && remarks.contains("next: ") && remarks.contains(" serve`"), "{remarks}");
    assert!(remarks.contains("http://127.0.0.1:8080") && remarks.contains(" open`"), "where to look: {remarks}");
    assert_eq!(names_in(folder.path()), ["fjord.png"]);
    let readme = fs::read_to_string(root().join("README.md")).expect("there");
    assert!(
        readme.contains("cargo run --release -- demo") && readme.contains("fjord.png"),
        "the README names the file"
    );
}

#[test]
fn pause_is_shown_by_every_command() {
    let farm = Farm::start(&["--workers", "0"]);
    let folder = folder_with_frames(1);
    let on_farm = |arguments: &[&str]| done(folder.path(), &[arguments, &["--server", &farm.address]].concat()).0;
    let id = on_farm(&["submit", "job.json"]).trim().to_owned();
    assert!(!on_farm(&["status"]).contains("paused") && !on_farm(&["jobs"]).contains("paused"));

    assert!(on_farm(&["pause", &id]).contains("(paused)"));
    assert!(on_farm(&["jobs"]).contains("(paused)"));
    let screen = on_farm(&["status"]);
    assert!(screen.lines().any(|line| line.starts_with("job ") && line.contains("paused")), "{screen}");
    assert_eq!(farm.get(&format!("/v1/jobs/{id}")).json()["paused"], true);
    assert_eq!(farm.get("/v1/jobs").json()["jobs"][0]["paused"], true);

    on_farm(&["resume", &id]);
    assert!(on_farm(&["pause"]).contains("sdfarm resume"));
    let remarks = done(folder.path(), &["jobs", "--server", &farm.address]).1;
    assert!(remarks.contains("the farm is paused: `sdfarm resume`"), "{remarks}");
    let screen = on_farm(&["status"]);
    assert!(screen.contains("ready, paused") || screen.contains("degraded, paused"), "{screen}");
    assert!(screen.contains("alert    the farm is paused: `sdfarm resume` continues it"), "{screen}");
    let printed: Value = serde_json::from_str(&on_farm(&["status", "--json"])).expect("JSON");
    assert_eq!(printed["paused"], true);
    assert_eq!(
        (farm.get("/v1/farm").json()["paused"].clone(), farm.get("/").json()["farm"]["paused"].clone()),
        (json!(true), json!(true))
    );
    on_farm(&["resume"]);
    assert!(!on_farm(&["status"]).contains("paused"));
}

#[test]
fn folder_gets_all_frames_and_a_file_the_first() {
    let farm = Farm::start(&["--workers", "1"]);
    let folder = folder_with_frames(3);
    let on_farm = |arguments: &[&str]| done(folder.path(), &[arguments, &["--server", &farm.address]].concat());
    let (id, remarks) = on_farm(&["submit", "job.json", "--wait", "-o", "first.png"]);
    let id = id.trim();
    assert!(remarks.contains("that is frame 0; the 2 other frames are stored too"), "{remarks}");
    assert!(remarks.contains(&format!("sdfarm fetch {id} -o DIR/")), "{remarks}");

    let (_, remarks) = on_farm(&["submit", "job.json", "--wait", "-o", "all/"]);
    assert!(remarks.contains("wrote 3 pictures to all/ (turn.0000.png to turn.0002.png)"), "{remarks}");
    let names = ["turn.0000.png", "turn.0001.png", "turn.0002.png"];
    assert_eq!(names_in(&folder.path().join("all")), names);
    let first = fs::read(folder.path().join("first.png")).expect("saved");
    assert!(first == fs::read(folder.path().join("all/turn.0000.png")).expect("saved"));

    fs::create_dir(folder.path().join("there")).expect("made");
    on_farm(&["fetch", id, "-o", "there"]);
    on_farm(&["fetch", id, "-o", "new/"]);
    for name in ["there", "new"] {
        assert_eq!(names_in(&folder.path().join(name)), names, "{name}");
    }
    on_farm(&["fetch", id, "--frame", "1", "-o", "one/"]);
    assert_eq!(names_in(&folder.path().join("one")), names[1..2]);
    let none = run_in(folder.path(), &["fetch", id, "--frame", "3", "-o", "one/", "--server", &farm.address]);
    assert!(
        none.status.code() == Some(1) && text(&none.stderr).contains("its frames are 0 to 2"),
        "{}",
        text(&none.stderr)
    );
}

#[test]
fn unwritable_output_is_reported_before_submission() {
    let farm = Farm::start(&["--workers", "0"]);
    let folder = folder_with_frames(2);
    fs::write(folder.path().join("file"), "").expect("written");
    for (output, says) in
        [("absent/a.png", "create it first"), ("file/", "could not create the folder"), ("a.jpg", ".png or .exr")]
    {
        let refused = run_in(folder.path(), &["submit", "job.json", "--wait", "-o", output, "--server", &farm.address]);
        assert_eq!(refused.status.code(), Some(2), "{output}: {}", text(&refused.stderr));
        assert!(text(&refused.stderr).contains(says), "{output}: {}", text(&refused.stderr));
    }
    assert_eq!(farm.get("/v1/jobs").json()["jobs"], json!([]));
}

#[test]
fn messages_name_the_location_and_the_fix() {
    let farm = Farm::start(&["--workers", "0"]);
    let folder = folder_with_frames(1);
    let absent = "01890a5d-ac96-774b-bcce-b302099a8057";
    let on_farm = ["--server", &farm.address];
    for (arguments, code, says) in [
        (&["submit", "nowhere.json"][..], 2, &["nowhere.json", "give an existing file"][..]),
        (&["check", "nowhere.json"], 2, &["nowhere.json", "give an existing file"]),
        (&["submit", "job.json", "--server", "http://127.0.0.1:1"], 1, &["http://127.0.0.1:1", "`sdfarm serve`"]),
        (&["submit", "job.json", "--server", "nowhere"], 2, &["\"nowhere\"", "http://HOST:PORT"]),
        (&["watch", absent, on_farm[0], on_farm[1]], 1, &[absent, "`sdfarm jobs`"]),
        (&["cancel", absent, on_farm[0], on_farm[1]], 1, &[absent, "`sdfarm jobs`"]),
        (&["fetch", absent, "-o", "a.png", on_farm[0], on_farm[1]], 1, &[absent, "`sdfarm jobs`"]),
        (&["fetch", absent, "-o", "dir/", on_farm[0], on_farm[1]], 1, &[absent, "`sdfarm jobs`"]),
        (&["jobs", "--cursor", "x", on_farm[0], on_farm[1]], 2, &["\"x\"", "next_cursor"]),
        (&["jobs", "--key", "", on_farm[0], on_farm[1]], 2, &["key", "SDFARM_KEY"]),
        (&["serve", "--listen", "x"], 2, &["--listen", "127.0.0.1:8080"]),
        (&["restore", "nowhere", "--data", "new"], 1, &["nowhere", "`sdfarm backup`"]),
        (&["doctor", "--data", "nowhere"], 1, &["nowhere", "--data"]),
        (&["key", "list", "--data", "nowhere"], 1, &["nowhere", "--data"]),
        (&["key", "new", "host-7", "--scope", "worker", "--data", "new"], 2, &["sdfarm key new admin --scope admin"]),
    ] {
        let output = run_in(folder.path(), arguments);
        let printed = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {printed}");
        for word in says {
            assert!(printed.contains(word), "{arguments:?} does not contain {word}: {printed}");
        }
    }
    assert_eq!(names_in(folder.path()), ["job.json", "new"], "only the requested key's folder is new");
}

#[test]
fn count_of_one_is_singular() {
    let folder = folder_with_frames(1);
    let (said, _) = done(folder.path(), &["check", "job.json"]);
    assert!(said.contains(" 1 frame of ") && !said.contains("1 frames"), "{said}");
    let (said, _) = done(folder.path(), &["explain", "job.json"]);
    assert!(said.contains(", 1 frame\n"), "{said}");
}

#[test]
fn workers_tiles_and_throughput_are_listed_and_a_worker_is_changed() {
    let farm = Farm::start(&["--workers", "1"]);
    let folder = folder_with_frames(1);
    let on_farm = |arguments: &[&str]| done(folder.path(), &[arguments, &["--server", &farm.address]].concat()).0;
    let id = on_farm(&["submit", "job.json", "--wait"]).trim().to_owned();
    let workers: Value = serde_json::from_str(&on_farm(&["workers", "--json"])).expect("JSON");
    let worker = &workers["workers"][0];
    let (name, short) = (worker["name"].as_str().expect("a name"), &worker["id"].as_str().expect("an id")[28..]);
    let listed = on_farm(&["workers"]);
    assert!(listed.starts_with(&format!("{short}  {name} ")) && listed.contains(" ready "), "{listed}");

    let tiles = on_farm(&["tiles", "latest", "--frame", "0"]);
    assert!(!tiles.is_empty());
    for line in tiles.lines() {
        assert!(line.starts_with("frame 0 ") && line.contains(&format!(" {name} ({short}) on cpu, ")), "{line}");
    }
    let (first, more) = done(folder.path(), &["tiles", &id, "--limit", "1", "--server", &farm.address]);
    assert_eq!(tiles.lines().next(), first.lines().next());
    assert_eq!(more.contains(&format!("more: sdfarm tiles {id} --cursor 0-0")), tiles.lines().count() > 1, "{more}");

    for (last, steps) in [("hour", 12), ("day", 24), ("week", 28)] {
        let table = on_farm(&["history", "--last", last]);
        assert_eq!(table.lines().count(), 1 + steps, "{table}");
        assert!(table.starts_with("from "), "{table}");
    }

    assert!(on_farm(&["workers", "quarantine", name]).contains(" quarantined "));
    let alerts = on_farm(&["status"]);
    assert!(alerts.contains(&format!("alert    quarantined, and without work: {name}: ")), "{alerts}");
    assert!(on_farm(&["workers", "release", short]).contains(" ready "));
    let wrong = run_in(folder.path(), &["workers", "drain", "nobody", "--server", &farm.address]);
    assert_eq!(wrong.status.code(), Some(2), "{}", text(&wrong.stderr));
    assert!(text(&wrong.stderr).contains("no worker matches \"nobody\""), "{}", text(&wrong.stderr));
    let alone = run_in(folder.path(), &["workers", "drain", "--server", &farm.address]);
    assert_eq!(alone.status.code(), Some(2), "{}", text(&alone.stderr));
    assert!(on_farm(&["workers", "drain", short]).contains(" draining "));
}
