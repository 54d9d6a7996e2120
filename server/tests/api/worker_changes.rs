//! Changes of single workers by an administrator, and what users see of a worker.

use std::time::Duration;

use proto::WorkerId;
use proto::job::JobState;
use proto::pool::{WorkerHold, WorkerList, WorkerState, WorkerView};
use proto::worker_protocol::{LeaseOutcome, LeaseReport};
use reqwest::StatusCode;

use super::harness::{Farm, Said, assert_state, job, leases, read, refused, small_job};

async fn change(farm: &Farm, worker: WorkerId, verb: &str) -> WorkerView {
    read(farm.post(&format!("/v1/workers/{worker}/{verb}"), "").await, StatusCode::OK).await
}

async fn view(farm: &Farm, worker: WorkerId) -> WorkerView {
    let list: WorkerList = read(farm.get("/v1/workers").await, StatusCode::OK).await;
    list.workers.into_iter().find(|view| view.id == worker).expect("listed")
}

#[tokio::test]
async fn a_drained_worker_finishes_what_it_holds_and_must_exit() {
    let farm = Farm::start().await;
    let posted = farm.submit(&job(3072, 1024, 2)).await;
    let (drained, other) = (farm.worker("drained").await, farm.worker("other").await);
    let run = drained.claim().await.expect("work");
    let view = change(&farm, drained.id, "drain").await;
    assert!(view.draining && !view.quarantined && view.state == WorkerState::Draining, "{view:?}");
    let received = drained.sync(Said { holding: leases(&run), wants_work: true, ..Said::default() }).await;
    assert!(received.drain && received.batch.is_none() && received.revoked_leases.is_empty(), "{received:?}");
    assert_eq!(drained.report(drained.results(&run).await).await.revoked_leases, []);
    assert!(change(&farm, drained.id, "drain").await.draining, "a second request changes nothing");
    for verb in ["quarantine", "release"] {
        let path = format!("/v1/workers/{}/{verb}", drained.id);
        refused(farm.post(&path, "").await, 409, "worker_draining").await;
    }
    other.work_off().await;
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    farm.stop().await;
}

#[tokio::test]
async fn a_waiting_worker_learns_at_once_that_it_must_exit() {
    let farm = Farm::start().await;
    let worker = farm.worker("one").await;
    let waiting = worker.sync(Said { wants_work: true, wait: Duration::from_secs(20), ..Said::default() });
    let (received, _) = tokio::join!(waiting, change(&farm, worker.id, "drain"));
    assert!(received.drain);
    farm.stop().await;
}

#[tokio::test]
async fn a_quarantined_worker_gets_no_work_until_it_is_released() {
    let farm = Farm::start().await;
    let posted = farm.submit(&job(3072, 1024, 2)).await;
    let worker = farm.worker("only").await;
    let run = worker.claim().await.expect("work");
    let view = change(&farm, worker.id, "quarantine").await;
    assert!(view.quarantined && !view.draining && view.leases == leases(&run).len() as u64, "{view:?}");
    assert_eq!(worker.report(worker.results(&run).await).await.revoked_leases, [], "what it held counts");
    assert!(worker.claim().await.is_none());
    let waiting = worker.next();
    let (again, view) = tokio::join!(waiting, change(&farm, worker.id, "release"));
    assert!(!view.quarantined && view.state == WorkerState::Ready, "{view:?}");
    worker.report(worker.results(&again).await).await;
    worker.work_off().await;
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    assert_eq!(change(&farm, worker.id, "release").await.state, WorkerState::Ready);
    refused(farm.post(&format!("/v1/workers/{}/drain", WorkerId::new()), "").await, 404, "unknown_worker").await;
    refused(farm.post("/v1/workers/1/drain", "").await, 404, "unknown_worker").await;
    farm.stop().await;
}

#[tokio::test]
async fn a_released_worker_is_not_excluded_for_its_old_errors() {
    let farm = Farm::start().await;
    let (bad, _good) = (farm.worker("bad").await, farm.worker("good").await);
    farm.submit_three_large().await;
    for _ in 0..9 {
        let run = bad.claim().await.expect("work");
        let outcome = LeaseOutcome::Failed { message: "the device is hot".to_owned() };
        bad.report(vec![LeaseReport { lease: leases(&run)[0], outcome }]).await;
    }
    let seen = view(&farm, bad.id).await;
    assert!(seen.quarantined, "{seen:?}");
    assert_eq!((seen.errors, seen.last_error.as_deref()), (9, Some("the device is hot")));
    assert!(bad.claim().await.is_none());
    change(&farm, bad.id, "release").await;
    assert!(bad.claim().await.is_some());
    farm.stop().await;
}

#[tokio::test]
async fn a_worker_shows_what_it_holds_and_when_it_was_seen() {
    let farm = Farm::start().await;
    let mut small = small_job(1);
    small["name"] = "held".into();
    let posted = farm.submit(&small).await;
    let worker = farm.worker("one").await;
    let idle = view(&farm, worker.id).await;
    assert!(!idle.pool && idle.holds.is_empty() && idle.errors == 0 && idle.last_error.is_none(), "{idle:?}");
    let run = worker.claim().await.expect("work");
    farm.hand.advance(Duration::from_millis(250));
    let seen = view(&farm, worker.id).await;
    let tiles = leases(&run).len() as u64;
    assert_eq!(seen.holds, [WorkerHold { job: posted.id, name: "held".to_owned(), frame: 0, tiles }]);
    assert_eq!((seen.leases, &*seen.last_seen_at), (tiles, "1970-01-01T00:00:00.000Z"));
    let year: i32 = seen.registered_at[..4].parse().expect("a year");
    assert!(year > 2025, "{}", seen.registered_at);
    worker.report(worker.results(&run).await).await;
    let seen = view(&farm, worker.id).await;
    assert_eq!((seen.leases, &*seen.last_seen_at), (0, "1970-01-01T00:00:00.250Z"));
    farm.stop().await;
}
