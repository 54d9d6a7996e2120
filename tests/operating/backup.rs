//! Tests backup, restore, and the doctor with the real binary on real farms.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use crate::support::{Farm, eventually, run, sdfarm, succeed, text};

/// Small job of several frames, whose pictures differ for each seed.
fn job(seed: u32, frames: u32) -> String {
    format!(
        r#"{{"name": "kept", "scene": {{"camera": {{"position": [0, 0, 4], "look_at": [0, 0, 0]}},
            "objects": [{{"material": {{"normals": {{}}}}, "shape": {{"sphere": {{"radius": {{"keys": [[0, 1], [1, 1.5]]}}}}}}}}]}},
            "image": {{"width": 64, "height": 48, "samples": 1, "seed": {seed}}}, "frames": {{"count": {frames}}}}}"#
    )
}

fn start(folder: &Path) -> Farm {
    Farm::start_on(folder, &["--device", "cpu", "--workers", "1"])
}

fn word(path: &Path) -> &str {
    path.to_str().expect("a plain name")
}

fn pictures(data: &Path) -> Vec<PathBuf> {
    let mut pictures: Vec<PathBuf> =
        fs::read_dir(data.join("pictures")).expect("a folder").map(|entry| entry.expect("an entry").path()).collect();
    pictures.sort();
    pictures
}

fn frame(farm: &Farm, job: &str, number: u32) -> Vec<u8> {
    let answer = farm.get(&format!("/v1/jobs/{job}/frames/{number}/image"));
    assert_eq!(answer.status, 200, "{}", answer.text());
    answer.body
}

/// Runs `sdfarm doctor` with a free port; returns its output and its exit code.
fn doctor(data: &Path, flags: &[&str]) -> (String, Option<i32>) {
    let output = run(&[&["doctor", "--data", word(data), "--listen", "127.0.0.1:0"], flags].concat());
    (text(&output.stdout) + &text(&output.stderr), output.status.code())
}

#[test]
fn running_farm_is_backed_up_and_restored_completely() {
    let folder = tempfile::tempdir().expect("a folder");
    let (data, copy, new) = (folder.path().join("data"), folder.path().join("copy"), folder.path().join("new/data"));
    let farm = start(folder.path());
    let first = farm.accept(&job(1, 3));
    farm.succeeded(&first);
    fs::write(data.join("secret"), "of a webhook").expect("writes");
    let printed = succeed(&["backup", word(&copy), "--data", word(&data)]);
    assert!(printed.starts_with("3 pictures are in ") && printed.contains(": 3 copied now"), "{printed}");

    // Only new pictures are copied, and pictures that no job uses are dropped.
    let second = farm.accept(&job(2, 2));
    farm.succeeded(&second);
    let dropped = farm.accept(&job(3, 1));
    farm.succeeded(&dropped);
    let printed = succeed(&["backup", word(&copy), "--data", word(&data)]);
    assert!(printed.starts_with("6 pictures") && printed.contains(": 3 copied now"), "{printed}");
    assert_eq!(farm.send("DELETE", &format!("/v1/jobs/{dropped}"), &[], Vec::new()).status, 204);
    let printed = succeed(&["backup", word(&copy), "--data", word(&data)]);
    assert!(printed.starts_with("5 pictures") && printed.contains("0 copied now (0 bytes), 1 dropped"), "{printed}");
    let wanted: Vec<Vec<u8>> = (0..3).map(|number| frame(&farm, &first, number)).collect();
    drop(farm);

    let printed = succeed(&["restore", word(&copy), "--data", word(&new)]);
    assert!(printed.contains("5 pictures are intact"), "{printed}");
    assert_eq!(fs::read_to_string(new.join("secret")).expect("restored"), "of a webhook");
    let again = run(&["restore", word(&copy), "--data", word(&new)]);
    assert_eq!(again.status.code(), Some(1));
    assert!(text(&again.stderr).contains("is not empty"), "{}", text(&again.stderr));
    let (printed, code) = doctor(&new, &["--deep"]);
    assert_eq!(code, Some(0), "{printed}");

    let farm = start(&folder.path().join("new"));
    let got: Vec<Vec<u8>> = (0..3).map(|number| frame(&farm, &first, number)).collect();
    assert_eq!(got, wanted, "every picture is restored, byte by byte");
    assert_eq!(farm.get(&format!("/v1/jobs/{dropped}")).status, 404);
    assert!(farm.terminate().success());
}

#[test]
fn damaged_backup_is_reported() {
    let folder = tempfile::tempdir().expect("a folder");
    let (data, copy) = (folder.path().join("data"), folder.path().join("copy"));
    let farm = start(folder.path());
    let id = farm.accept(&job(1, 2));
    farm.succeeded(&id);
    succeed(&["backup", word(&copy), "--data", word(&data)]);
    assert!(farm.terminate().success());

    // The file is replaced, because the backup's file is a hard link to the store's.
    let picture = &pictures(&copy)[0];
    let bytes = fs::read(picture).expect("reads");
    fs::remove_file(picture).expect("removes");
    fs::write(picture, vec![0; bytes.len()]).expect("writes");
    let new = folder.path().join("a");
    let output = run(&["restore", word(&copy), "--data", word(&new)]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("1 pictures are lost"), "{}", text(&output.stderr));
    assert_eq!(pictures(&new).len(), 1, "a damaged picture is not restored");

    let database = fs::read_dir(&copy)
        .expect("a folder")
        .flatten()
        .find_map(|entry| entry.file_name().to_string_lossy().starts_with("farm-").then(|| entry.path()));
    fs::write(database.expect("a copy of the database"), "no database").expect("writes");
    let output = run(&["restore", word(&copy), "--data", word(&folder.path().join("b"))]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("database") && text(&output.stderr).contains("damaged"));
    assert!(!folder.path().join("b/farm.sqlite").exists());
}

#[test]
fn backup_rejects_other_folders_as_source_or_target() {
    let folder = tempfile::tempdir().expect("a folder");
    let (data, copy) = (folder.path().join("data"), folder.path().join("copy"));
    let refused = |arguments: &[&str], why: &str| {
        let output = run(arguments);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        assert!(text(&output.stderr).contains(why), "{arguments:?}: {}", text(&output.stderr));
    };
    refused(&["backup", word(&copy), "--data", word(&data)], "there is no farm in");
    refused(&["doctor", "--data", word(&data)], "there is no farm in");
    assert!(start(folder.path()).terminate().success());
    fs::create_dir_all(&copy).expect("makes");
    fs::write(copy.join("a letter"), "dear reader").expect("writes");
    refused(&["backup", word(&copy), "--data", word(&data)], "are not a backup");
    refused(&["backup", word(&data.join("copy")), "--data", word(&data)], "is inside the data folder");
    refused(&["restore", word(&copy), "--data", word(&folder.path().join("new"))], "is no backup");
    assert_eq!(fs::read_dir(&copy).expect("a folder").count(), 1, "nothing was added");
}

#[test]
fn backup_on_the_same_disk_links_the_pictures() {
    let folder = tempfile::tempdir().expect("a folder");
    let (data, copy) = (folder.path().join("data"), folder.path().join("copy"));
    let farm = start(folder.path());
    let id = farm.accept(&job(1, 1));
    farm.succeeded(&id);
    succeed(&["backup", word(&copy), "--data", word(&data)]);
    let node = |data: &Path| fs::metadata(&pictures(data)[0]).expect("there").ino();
    assert_eq!(node(&data), node(&copy));
    assert!(farm.terminate().success());
}

#[test]
fn doctor_finds_lost_pictures_and_requeues_them() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let farm = start(folder.path());
    let id = farm.accept(&job(1, 3));
    farm.succeeded(&id);
    let wanted: Vec<Vec<u8>> = (0..3).map(|number| frame(&farm, &id, number)).collect();
    let (printed, code) = doctor(&data, &[]);
    assert_eq!(code, Some(0), "{printed}");
    assert!(printed.contains("a server (pid "), "{printed}");
    let output = run(&["doctor", "--repair", "--data", word(&data)]);
    assert!(text(&output.stderr).contains("stop it first"), "{}", text(&output.stderr));
    assert!(farm.terminate().success());

    // One picture is missing, one has other bytes of the same length, and one file is an orphan.
    let there = pictures(&data);
    fs::remove_file(&there[0]).expect("removes");
    let length = fs::metadata(&there[1]).expect("there").len();
    fs::write(&there[1], vec![0; length as usize]).expect("writes");
    fs::write(data.join("pictures").join("f".repeat(64)), "an orphan").expect("writes");
    let (printed, code) = doctor(&data, &[]);
    assert_eq!(code, Some(1), "{printed}");
    assert!(printed.contains("1 pictures are missing") && !printed.contains("are damaged"), "{printed}");
    let (printed, code) = doctor(&data, &["--deep", "--repair"]);
    assert_eq!(code, Some(0), "{printed}");
    for line in ["1 pictures are missing", "1 pictures are damaged", "2 frames will be rendered again", "removed"] {
        assert!(printed.contains(line), "{line}: {printed}");
    }
    let (printed, code) = doctor(&data, &["--deep", "--json"]);
    assert_eq!(code, Some(0), "{printed}");
    let findings: Vec<serde_json::Value> = serde_json::from_str(&printed).expect("JSON");
    assert!(
        findings.iter().all(|finding| finding["severity"] != "error" && finding["subject"].is_string()),
        "{printed}"
    );

    let farm = start(folder.path());
    farm.succeeded(&id);
    let got: Vec<Vec<u8>> = (0..3).map(|number| frame(&farm, &id, number)).collect();
    assert_eq!(got, wanted, "the pictures are the same as before");
    assert!(farm.terminate().success());
    let (printed, code) = doctor(&data, &["--deep"]);
    assert_eq!(code, Some(0), "{printed}");
}

#[test]
fn doctor_reports_a_damaged_database_and_a_used_port() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    assert!(start(folder.path()).terminate().success());
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = taken.local_addr().expect("bound").to_string();
    let output = run(&["doctor", "--data", word(&data), "--listen", &address]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stdout).contains("ERROR    port"), "{}", text(&output.stdout));

    let file = data.join("farm.sqlite");
    let mut bytes = fs::read(&file).expect("reads");
    let half = bytes.len() / 2;
    bytes[half..half + 4096].fill(0x5a);
    fs::write(&file, bytes).expect("writes");
    let (printed, code) = doctor(&data, &[]);
    assert_eq!(code, Some(1), "{printed}");
    assert!(printed.contains("ERROR    database") && printed.contains("sdfarm restore"), "{printed}");
}

/// While jobs are submitted, rendered, and deleted, each backup is a complete farm.
#[test]
fn backups_of_a_busy_farm_are_complete() {
    let folder = tempfile::tempdir().expect("a folder");
    let (data, copy) = (folder.path().join("data"), folder.path().join("copy"));
    let farm = start(folder.path());
    for round in 0..3 {
        let ids: Vec<String> = (0..4).map(|seed| farm.accept(&job(100 * round + seed, 2))).collect();
        farm.succeeded(&ids[0]);
        farm.send("DELETE", &format!("/v1/jobs/{}", ids[0]), &[], Vec::new());
        let mut backup = sdfarm(&["backup", word(&copy), "--data", word(&data)]);
        let output = backup.output().expect("runs");
        assert!(output.status.success(), "{}", text(&output.stderr));
        let new = folder.path().join(format!("restored-{round}"));
        succeed(&["restore", word(&copy), "--data", word(&new)]);
        let (printed, code) = doctor(&new, &["--deep"]);
        assert_eq!(code, Some(0), "{printed}");
    }
    eventually("every job ends", || {
        let list = farm.get("/v1/jobs").json();
        let jobs = list["jobs"].as_array().expect("jobs");
        jobs.iter().all(|job| job["state"] == "succeeded").then_some(())
    });
    assert!(farm.terminate().success());
}
