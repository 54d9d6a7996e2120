//! Startup: errors that prevent it, state that survives a restart, and health.

use std::net::TcpListener;
use std::path::Path;

use proto::job::JobState;
use proto::worker_protocol;
use reqwest::StatusCode;
use serde_json::{Value, json};
use server::{Server, StartError};

use super::harness::{Farm, assert_state, config, in_time, leases, read, refused, small_job};

/// Changes a configuration to a database in the data folder, for tests of that file.
fn in_folder(config: &mut server::Config) {
    config.database = None;
}

async fn start_error(data: &Path, change: impl FnOnce(&mut server::Config)) -> StartError {
    let mut config = config(data);
    change(&mut config);
    Server::start(config).await.expect_err("the server must not start")
}

#[tokio::test]
async fn a_restart_keeps_jobs_pictures_and_leases_of_remote_workers() {
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
    assert_eq!(worker.report(worker.results(&run).await).await.revoked_leases, []);
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
async fn a_removed_lock_file_lets_no_second_server_in() {
    let farm = Farm::start().await;
    std::fs::remove_file(farm.folder.path().join("lock")).expect("removes");
    for _ in 0..2 {
        let error = start_error(farm.folder.path(), |_| {}).await;
        assert!(matches!(error, StartError::InUse { .. }), "{error:?}");
    }
    let folder = farm.stop().await;
    Farm::start_in(folder, |_| {}).await.stop().await;
}

#[tokio::test]
async fn only_the_servers_user_may_read_its_data() {
    use std::os::unix::fs::PermissionsExt;

    let mode = |path: &Path| std::fs::metadata(path).expect("it is there").permissions().mode() & 0o777;
    let loosen = |path: &Path| {
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode(path) | 0o055))
            .expect("its mode is changed");
    };
    let farm = Farm::start_in(tempfile::tempdir().expect("a temporary folder"), in_folder).await;
    farm.submit(&small_job(1)).await;
    let files = ["farm.sqlite", "farm.sqlite-wal", "farm.sqlite-shm", "links.secret", "webhook-secret", "lock"];
    let data = farm.folder.path().to_owned();
    let exposed = || -> Vec<_> { files.into_iter().filter(|file| mode(&data.join(file)) != 0o600).collect() };
    assert_eq!((exposed(), mode(&data)), (Vec::new(), 0o700));
    let folder = farm.stop().await;
    // A folder of an earlier release is mended.
    for path in [data.clone(), data.join("farm.sqlite"), data.join("links.secret"), data.join("pictures")] {
        loosen(&path);
    }
    let farm = Farm::start_in(folder, in_folder).await;
    farm.submit(&small_job(2)).await;
    assert_eq!((exposed(), mode(&data), mode(&data.join("pictures"))), (Vec::new(), 0o700, 0o700));
    farm.stop().await;
}

#[tokio::test]
async fn startup_errors_have_a_fix() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let busy = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = busy.local_addr().expect("an address");
    let error = start_error(folder.path(), |config| config.listen = address).await.to_string();
    assert!(error.contains(&address.to_string()) && error.contains("--listen"), "{error}");
    let error = start_error(folder.path(), |config| config.listen = ([0, 0, 0, 0], 0).into()).await.to_string();
    assert!(error.contains("--insecure"), "{error}");

    let folder = tempfile::tempdir().expect("a temporary folder");
    for garbage in [vec![0x5a; 9000], b"short".to_vec()] {
        let file = folder.path().join("farm.sqlite");
        std::fs::write(&file, garbage).expect("writes");
        let error = start_error(folder.path(), in_folder).await.to_string();
        assert!(error.contains("farm.sqlite") && error.contains("backup"), "{error}");
        std::fs::remove_file(&file).expect("removes");
    }
}

#[tokio::test]
async fn an_overwritten_database_page_is_detected_at_startup() {
    let farm = Farm::start_in(tempfile::tempdir().expect("a temporary folder"), in_folder).await;
    for seed in 0..20 {
        farm.submit(&small_job(seed)).await;
    }
    let folder = farm.stop().await;
    let file = folder.path().join("farm.sqlite");
    let mut bytes = std::fs::read(&file).expect("reads");
    let middle = bytes.len() / 2;
    bytes[4096..middle].fill(0xa5);
    std::fs::write(&file, bytes).expect("writes");
    let error = start_error(folder.path(), in_folder).await.to_string();
    assert!(error.contains("farm.sqlite") && error.contains("backup"), "{error}");
}

#[tokio::test]
async fn an_unusable_data_folder_is_named_with_a_fix() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("file");
    std::fs::write(&file, "not a folder").expect("writes");
    let error = start_error(&file.join("data"), |_| {}).await;
    assert!(matches!(error, StartError::DataFolder { .. }), "{error:?}");
    assert!(error.to_string().contains("--data"), "{error}");
}

#[tokio::test]
async fn health_reports_workers_and_metrics_have_counts() {
    let farm = Farm::start().await;
    assert_eq!(farm.get("/livez").await.status(), StatusCode::OK);
    let ready: Value = read(farm.get("/readyz").await, StatusCode::OK).await;
    assert_eq!(
        ready,
        json!({"status": "degraded", "database": "ok", "store": "ok", "store_kind": "folder", "workers": []})
    );
    farm.submit(&small_job(1)).await;
    let worker = farm.worker("one").await;
    worker.claim().await.expect("work");
    let ready: Value = read(farm.get("/readyz").await, StatusCode::OK).await;
    assert_eq!((&ready["status"], &ready["workers"]), (&json!("ready"), &json!(["one"])));
    let text = in_time(farm.get("/metrics").await.text()).await.expect("text");
    for line in [
        "sdfarm_jobs{state=\"running\"} 1.0",
        "sdfarm_tiles{state=\"leased\"} 1.0",
        "sdfarm_workers{state=\"ready\"} 1.0",
        "sdfarm_leases_expired_total 0",
    ] {
        assert!(text.lines().any(|found| found == line), "{line} in {text}");
    }
    farm.stop().await;
}

#[tokio::test]
async fn a_failing_store_causes_a_retry_and_no_partial_picture() {
    let farm = Farm::start().await;
    let posted = farm.submit(&small_job(1)).await;
    let worker = farm.worker("one").await;
    let run = worker.claim().await.expect("work");
    let folder = farm.folder.path().join("pictures");
    std::fs::remove_dir(&folder).expect("is empty");
    std::fs::write(&folder, "in the way").expect("writes");
    let hash = blake3::hash(b"a picture").to_hex().to_string();
    let put = worker.put(&worker_protocol::picture_path(&hash), b"a picture".to_vec()).await;
    refused(put, 500, "internal").await;
    let handed_back =
        worker_protocol::LeaseReport { lease: leases(&run)[0], outcome: worker_protocol::LeaseOutcome::Released };
    worker.report(vec![handed_back]).await;
    std::fs::remove_file(&folder).expect("removes");
    std::fs::create_dir(&folder).expect("makes");
    worker.work_off().await;
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    farm.stop().await;
}
