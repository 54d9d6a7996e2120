//! Tests faults of the machine: a used port or folder, a full disk, a damaged database. Each gives exit code 1 or a
//! problem that names the location and the fix, and never a panic.

mod fail_points;
mod network;
mod nth_failure;
mod remote;
mod slow_clients;

use std::fs;
use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

use crate::jobs;
use crate::skip::skip;
use crate::support::{Farm, PROGRAM, clean, eventually, finish, run, sdfarm, text};

/// Tries to serve, which must fail with exit code 1; returns the message.
fn cannot_serve(data: &Path, arguments: &[&str]) -> String {
    let mut command = sdfarm(&["serve", "--workers", "0", "--data"]);
    command.arg(data).args(arguments);
    failed(&finish(command, b""), 1)
}

/// Returns the standard error of a failed command, which must have a line with the error, and no panic.
fn failed(output: &Output, code: i32) -> String {
    let printed = text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{printed}");
    assert!(!printed.contains("panicked"), "{printed}");
    assert!(printed.lines().any(|line| line.starts_with("error: ")), "{printed}");
    printed
}

#[test]
fn used_port_is_reported_with_the_fix() {
    let holder = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = holder.local_addr().expect("bound").to_string();
    let folder = tempfile::tempdir().expect("a folder");
    let printed = cannot_serve(&folder.path().join("data"), &["--listen", &address]);
    assert!(printed.contains(&address) && printed.contains("--listen"), "{printed}");
}

#[test]
fn data_folder_of_another_server_is_rejected() {
    let folder = tempfile::tempdir().expect("a folder");
    let farm = Farm::start_on(folder.path(), &["--workers", "0"]);
    let printed = cannot_serve(&folder.path().join("data"), &["--listen", "127.0.0.1:0"]);
    assert!(printed.contains("--data") && printed.contains(&farm.process().to_string()), "{printed}");
    assert_eq!(farm.get("/livez").status, 200);
}

#[test]
fn file_instead_of_a_data_folder_is_rejected() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    fs::write(&data, "no folder").expect("written");
    let printed = cannot_serve(&data, &["--listen", "127.0.0.1:0"]);
    assert!(printed.contains("--data") && printed.contains(data.to_str().expect("plain")), "{printed}");
    assert_eq!(fs::read(&data).expect("still there"), b"no folder");
}

#[test]
fn read_only_data_folder_is_rejected() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    fs::create_dir(&data).expect("made");
    let Some(_mounted) = Mount::new(&data, "ro") else {
        return skip("mount", "a read-only folder needs a mount, which this user may not create");
    };
    let printed = cannot_serve(&data, &["--listen", "127.0.0.1:0"]);
    assert!(printed.contains("--data") && printed.contains(data.to_str().expect("plain")), "{printed}");
}

#[test]
fn damaged_database_is_rejected_and_unchanged() {
    let folder = tempfile::tempdir().expect("a folder");
    let farm = Farm::start_on(folder.path(), &["--workers", "0"]);
    farm.accept(&jobs::quick().to_string());
    assert!(farm.terminate().success());
    let data = folder.path().join("data");
    let database = fs::read_dir(&data)
        .expect("readable")
        .flatten()
        .map(|entry| entry.path())
        .find(|path| fs::read(path).is_ok_and(|bytes| bytes.starts_with(b"SQLite format 3")))
        .expect("a SQLite database");
    let sound = fs::read(&database).expect("readable");
    for (name, from, to) in [("its first page", 0, 100), ("its header", 16, 40), ("a page in the middle", 4096, 12288)]
    {
        let mut bytes = sound.clone();
        let to = to.min(bytes.len());
        bytes[from..to].fill(0x5a);
        fs::write(&database, &bytes).expect("written");
        let printed = cannot_serve(&data, &["--listen", "127.0.0.1:0"]);
        let says_so = printed.contains("backup") && printed.contains(database.to_str().expect("plain"));
        assert!(says_so, "{name} overwritten: {printed}");
        assert!(fs::read(&database).expect("readable") == bytes, "{name} overwritten: the file was changed");
    }
    fs::write(&database, sound).expect("written");
    assert_eq!(Farm::start_on(folder.path(), &["--workers", "0"]).get("/v1/jobs").status, 200);
}

#[test]
fn listening_beyond_loopback_needs_keys_or_the_flag() {
    let folder = tempfile::tempdir().expect("a folder");
    let printed = cannot_serve(&folder.path().join("data"), &["--listen", "0.0.0.0:0"]);
    assert!(printed.contains("--insecure"), "{printed}");
}

#[test]
fn full_disk_gives_a_problem_and_the_server_recovers() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    fs::create_dir(&data).expect("made");
    let Some(_mounted) = Mount::new(&data, "size=4m") else {
        return skip("mount", "a small disk needs a mount, which this user may not create");
    };
    let farm = Farm::start_on(folder.path(), &["--workers", "1"]);
    let ballast = data.join("ballast");
    fill(&ballast);
    let refused = (0..1000u64)
        .map(|seed| farm.post(&jobs::seeded(&jobs::quick(), seed).to_string()))
        .find(|answer| answer.status != 201);
    let refused = refused.expect("a full disk rejects some of a thousand jobs");
    assert!((500..600).contains(&refused.status), "{} {}", refused.status, refused.text());
    assert_eq!(refused.header("content-type"), "application/problem+json");
    assert_eq!(farm.get("/livez").status, 200);

    fs::remove_file(&ballast).expect("ours");
    let accepted = eventually("jobs are taken again", || {
        let answer = farm.post(&jobs::seeded(&jobs::quick(), 5000).to_string());
        (answer.status == 201).then(|| answer.json()["id"].as_str().expect("an id").to_owned())
    });
    farm.succeeded(&accepted);
}

#[test]
fn full_disk_keeps_no_server_from_starting_and_no_job_from_being_cancelled_or_deleted() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    fs::create_dir(&data).expect("made");
    let Some(_mounted) = Mount::new(&data, "size=8m") else {
        return skip("mount", "a small disk needs a mount, which this user may not create");
    };
    let farm = Farm::start_on(folder.path(), &["--workers", "0"]);
    let ids: Vec<String> = (0..20).map(|seed| farm.accept(&jobs::seeded(&jobs::quick(), seed).to_string())).collect();
    assert!(data.join("reserve").metadata().expect("set aside").len() > 0);
    assert!(farm.terminate().success());

    fill(&data.join("ballast"));
    let farm = Farm::start_on(folder.path(), &["--workers", "0"]);
    assert!(!data.join("reserve").exists(), "it was needed to start");
    let refused = farm.post(&jobs::quick().to_string());
    assert_eq!((refused.status, refused.json()["code"].as_str()), (507, Some("disk_full")), "{}", refused.text());
    for id in &ids {
        let cancelled = farm.send("POST", &format!("/v1/jobs/{id}/cancel"), &[], Vec::new());
        assert_eq!(cancelled.status, 200, "{}", cancelled.text());
        let deleted = farm.send("DELETE", &format!("/v1/jobs/{id}"), &[], Vec::new());
        assert_eq!(deleted.status, 204, "{}", deleted.text());
    }
    fs::remove_file(data.join("ballast")).expect("ours");
    eventually("the reserve is restored", || data.join("reserve").exists().then_some(()));
    eventually("jobs are taken again", || (farm.post(&jobs::quick().to_string()).status == 201).then_some(()));
}

#[test]
fn full_disk_releases_its_reserve_for_a_deletion_and_keeps_nothing_unreported() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    fs::create_dir(&data).expect("made");
    let Some(_mounted) = Mount::new(&data, "size=8m") else {
        return skip("mount", "a small disk needs a mount, which this user may not create");
    };
    let farm = Farm::start_on(folder.path(), &["--workers", "0"]);
    let first = farm.accept(&jobs::quick().to_string());
    // As a worker leaves it that is killed before it reports.
    let left = data.join("tiles").join("ab".repeat(32));
    fs::write(&left, vec![0; 1 << 20]).expect("written");
    fill(&data.join("ballast"));
    let refused = (0..1000u64)
        .map(|seed| farm.post(&jobs::seeded(&jobs::quick(), seed).to_string()))
        .find(|answer| answer.status != 201);
    assert_eq!(refused.expect("the disk is full").status, 507);
    assert!(data.join("reserve").exists(), "it is not for submissions");
    let cancelled = farm.send("POST", &format!("/v1/jobs/{first}/cancel"), &[], Vec::new());
    assert_eq!(cancelled.status, 200, "{}", cancelled.text());
    let deleted = farm.send("DELETE", &format!("/v1/jobs/{first}"), &[], Vec::new());
    assert_eq!(deleted.status, 204, "{}", deleted.text());
    assert!(!data.join("reserve").exists());
    let full = Instant::now();
    eventually("what nobody has reported is deleted", || (!left.exists()).then_some(()));
    assert!(full.elapsed() < Duration::from_mins(2), "on an empty disk it is kept for longer than that");
    eventually("jobs are taken again", || (farm.post(&jobs::quick().to_string()).status == 201).then_some(()));
}

/// Writes zeros until the disk is full.
fn fill(path: &Path) {
    use std::io::Write;
    let mut file = fs::File::create(path).expect("made");
    for size in [65536, 512] {
        while file.write_all(&vec![0; size]).is_ok() {}
    }
}

#[test]
fn picture_that_does_not_fit_leaves_no_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let job = folder.path().join("job.json");
    fs::write(&job, jobs::as_exr(&jobs::quick()).to_string()).expect("written");
    let picture = folder.path().join("picture.exr");
    // Files are limited to 4 KiB; with the signal ignored, a write beyond that fails as on a full disk.
    let script = r#"trap '' XFSZ; ulimit -f 8; exec "$0" render "$1" -o "$2""#;
    let mut command = Command::new("sh");
    clean(&mut command).args(["-c", script, PROGRAM]).arg(&job).arg(&picture);
    let printed = failed(&finish(command, b""), 1);
    assert!(printed.contains(picture.to_str().expect("plain")), "{printed}");
    let left: Vec<_> =
        fs::read_dir(folder.path()).expect("readable").flatten().map(|entry| entry.file_name()).collect();
    assert_eq!(left, ["job.json"], "only the job file is left");
}

#[test]
fn unreachable_server_is_reported_with_the_fix() {
    let free = TcpListener::bind("127.0.0.1:0").expect("a free port").local_addr().expect("bound");
    let printed = failed(&run(&["jobs", "--server", &format!("http://{free}")]), 1);
    assert!(printed.contains("sdfarm serve") && printed.contains(&free.to_string()), "{printed}");
}

/// Small or read-only file system that is unmounted on drop.
struct Mount<'a>(&'a Path);

impl<'a> Mount<'a> {
    fn new(at: &'a Path, options: &str) -> Option<Self> {
        let mut command = Command::new("mount");
        command.args(["-t", "tmpfs", "-o", options, "tmpfs"]).arg(at);
        let is_mounted = command.output().is_ok_and(|output| output.status.success());
        is_mounted.then_some(Self(at))
    }
}

impl Drop for Mount<'_> {
    fn drop(&mut self) {
        // Lazily, because the server under test may still have files open there.
        let _ = Command::new("umount").arg("-l").arg(self.0).output();
    }
}
