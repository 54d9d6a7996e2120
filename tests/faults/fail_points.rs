//! Kills a process at each fail point once; the job must finish with the same pictures as an undisturbed one.

use std::path::Path;

use proto::fail_point::{self, FailPoint};
use serde_json::Value;

use crate::faults::remote::Remote;
use crate::jobs;
use crate::support::{Farm, eventually, finish, rendered_here, sdfarm, text};

/// Short lease, so that a killed worker's tiles are soon leased again.
const LEASE_SECONDS: [&str; 2] = ["--lease-seconds", "1"];

/// Job of two frames with more rays than a worker of unknown speed gets in one batch, so that there are blobs and
/// stitches.
fn shared_job(seed: u64) -> Value {
    let mut job = jobs::seeded(&jobs::many_rays(), seed);
    job["frames"] = serde_json::json!({ "count": 2 });
    job
}

/// Starts a farm with armed fail points.
fn armed(folder: &Path, points: &str, arguments: &[&str]) -> Farm {
    let mut command = sdfarm(&[fail_point::FLAG, "serve"]);
    command.env(fail_point::ENV_VAR, points);
    Farm::start_by(command, folder, arguments)
}

fn check(farm: &Farm, id: &str, job: &Value, point: &str) {
    farm.succeeded(id);
    for frame in 0..2 {
        let answer = farm.get(&format!("/v1/jobs/{id}/frames/{frame}/image"));
        assert_eq!(answer.status, 200, "{}", answer.text());
        assert!(answer.body == rendered_here(job, frame), "{point}: frame {frame} differs from an undisturbed render");
    }
    assert!(!farm.log().contains("panicked"), "{point}: {}", farm.log());
}

fn server_dies_at(point: FailPoint, seed: u64) {
    let name = point.name();
    let folder = tempfile::tempdir().expect("a folder");
    let pool = ["--workers", "2", "--tile", "96"];
    let job = shared_job(seed);
    // Pictures of the pool's own workers do not pass these points.
    let from_elsewhere = [FailPoint::BlobStored, FailPoint::PictureStored].contains(&point);
    let flags = if from_elsewhere { ["--workers", "0", "--tile", "96"] } else { pool };
    let mut farm = armed(folder.path(), &format!("{name}=kill@1"), &flags);
    let remotes = from_elsewhere.then(|| Remote::pair(&farm));
    let answer = farm.try_send("POST", "/v1/jobs", &[("content-type", "application/json")], job.to_string().into());
    let accepted = answer.filter(|answer| answer.status == 201).map(|answer| answer.json()["id"].clone());
    eventually(&format!("the server dies at {name}"), || farm.has_ended().then_some(()));
    drop((farm, remotes));
    let farm = Farm::start_on(folder.path(), &pool);
    let id = match accepted {
        Some(id) => id.as_str().expect("an id").to_owned(),
        None => farm.accept(&job.to_string()),
    };
    check(&farm, &id, &job, name);
}

#[test]
fn server_killed_between_two_steps_loses_nothing() {
    for (seed, point) in [FailPoint::SubmitCommitted, FailPoint::Claimed, FailPoint::BlobStored].into_iter().enumerate()
    {
        server_dies_at(point, seed as u64);
    }
}

#[test]
fn server_killed_between_commit_and_response_loses_nothing() {
    for (seed, point) in [FailPoint::PictureStored, FailPoint::Sweeping].into_iter().enumerate() {
        server_dies_at(point, 10 + seed as u64);
    }
}

#[test]
fn server_killed_during_its_start_starts_again() {
    let folder = tempfile::tempdir().expect("a folder");
    for (number, point) in
        ["migrating", "migrated", "group_committed", "database_write", "database_commit"].into_iter().enumerate()
    {
        let mut command = sdfarm(&[fail_point::FLAG, "serve", "--workers", "0", "--listen", "127.0.0.1:0", "--data"]);
        command.arg(folder.path().join("data")).env(fail_point::ENV_VAR, format!("{point}=kill@1"));
        let output = finish(command, b"");
        assert_eq!(output.status.code(), None, "{point}: {}", text(&output.stderr));
        assert!(text(&output.stderr).contains(point), "{}", text(&output.stderr));
        let farm = Farm::start_on(folder.path(), &["--workers", "0"]);
        farm.accept(&jobs::seeded(&jobs::quick(), number as u64).to_string());
        let jobs = farm.get("/v1/jobs").json();
        assert_eq!(jobs["jobs"].as_array().map(Vec::len), Some(number + 1), "{point}: {jobs}");
    }
}

#[test]
fn worker_killed_between_two_steps_changes_no_picture() {
    for (seed, point) in [FailPoint::BlobPut, FailPoint::PicturePut, FailPoint::Stitching].into_iter().enumerate() {
        let name = point.name();
        let farm = Farm::start(&[&["--workers", "0", "--tile", "96"][..], &LEASE_SECONDS].concat());
        let points = format!("{name}=kill@1");
        let mut victims = [Remote::start(&farm, Some(&points)), Remote::start(&farm, Some(&points))];
        farm.joined(2);
        let job = shared_job(20 + seed as u64);
        let id = farm.accept(&job.to_string());
        eventually(&format!("a worker dies at {name}"), || victims.iter_mut().any(Remote::has_ended).then_some(()));
        let _heir = Remote::start(&farm, None);
        check(&farm, &id, &job, name);
    }
}

#[test]
fn fail_points_need_the_flag() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut command = sdfarm(&["serve"]);
    command.env(fail_point::ENV_VAR, "submit_committed=kill,group_committed=kill");
    let farm = Farm::start_by(command, folder.path(), &["--workers", "0"]);
    farm.accept(&jobs::quick().to_string());
    let mut wrong = sdfarm(&[fail_point::FLAG, "serve"]);
    wrong.env(fail_point::ENV_VAR, "nowhere=kill");
    let output = finish(wrong, b"");
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("submit_committed"), "{}", text(&output.stderr));
}
