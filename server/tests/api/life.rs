//! A server's life: what it refuses to start with, what a restart keeps, its pool, its health.

use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::Duration;

use proto::job::JobState;
use proto::pool::{PoolView, WorkerList};
use proto::work::{self, Hello, Welcome};
use reqwest::StatusCode;
use serde_json::{Value, json};
use server::{Server, StartError};

use super::harness::{Farm, Said, assert_state, config, in_time, leases, read, refused, small_job};

async fn start_error(data: &Path, change: impl FnOnce(&mut server::Config)) -> StartError {
    let mut config = config(data);
    change(&mut config);
    Server::start(config).await.expect_err("the server must not start")
}

#[tokio::test]
async fn a_restart_keeps_jobs_and_pictures_and_a_worker_from_elsewhere_keeps_its_lease() {
    let farm = Farm::start().await;
    let done = farm.submit(&small_job(1)).await;
    farm.worker("one").await.work_off().await;
    let open = farm.submit(&small_job(2)).await;
    let waiting = farm.submit(&small_job(3)).await;
    let worker = farm.worker("two").await;
    let run = worker.claim().await.expect("work");
    let id = worker.id;
    let folder = farm.stop().await;

    let farm = Farm::start_in(folder, |_| {}).await;
    assert_state(&farm, done.id, JobState::Succeeded).await;
    assert_eq!(farm.get(&format!("/v1/jobs/{}/image", done.id)).await.status(), StatusCode::OK);
    assert_state(&farm, waiting.id, JobState::Queued).await;
    let mut worker = farm.worker("two").await;
    worker.id = id;
    assert_eq!(worker.report(worker.results(&run).await).await.lost, []);
    assert_state(&farm, open.id, JobState::Succeeded).await;
    farm.stop().await;
}

#[tokio::test]
async fn a_data_folder_has_one_server() {
    let farm = Farm::start().await;
    let error = start_error(farm.folder.path(), |_| {}).await;
    assert!(matches!(error, StartError::InUse { .. }), "{error:?}");
    assert!(error.to_string().contains(&format!("pid {}", std::process::id())), "{error}");
    farm.stop().await;
}

#[tokio::test]
async fn a_busy_port_an_exposed_address_and_a_damaged_database_are_named_with_a_cure() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let busy = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = busy.local_addr().expect("an address");
    let error = start_error(folder.path(), |config| config.listen = address).await.to_string();
    assert!(error.contains(&address.to_string()) && error.contains("--listen"), "{error}");
    let error = start_error(folder.path(), |config| config.listen = ([0, 0, 0, 0], 0).into()).await.to_string();
    assert!(error.contains("--insecure"), "{error}");

    for garbage in [vec![0x5a; 9000], b"short".to_vec()] {
        let file = folder.path().join("farm.sqlite");
        std::fs::write(&file, garbage).expect("writes");
        let error = start_error(folder.path(), |_| {}).await.to_string();
        assert!(error.contains("farm.sqlite") && error.contains("backup"), "{error}");
        std::fs::remove_file(&file).expect("removes");
    }
}

#[tokio::test]
async fn a_page_of_the_database_that_was_overwritten_is_found_at_start() {
    let farm = Farm::start().await;
    for seed in 0..20 {
        farm.submit(&small_job(seed)).await;
    }
    let folder = farm.stop().await;
    let file = folder.path().join("farm.sqlite");
    let mut bytes = std::fs::read(&file).expect("reads");
    let middle = bytes.len() / 2;
    bytes[4096..middle].fill(0xa5);
    std::fs::write(&file, bytes).expect("writes");
    let error = start_error(folder.path(), |_| {}).await.to_string();
    assert!(error.contains("farm.sqlite") && error.contains("backup"), "{error}");
}

#[tokio::test]
async fn a_data_folder_that_can_not_be_made_is_named_with_a_cure() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("file");
    std::fs::write(&file, "not a folder").expect("writes");
    let error = start_error(&file.join("data"), |_| {}).await;
    assert!(matches!(error, StartError::DataFolder { .. }), "{error:?}");
    assert!(error.to_string().contains("--data"), "{error}");
}

#[tokio::test]
async fn health_names_the_workers_and_metrics_count() {
    let farm = Farm::start().await;
    assert_eq!(farm.get("/livez").await.status(), StatusCode::OK);
    let ready: Value = read(farm.get("/readyz").await, StatusCode::OK).await;
    assert_eq!(ready, json!({"status": "degraded", "database": "ok", "store": "ok", "workers": []}));
    farm.submit(&small_job(1)).await;
    let worker = farm.worker("one").await;
    worker.claim().await.expect("work");
    let ready: Value = read(farm.get("/readyz").await, StatusCode::OK).await;
    assert_eq!((&ready["status"], &ready["workers"]), (&json!("ready"), &json!(["one"])));
    let text = in_time(farm.get("/metrics").await.text()).await.expect("text");
    for line in [
        "sdfarm_jobs{state=\"running\"} 1",
        "sdfarm_tiles{state=\"leased\"} 1",
        "sdfarm_workers{state=\"ready\"} 1",
        "sdfarm_leases_expired_total 0",
    ] {
        assert!(text.lines().any(|found| found == line), "{line} in {text}");
    }
    farm.stop().await;
}

/// A program that says who it is, and lives until its input ends.
fn stand_in(folder: &Path) -> std::path::PathBuf {
    let program = folder.join("stand-in");
    let text = "#!/bin/sh\nmkdir -p \"$(dirname \"$0\")/started\"\n\
                printf '%s %s' \"$SDFARM_WORKER_TOKEN\" \"$*\" > \"$(dirname \"$0\")/started/.$$\"\n\
                mv \"$(dirname \"$0\")/started/.$$\" \"$(dirname \"$0\")/started/$$\"\nexec cat\n";
    std::fs::write(&program, text).expect("writes");
    std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).expect("may be run");
    program
}

/// Waits until something is so.
async fn until<T>(mut look: impl FnMut() -> Option<T>) -> T {
    in_time(async {
        loop {
            if let Some(found) = look() {
                return found;
            }
            tokio::task::yield_now().await;
        }
    })
    .await
}

/// The processes that have started, with what they said.
fn started(folder: &Path) -> Vec<(u32, String)> {
    let Ok(entries) = std::fs::read_dir(folder.join("started")) else { return Vec::new() };
    entries
        .filter_map(|entry| {
            let path = entry.ok()?.path();
            Some((path.file_name()?.to_str()?.parse().ok()?, std::fs::read_to_string(path).ok()?))
        })
        .collect()
}

fn lives(process: u32) -> bool {
    Path::new(&format!("/proc/{process}")).exists()
}

#[tokio::test]
async fn the_pool_grows_shrinks_replaces_its_dead_and_leaves_no_orphan() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let programs = tempfile::tempdir().expect("a temporary folder");
    let program = stand_in(programs.path());
    let farm = Farm::start_in(folder, |config| {
        config.workers = Some(1);
        config.worker_program = program;
        config.grace = Duration::from_secs(3);
    })
    .await;
    let (process, said) = until(|| started(programs.path()).pop()).await;
    assert!(said.contains("worker --server http://127.0.0.1:") && said.contains("--pool"), "{said}");

    // The test speaks for the process.
    let token = said.split(' ').next().expect("a token");
    let hello = Hello {
        name: "whatever".to_owned(),
        device: "cpu".to_owned(),
        picture_version: scene::PICTURE_VERSION,
        max_nodes: None,
        process,
    };
    let request = farm.client.post(farm.url(work::REGISTER)).bearer_auth(token).json(&hello);
    let welcome: Welcome = read(in_time(request.send()).await.expect("an answer"), StatusCode::OK).await;
    let list: WorkerList = read(farm.get("/v1/workers").await, StatusCode::OK).await;
    assert_eq!(list.workers[0].name, "pool-1");
    let pool: PoolView = read(farm.get("/v1/pool").await, StatusCode::OK).await;
    assert_eq!(pool, PoolView { workers: 1, ready: 1 });

    // Its death is noticed at once, by a clock that stands still.
    let posted = farm.submit(&small_job(1)).await;
    let mut child = farm.worker("helper").await;
    let helper = child.id;
    child.id = welcome.worker;
    let held = leases(&child.claim().await.expect("work"));
    child.id = helper;
    let killed = std::process::Command::new("kill").args(["-9", &process.to_string()]).status().expect("kill runs");
    assert!(killed.success());
    let again = child.next().await;
    assert_eq!(again.job, posted.id);
    assert_ne!(leases(&again), held);
    child.report(child.results(&again).await).await;
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    child.id = welcome.worker;
    refused(child.try_sync(Said::default()).await, 404, "unknown_worker").await;

    // Another took its place; more come when asked for, and go again.
    let put = |workers: u32| farm.client.put(farm.url("/v1/pool")).json(&json!({ "workers": workers })).send();
    let pool: PoolView = read(in_time(put(3)).await.expect("an answer"), StatusCode::OK).await;
    assert_eq!(pool.workers, 3);
    until(|| (started(programs.path()).len() == 4).then_some(())).await;
    let alive = || started(programs.path()).iter().filter(|(process, _)| lives(*process)).count();
    until(|| (alive() == 3).then_some(())).await;
    in_time(put(1)).await.expect("an answer");
    until(|| (alive() == 1).then_some(())).await;
    farm.stop().await;
    assert_eq!(alive(), 0);
}

#[tokio::test]
async fn a_worker_program_that_is_not_there_does_not_stop_the_server() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let farm = Farm::start_in(folder, |config| config.workers = Some(2)).await;
    let pool: PoolView = read(farm.get("/v1/pool").await, StatusCode::OK).await;
    assert_eq!(pool, PoolView { workers: 2, ready: 0 });
    farm.stop().await;
}

#[tokio::test]
async fn a_store_that_fails_costs_a_retry_and_leaves_no_half_picture() {
    let farm = Farm::start().await;
    let posted = farm.submit(&small_job(1)).await;
    let worker = farm.worker("one").await;
    let run = worker.claim().await.expect("work");
    let folder = farm.folder.path().join("pictures");
    std::fs::remove_dir(&folder).expect("is empty");
    std::fs::write(&folder, "in the way").expect("writes");
    let hash = blake3::hash(b"a picture").to_hex().to_string();
    let put = worker.put(&work::picture_path(&hash), b"a picture".to_vec()).await;
    refused(put, 500, "internal").await;
    let handed_back = work::Report { lease: leases(&run)[0], outcome: work::Outcome::HandedBack };
    worker.report(vec![handed_back]).await;
    std::fs::remove_file(&folder).expect("removes");
    std::fs::create_dir(&folder).expect("makes");
    worker.work_off().await;
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    farm.stop().await;
}
