//! The pool: as many processes as requested, each on the device of its slot.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::Duration;

use proto::WorkerId;
use proto::job::JobState;
use proto::pool::{PoolView, WorkerList};
use proto::worker_protocol::{self, Batch, RegisterRequest, RegisterResponse, SyncResponse};
use reqwest::StatusCode;
use serde_json::json;

use super::harness::{Farm, Said, assert_state, in_time, leases, read, refused, small_job};

/// A program that records its arguments, and runs until its input ends, unless its device is `cuda:9`, which
/// cannot render.
fn stand_in(folder: &Path) -> std::path::PathBuf {
    let program = folder.join("stand-in");
    let text = "#!/bin/sh\nmkdir -p \"$(dirname \"$0\")/started\"\n\
                printf '%s %s' \"$SDFARM_WORKER_TOKEN\" \"$*\" > \"$(dirname \"$0\")/started/.$$\"\n\
                mv \"$(dirname \"$0\")/started/.$$\" \"$(dirname \"$0\")/started/$$\"\n\
                case \"$*\" in *'--device cuda:9 '*) echo 'no such card' >&2; exit 3;; esac\nexec cat\n";
    std::fs::write(&program, text).expect("writes");
    std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).expect("may be run");
    program
}

/// Waits until a condition is true.
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

/// Started processes, with their arguments.
fn started(folder: &Path) -> Vec<(u32, String)> {
    let Ok(entries) = std::fs::read_dir(folder.join("started")) else { return Vec::new() };
    entries
        .filter_map(|entry| {
            let path = entry.ok()?.path();
            Some((path.file_name()?.to_str()?.parse().ok()?, std::fs::read_to_string(path).ok()?))
        })
        .collect()
}

/// Started processes on a device, running or not.
fn on_device(folder: &Path, device: &str) -> Vec<(u32, String)> {
    let flag = format!("--device {device} ");
    started(folder).into_iter().filter(|(_, said)| said.contains(&flag)).collect()
}

/// Registers like a started process.
async fn register(farm: &Farm, process: u32, said: &str) -> RegisterResponse {
    let token = said.split(' ').next().expect("a token");
    let hello = RegisterRequest {
        name: "whatever".to_owned(),
        device: "cpu".to_owned(),
        picture_version: scene::PICTURE_VERSION,
        max_nodes: None,
        process,
    };
    let request = farm.client.post(farm.url(worker_protocol::REGISTER_PATH)).bearer_auth(token).json(&hello);
    read(in_time(request.send()).await.expect("a response"), StatusCode::OK).await
}

/// Claims a batch like a started process.
async fn claim(farm: &Farm, worker: WorkerId, said: &str) -> Option<Batch> {
    let token = said.split(' ').next().expect("a token");
    let request = json!({
        "worker": worker, "rays_per_second": null, "held_leases": [], "reports": [], "wants_work": true, "wait_ms": 0
    });
    let request = farm.client.post(farm.url(worker_protocol::SYNC_PATH)).bearer_auth(token).json(&request);
    let response: SyncResponse = read(in_time(request.send()).await.expect("a response"), StatusCode::OK).await;
    response.batch
}

fn kill(process: u32) {
    let killed = std::process::Command::new("kill").args(["-9", &process.to_string()]).status().expect("kill runs");
    assert!(killed.success());
}

async fn resize(farm: &Farm, workers: u32) -> PoolView {
    let put = farm.client.put(farm.url("/v1/pool")).json(&json!({ "workers": workers })).send();
    read(in_time(put).await.expect("a response"), StatusCode::OK).await
}

fn lives(process: u32) -> bool {
    Path::new(&format!("/proc/{process}")).exists()
}

#[tokio::test]
async fn the_pool_resizes_replaces_exited_workers_and_leaves_no_orphan() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let programs = tempfile::tempdir().expect("a temporary folder");
    let program = stand_in(programs.path());
    let farm = Farm::start_in(folder, |config| {
        config.workers = Some(1);
        config.worker_program = program;
        config.shutdown_grace = Duration::from_secs(3);
    })
    .await;
    let (process, said) = until(|| started(programs.path()).pop()).await;
    assert!(said.contains("worker --server http://127.0.0.1:") && said.contains("--pool"), "{said}");

    // The test sends the process's requests.
    let welcome = register(&farm, process, &said).await;
    let list: WorkerList = read(farm.get("/v1/workers").await, StatusCode::OK).await;
    assert_eq!(list.workers[0].name, "pool-1");
    let pool: PoolView = read(farm.get("/v1/pool").await, StatusCode::OK).await;
    assert_eq!(pool, PoolView { workers: 1, ready: 1 });

    // Its exit is noticed at once, although the clock does not advance.
    let posted = farm.submit(&small_job(1)).await;
    let mut child = farm.worker("helper").await;
    let helper = child.id;
    child.id = welcome.worker;
    // Without the pool's token, no client speaks for its worker.
    refused(child.try_sync(Said::default()).await, 403, "foreign_worker").await;
    child.id = helper;
    let held = leases(&claim(&farm, welcome.worker, &said).await.expect("work"));
    kill(process);
    let again = child.next().await;
    assert_eq!(again.job, posted.id);
    assert_ne!(leases(&again), held);
    child.report(child.results(&again).await).await;
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    child.id = welcome.worker;
    refused(child.try_sync(Said::default()).await, 404, "unknown_worker").await;

    // Another process took its slot; the pool grows and shrinks on request.
    assert_eq!(resize(&farm, 3).await.workers, 3);
    until(|| (started(programs.path()).len() == 4).then_some(())).await;
    let alive = || started(programs.path()).iter().filter(|(process, _)| lives(*process)).count();
    until(|| (alive() == 3).then_some(())).await;
    resize(&farm, 1).await;
    until(|| (alive() == 1).then_some(())).await;
    farm.stop().await;
    assert_eq!(alive(), 0);
}

#[tokio::test]
async fn a_replacement_worker_has_the_same_device() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let programs = tempfile::tempdir().expect("a temporary folder");
    let program = stand_in(programs.path());
    let farm = Farm::start_in(folder, |config| {
        config.workers = None;
        config.devices = vec!["cuda:0".to_owned(), "cuda:1".to_owned()];
        config.worker_program = program;
    })
    .await;
    let on = |device| on_device(programs.path(), device);
    until(|| (on("cuda:0").len() == 1 && on("cuda:1").len() == 1).then_some(())).await;
    kill(on("cuda:0")[0].0);
    until(|| (on("cuda:0").len() == 2).then_some(())).await;
    kill(on("cuda:1")[0].0);
    until(|| (on("cuda:1").len() == 2).then_some(())).await;
    // If there are more workers than devices, they share them in order; the last slots are drained first.
    assert_eq!(resize(&farm, 4).await.workers, 4);
    until(|| (on("cuda:0").len() == 3 && on("cuda:1").len() == 3).then_some(())).await;
    resize(&farm, 1).await;
    let alive = |device| on(device).iter().filter(|(process, _)| lives(*process)).count();
    until(|| (alive("cuda:0") == 1 && alive("cuda:1") == 0).then_some(())).await;
    farm.stop().await;
    assert_eq!(started(programs.path()).len(), 6);
}

#[tokio::test]
async fn a_failed_device_is_not_restarted_until_a_resize() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let programs = tempfile::tempdir().expect("a temporary folder");
    let program = stand_in(programs.path());
    let farm = Farm::start_in(folder, |config| {
        config.workers = None;
        config.devices = vec!["cuda:9".to_owned(), "cuda:0".to_owned()];
        config.worker_program = program;
    })
    .await;
    let on = |device| on_device(programs.path(), device);
    let (bad, _) = until(|| on("cuda:9").pop()).await;
    let (mut process, mut said) = until(|| on("cuda:0").pop()).await;
    until(|| (!lives(bad)).then_some(())).await;

    // The other slot is refilled repeatedly; each time, the failed slot could have been refilled too.
    for replacements in 1..=3 {
        let before = on("cuda:0");
        kill(process);
        (process, said) = until(|| on("cuda:0").into_iter().find(|found| !before.contains(found))).await;
        assert_eq!((on("cuda:0").len(), on("cuda:9").len()), (1 + replacements, 1));
    }
    register(&farm, process, &said).await;
    let pool: PoolView = read(farm.get("/v1/pool").await, StatusCode::OK).await;
    assert_eq!(pool, PoolView { workers: 2, ready: 1 });

    // A resize, even to the same number, starts the failed slot again.
    resize(&farm, 2).await;
    until(|| (on("cuda:9").len() == 2).then_some(())).await;
    assert!(lives(process));
    farm.stop().await;
}

#[tokio::test]
async fn a_missing_worker_program_does_not_stop_the_server() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let farm = Farm::start_in(folder, |config| config.workers = Some(2)).await;
    let pool: PoolView = read(farm.get("/v1/pool").await, StatusCode::OK).await;
    assert_eq!(pool, PoolView { workers: 2, ready: 0 });
    farm.stop().await;
}
