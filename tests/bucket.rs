//! A farm whose pictures are in a bucket of a real S3 store: rendered, served, checked, backed up and swept.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::postgres_server;
use crate::seaweedfs::SeaweedFs;
use crate::support::{Farm, eventually, finish, rendered_here, root, run, sdfarm, text};

/// Bucket and prefix of the farm.
const STORE: &str = "s3://renders/farms/one";

fn with_keys(s3: &SeaweedFs, arguments: &[&str]) -> Command {
    let mut command = sdfarm(arguments);
    command.envs(s3.environment());
    command
}

fn start(s3: &SeaweedFs, folder: &Path, arguments: &[&str]) -> Farm {
    let arguments = [&["--device", "cpu", "--workers", "1", "--tile", "32", "--store", STORE], arguments].concat();
    Farm::start_by(with_keys(s3, &["serve"]), folder, &arguments)
}

/// Runs a command that must succeed.
fn succeed(s3: &SeaweedFs, arguments: &[&str]) -> String {
    let output = finish(with_keys(s3, arguments), b"");
    assert!(output.status.success(), "{arguments:?}: {}{}", text(&output.stdout), text(&output.stderr));
    text(&output.stdout)
}

/// The scene of a file as a job of another size.
fn job(width: u32, height: u32, bits: u32) -> Value {
    let file = fs::read_to_string(root().join("scenes/csg.json")).expect("there");
    let mut job: Value = serde_json::from_str(&file).expect("JSON");
    job["image"] = serde_json::json!({ "width": width, "height": height, "samples": 1, "bits": bits });
    job
}

fn word(path: &Path) -> &str {
    path.to_str().expect("a plain name")
}

#[test]
fn pictures_in_a_bucket_are_those_of_the_command_line_and_are_swept() {
    let Some(s3) = SeaweedFs::start() else { return };
    s3.make_bucket("renders");
    let folder = tempfile::tempdir().expect("a folder");
    let (small, large) = (job(96, 64, 8), job(1280, 800, 16));
    let farm = start(&s3, folder.path(), &["--object-sweep-seconds", "0"]);
    let ids = [farm.accept(&small.to_string()), farm.accept(&large.to_string())];
    let wanted = [rendered_here(&small, 0), rendered_here(&large, 0)];
    for (id, wanted) in ids.iter().zip(&wanted) {
        farm.succeeded(id);
        assert!(farm.picture(id) == *wanted, "the picture has the bytes of `sdfarm render`");
    }
    let thumbnail = farm.get(&format!("/v1/jobs/{}/frames/0/thumbnail", ids[1]));
    assert_eq!((thumbnail.status, thumbnail.header("content-type")), (200, "image/png"), "{}", thumbnail.text());
    assert_eq!(farm.get("/readyz").json()["store_kind"], "s3");
    let metrics = farm.get("/metrics").text();
    assert!(metrics.contains(&format!("sdfarm_store_info{{kind=\"s3\",location=\"{STORE}\"}} 1")), "{metrics}");
    assert!(farm.terminate().success());
    assert!(!folder.path().join("data/pictures").exists(), "no picture is in the data folder");
    assert_eq!(s3.names("renders/farms/one/pictures").len(), 2);

    // Another process serves the same pictures; large ones come from the store itself.
    let farm = start(&s3, folder.path(), &["--object-sweep-seconds", "0", "--redirect-pictures"]);
    for (id, wanted) in ids.iter().zip(&wanted) {
        let answer = farm.get(&format!("/v1/jobs/{id}/image"));
        assert!(answer.status == 200 && answer.body == *wanted, "{}", answer.status);
        let is_redirected = answer.header("server").contains("SeaweedFS");
        assert_eq!(is_redirected, wanted.len() > 1 << 20, "{} bytes", wanted.len());
    }
    assert!(wanted[0].len() < 1 << 20 && wanted[1].len() > 1 << 20, "both ways are tested");
    let range = farm.send("GET", &format!("/v1/jobs/{}/image", ids[1]), &[("range", "bytes=5-14")], Vec::new());
    assert_eq!((range.status, &range.body[..]), (206, &wanted[1][5..15]));
    let head = farm.send("HEAD", &format!("/v1/jobs/{}/image", ids[1]), &[], Vec::new());
    assert_eq!((head.status, head.header("content-length")), (200, &*wanted[1].len().to_string()));

    assert_eq!(farm.send("DELETE", &format!("/v1/jobs/{}", ids[0]), &[], Vec::new()).status, 204);
    eventually("the picture of the deleted job is swept", || {
        (s3.names("renders/farms/one/pictures").len() == 1).then_some(())
    });
    eventually("tiles of stored frames are swept", || s3.names("renders/farms/one/tiles").is_empty().then_some(()));
    assert!(farm.picture(&ids[1]) == wanted[1], "that of the other job is kept");
    assert!(farm.terminate().success());
}

#[test]
fn farm_in_a_bucket_is_checked_backed_up_and_restored() {
    let Some(s3) = SeaweedFs::start() else { return };
    s3.make_bucket("renders");
    let folder = tempfile::tempdir().expect("a folder");
    let (data, copy, new) = (folder.path().join("data"), folder.path().join("copy"), folder.path().join("new/data"));
    let farm = start(&s3, folder.path(), &[]);
    let id = farm.accept(&job(64, 48, 8).to_string());
    farm.succeeded(&id);
    let wanted = farm.picture(&id);
    let printed = succeed(&s3, &["backup", word(&copy), "--data", word(&data)]);
    assert!(printed.contains(&format!("1 pictures stay in {STORE}")), "{printed}");
    let listed = fs::read_to_string(copy.join("pictures.txt")).expect("a list");
    assert_eq!(listed, format!("{} {}\n", blake3::hash(&wanted).to_hex(), wanted.len()));
    assert!(farm.terminate().success());

    let printed = succeed(&s3, &["restore", word(&copy), "--data", word(&new)]);
    assert!(printed.contains(&format!("its pictures are in {STORE}")), "{printed}");
    let printed = succeed(&s3, &["doctor", "--deep", "--data", word(&new), "--listen", "127.0.0.1:0"]);
    assert!(
        printed.contains(&format!("{STORE} can be read and written")) && printed.contains("1 pictures are intact"),
        "{printed}"
    );
    let farm = start(&s3, &folder.path().join("new"), &[]);
    assert!(farm.picture(&id) == wanted);
    assert!(farm.terminate().success());

    // Without the bucket nothing is lost: the doctor says what is wrong, and a server does not start.
    let elsewhere = with_keys(&s3, &["doctor", "--data", word(&new), "--listen", "127.0.0.1:0"])
        .env("AWS_SECRET_ACCESS_KEY", "wrong")
        .output()
        .expect("it runs");
    let printed = text(&elsewhere.stdout);
    assert!(printed.contains("ERROR    store") && printed.contains("set AWS_ACCESS_KEY_ID"), "{printed}");
    let output = run(&["serve", "--listen", "127.0.0.1:0", "--data", word(&new)]);
    let printed = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{printed}");
    assert!(printed.contains(&format!("has its pictures in {STORE}, not in the data folder")), "{printed}");
}

/// Files of a folder by their names.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(folder).into_iter().flatten().map(|entry| entry.expect("an entry"));
    let name = |entry: &fs::DirEntry| entry.file_name().into_string().expect("plain");
    entries.map(|entry| (name(&entry), fs::read(entry.path()).expect("readable"))).collect()
}

/// Moves a farm's pictures, here and there killed on the way.
#[test]
fn pictures_move_to_a_bucket_and_back() {
    let Some(s3) = SeaweedFs::start() else { return };
    s3.make_bucket("renders");
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let flags = ["--device", "cpu", "--workers", "2", "--tile", "32"];
    let farm = Farm::start_on(folder.path(), &flags);
    let mut several = job(96, 64, 8);
    several["frames"] = serde_json::json!({ "count": 6 });
    let done = farm.accept(&several.to_string());
    farm.succeeded(&done);
    let mut heavy = job(640, 480, 8);
    heavy["image"]["samples"] = 128.into();
    let heavy_picture = rendered_here(&heavy, 0);
    let open = farm.accept(&heavy.to_string());
    eventually("tiles of an unfinished frame are stored", || (files(&data.join("tiles")).len() > 1).then_some(()));
    // Without workers the frame stays unfinished, however fast the machine is.
    farm.set_pool(0);
    // The variable is that of the farm's database, if it is on PostgreSQL.
    let move_to = |place: &str, fail_points: &str| {
        let mut command = with_keys(&s3, &["--allow-fail-points", "move", "--data", word(&data), "--store-to", place]);
        command.env("SDFARM_FAIL_POINTS", fail_points);
        finish(command, b"")
    };
    assert!(text(&move_to(STORE, "").stderr).contains("stop it first"));
    assert!(farm.terminate().success());
    let (pictures, tiles) = (files(&data.join("pictures")), files(&data.join("tiles")));
    assert!(pictures.len() == 6 && !tiles.is_empty(), "{} pictures, {} tiles", pictures.len(), tiles.len());

    let killed = move_to(STORE, "store_put=kill@4");
    assert_eq!(killed.status.code(), None, "{}", text(&killed.stderr));
    assert!(!data.join("store").exists(), "the farm is as before");
    let moved = move_to(STORE, "");
    assert!(moved.status.success(), "{}", text(&moved.stderr));
    let printed = text(&moved.stdout);
    assert!(
        printed.contains(&format!("to {STORE}, where ")) && printed.contains(&format!(" --store {STORE}")),
        "{printed}"
    );
    assert!(!printed.contains("missing"), "{printed}");
    assert_eq!(s3.names("renders/farms/one/pictures").len(), pictures.len());
    let again = move_to(STORE, "");
    assert!(text(&again.stderr).contains(&format!("are in {STORE} already")), "{}", text(&again.stderr));

    // The farm works there, without the folder's files, and finishes what it had begun.
    fs::rename(data.join("pictures"), folder.path().join("old")).expect("renames");
    fs::remove_dir_all(data.join("tiles")).expect("removes");
    let farm = start(&s3, folder.path(), &[]);
    for frame in 0..6 {
        let picture = farm.get(&format!("/v1/jobs/{done}/frames/{frame}/image"));
        assert!(picture.status == 200 && picture.body == rendered_here(&several, frame), "frame {frame}");
    }
    farm.succeeded(&open);
    assert!(farm.picture(&open) == heavy_picture);
    assert!(farm.terminate().success());

    let killed = move_to("folder", "store_put=kill@3");
    assert_eq!(killed.status.code(), None, "{}", text(&killed.stderr));
    assert!(data.join("store").exists(), "the farm is as before");
    let back = move_to("folder", "");
    assert!(back.status.success(), "{}", text(&back.stderr));
    let now = files(&data.join("pictures"));
    assert_eq!(now.len(), pictures.len() + 1, "the earlier pictures, and the unfinished frame's");
    for (name, bytes) in &now {
        assert!(blake3::hash(bytes).to_hex().as_str() == name && pictures.get(name).is_none_or(|had| had == bytes));
    }
    assert!(pictures.keys().all(|name| now.contains_key(name)));
    let farm = Farm::start_on(folder.path(), &flags);
    assert!(farm.picture(&open) == heavy_picture);
    assert!(farm.terminate().success());
}

#[test]
fn two_farms_do_not_share_a_prefix() {
    // The doctor is for farms in files.
    if postgres_server::server().is_some() {
        return;
    }
    let Some(s3) = SeaweedFs::start() else { return };
    s3.make_bucket("renders");
    let (first, second) = (tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder"));
    start(&s3, first.path(), &[]).terminate();
    assert!(s3.names("renders/farms/one").contains(&"farm".to_owned()));
    let data = second.path().join("data");
    let arguments = ["serve", "--listen", "127.0.0.1:0", "--data", word(&data), "--store"];
    let refused = finish(with_keys(&s3, &[&arguments[..], &[STORE]].concat()), b"");
    let printed = text(&refused.stderr);
    assert_eq!(refused.status.code(), Some(1), "{printed}");
    assert!(printed.contains(&format!("the store {STORE} is that of another farm")), "{printed}");
    assert!(printed.contains(&format!("delete {STORE}/farm")), "{printed}");
    // It can start with a prefix of its own, and the first with the one that it has.
    let own = ["--device", "cpu", "--store", "s3://renders/farms/two"];
    Farm::start_by(with_keys(&s3, &["serve"]), second.path(), &own).terminate();
    start(&s3, first.path(), &[]).terminate();
    assert!(s3.names("renders/farms/two").contains(&"farm".to_owned()));
    // A copy of the first farm's database with the second one's store would delete its pictures.
    fs::write(first.path().join("data/store"), "s3://renders/farms/two\n").expect("writes");
    let data = first.path().join("data");
    let printed = text(&finish(with_keys(&s3, &["doctor", "--repair", "--data", word(&data)]), b"").stdout);
    assert!(printed.contains("ERROR    store") && printed.contains("is that of another farm"), "{printed}");
}

/// The store is killed in the middle of a job, and started again.
#[test]
fn a_job_outlasts_an_outage_of_its_store() {
    let Some(mut s3) = SeaweedFs::start() else { return };
    s3.make_bucket("renders");
    let folder = tempfile::tempdir().expect("a folder");
    let mut frames = job(160, 96, 8);
    frames["frames"] = serde_json::json!({ "count": 12 });
    frames["image"]["samples"] = 16.into();
    let farm = start(&s3, folder.path(), &["--lease-seconds", "3"]);
    farm.set_pool(2);
    let id = farm.accept(&frames.to_string());
    let stored = || farm.get(&format!("/v1/jobs/{id}")).json()["frames"]["done"].as_u64().expect("a number");
    eventually("two pictures are stored", || (stored() >= 2).then_some(()));
    s3.stop();
    let stored_before = stored();
    assert!(stored_before < 12, "the job has not finished");

    for path in [&*format!("/v1/jobs/{id}/frames/0/image"), "/readyz"] {
        let answer = farm.get(path);
        let problem = answer.problem(503, "store_unreachable");
        assert_eq!(answer.header("retry-after"), "5");
        let detail = problem["detail"].as_str().expect("words");
        assert!(detail.starts_with(&format!("the store {STORE} could not read ")), "{detail}");
    }
    eventually("an upload was answered with 503", || {
        farm.log().lines().any(|line| line.contains("could not write")).then_some(())
    });
    // Longer than a lease: the workers keep theirs, and the results that they hold.
    let away = Instant::now();
    eventually("two leases have passed", || (away.elapsed() > Duration::from_secs(6)).then_some(()));
    assert_eq!(farm.get(&format!("/v1/jobs/{id}")).json()["state"], "running");
    assert_eq!(farm.post(&job(32, 32, 8).to_string()).status, 201, "jobs are accepted meanwhile");

    s3.start_again();
    farm.succeeded(&id);
    for frame in 0..12 {
        let picture = farm.get(&format!("/v1/jobs/{id}/frames/{frame}/image"));
        assert!(picture.status == 200 && picture.body == rendered_here(&frames, frame), "frame {frame}");
    }
    assert_eq!(farm.get("/readyz").status, 200);
    assert!(!farm.log().contains("request failed"), "no request was answered with 500: {}", farm.log());
    assert!(farm.terminate().success());
}

#[test]
fn wrong_stores_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    for store in ["renders", "https://s3.example/renders", "s3://UPPER", "s3://abc/../x"] {
        let output = run(&["serve", "--data", word(folder.path()), "--store", store]);
        let printed = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{printed}");
        assert!(printed.contains("write s3://BUCKET or s3://BUCKET/PREFIX"), "{printed}");
    }
    let arguments = ["serve", "--listen", "127.0.0.1:0", "--data", word(folder.path()), "--store", STORE];
    let mut command = sdfarm(&arguments);
    command.env("AWS_ACCESS_KEY_ID", "key").env("AWS_SECRET_ACCESS_KEY", "secret").env("AWS_ALLOW_HTTP", "true");
    command.env("AWS_ENDPOINT_URL", "http://127.0.0.1:1");
    let output = finish(command, b"");
    let printed = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{printed}");
    assert!(printed.contains(STORE) && printed.contains("cannot be reached at http://127.0.0.1:1"), "{printed}");
}
