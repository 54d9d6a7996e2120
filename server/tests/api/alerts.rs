//! Alerts, and the farm's disk.

use std::time::Duration;

use proto::alert::{AlertList, AlertSeverity, AlertView};
use proto::farm::FarmView;
use proto::pool::WorkerView;
use proto::worker_protocol::{LeaseOutcome, LeaseReport};
use reqwest::StatusCode;

use super::harness::{Farm, leases, read, small_job};

/// Alerts without the ones about the machine that tests run on.
async fn alerts(farm: &Farm) -> Vec<AlertView> {
    let list: AlertList = read(farm.get("/v1/alerts").await, StatusCode::OK).await;
    list.alerts.into_iter().filter(|alert| !alert.code.starts_with("disk_")).collect()
}

async fn codes(farm: &Farm) -> Vec<String> {
    alerts(farm).await.into_iter().map(|alert| alert.code).collect()
}

#[tokio::test]
async fn an_alert_begins_when_it_is_noticed_and_ends_with_its_cause() {
    let farm = Farm::start().await;
    assert_eq!(codes(&farm).await, Vec::<String>::new());
    for begin_seconds in [0, 60] {
        let _: FarmView = read(farm.post("/v1/farm/pause", "").await, StatusCode::OK).await;
        let first = alerts(&farm).await;
        let wanted = AlertView {
            code: "farm_paused".to_owned(),
            severity: AlertSeverity::Warning,
            message: "the farm is paused".to_owned(),
            cure: "`sdfarm resume` continues it".to_owned(),
            since: format!("1970-01-01T00:{:02}:00.000Z", begin_seconds / 60),
        };
        assert_eq!(first, [wanted]);
        farm.hand.advance(Duration::from_mins(1));
        assert_eq!(alerts(&farm).await, first, "it lasts");
        let _: FarmView = read(farm.post("/v1/farm/resume", "").await, StatusCode::OK).await;
        assert_eq!(codes(&farm).await, Vec::<String>::new());
    }
    farm.stop().await;
}

#[tokio::test]
async fn jobs_without_a_worker_are_critical_unless_they_are_paused() {
    let farm = Farm::start().await;
    let posted = farm.submit(&small_job(1)).await;
    // Counts are cached for a second.
    let wait = async |wanted: &[&str]| {
        while codes(&farm).await != wanted {
            tokio::task::yield_now().await;
        }
    };
    super::harness::in_time(wait(&["no_worker"])).await;
    assert_eq!(alerts(&farm).await[0].severity, AlertSeverity::Critical);
    let _: FarmView = read(farm.post("/v1/farm/pause", "").await, StatusCode::OK).await;
    super::harness::in_time(wait(&["farm_paused"])).await;
    let _: FarmView = read(farm.post("/v1/farm/resume", "").await, StatusCode::OK).await;
    super::harness::in_time(wait(&["no_worker"])).await;
    let _: serde_json::Value =
        read(farm.post(&format!("/v1/jobs/{}/pause", posted.id), "").await, StatusCode::OK).await;
    super::harness::in_time(wait(&[])).await;
    farm.stop().await;
}

#[tokio::test]
async fn workers_on_which_tiles_fail_and_those_without_work_are_named() {
    let farm = Farm::start().await;
    let (bad, _good) = (farm.worker("bad").await, farm.worker("good").await);
    farm.submit_three_large().await;
    for errors in 1..=9 {
        let run = bad.claim().await.expect("work");
        let outcome = LeaseOutcome::Failed { message: "the device is hot".to_owned() };
        bad.report(vec![LeaseReport { lease: leases(&run)[0], outcome }]).await;
        if errors == 3 {
            let found = alerts(&farm).await;
            assert_eq!(found[0].code, "workers_failing");
            assert_eq!(found[0].message, "tiles fail on bad: the device is hot");
        }
    }
    let found = alerts(&farm).await;
    assert_eq!(found[0].code, "workers_quarantined", "{found:?}");
    assert!(found[0].message.ends_with(": bad") && found[0].cure.contains("sdfarm workers release"), "{found:?}");
    let _: WorkerView = read(farm.post(&format!("/v1/workers/{}/release", bad.id), "").await, StatusCode::OK).await;
    assert_eq!(codes(&farm).await, Vec::<String>::new());
    farm.stop().await;
}

#[tokio::test]
async fn local_workers_that_do_not_run_and_a_store_that_cannot_be_used_are_told() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let farm = Farm::start_in(folder, |config| config.workers = Some(2)).await;
    assert_eq!(codes(&farm).await, ["pool_short"]);
    let probe = farm.folder.path().join("probe");
    std::fs::remove_dir_all(&probe).expect("removes");
    std::fs::write(&probe, "").expect("a file in the place of the folder");
    let found = alerts(&farm).await;
    assert_eq!(
        (found[0].code.as_str(), found[0].severity),
        ("store_unreachable", AlertSeverity::Critical),
        "{found:?}"
    );
    std::fs::remove_file(&probe).expect("removes");
    assert_eq!(codes(&farm).await, ["pool_short"]);
    farm.stop().await;
}

#[tokio::test]
async fn the_farm_shows_its_disk_and_what_it_stores() {
    let farm = Farm::start().await;
    farm.submit(&small_job(1)).await;
    farm.worker("one").await.work_off().await;
    let view: FarmView = read(farm.get("/v1/farm").await, StatusCode::OK).await;
    assert!(view.disk.free_bytes > 0 && view.disk.free_bytes < view.disk.total_bytes, "{view:?}");
    let stored: u64 = std::fs::read_dir(farm.folder.path().join("pictures"))
        .expect("a folder")
        .map(|entry| entry.and_then(|entry| entry.metadata()).expect("a file").len())
        .sum();
    assert!(stored > 0);
    assert_eq!((view.disk.pictures_bytes, view.disk.blobs_bytes), (Some(stored), Some(0)));
    farm.stop().await;
}
