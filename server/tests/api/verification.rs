//! Verification: results of remote workers are rendered again by another worker, and the worker that was wrong is
//! quarantined, with all that it delivered since its last confirmed result.

use std::time::Duration;

use proto::JobId;
use proto::job::JobState;
use proto::pool::{WorkerList, WorkerState};
use proto::worker_protocol::{Batch, BatchWork, LeaseOutcome, LeaseReport};
use reqwest::StatusCode;

use super::fake_pictures::text_of;
use super::harness::{Farm, LEASE, Said, Worker, assert_state, in_time, job, leases, read, small_job};

/// A farm that verifies every result of a remote worker.
async fn verifying() -> Farm {
    Farm::start_in(tempfile::tempdir().expect("a temporary folder"), |config| config.verify_share = 1.0).await
}

async fn metric(farm: &Farm, name: &str) -> u64 {
    let metrics = in_time(farm.get("/metrics").await.text()).await.expect("text");
    let line = metrics.lines().find(|line| line.starts_with(&format!("{name} "))).expect("the metric");
    line.rsplit_once(' ').and_then(|(_, value)| value.parse().ok()).expect("a number")
}

async fn state_of(farm: &Farm, worker: &Worker<'_>) -> WorkerState {
    let list: WorkerList = read(farm.get("/v1/workers").await, StatusCode::OK).await;
    list.workers.iter().find(|view| view.id == worker.id).expect("listed").state
}

async fn text(farm: &Farm, id: JobId) -> String {
    text_of(&in_time(farm.get(&format!("/v1/jobs/{id}/image")).await.bytes()).await.expect("bytes"))
}

fn truth(id: JobId) -> String {
    format!("picture of frame 0 of {id}")
}

/// Has a worker render the next picture wrongly.
async fn lie(worker: &Worker<'_>) -> Batch {
    let run = worker.claim().await.expect("work");
    let results = worker.picture(&leases(&run), b"a lie").await;
    assert_eq!(worker.report(results).await.revoked_leases, []);
    run
}

#[tokio::test]
async fn a_result_that_another_worker_confirms_stays() {
    let farm = verifying().await;
    let (one, other) = (farm.worker("one").await, farm.worker("other").await);
    let id = farm.submit(&small_job(1)).await.id;
    assert_eq!(one.work_off().await, 1, "it does not verify its own result");
    assert_state(&farm, id, JobState::Succeeded).await;
    let run = other.claim().await.expect("the verification");
    assert_eq!((run.job, run.frame), (id, 0));
    assert!(other.sync(Said { holding: leases(&run), ..Said::default() }).await.revoked_leases.is_empty());
    other.report(other.results(&run).await).await;
    assert!(other.claim().await.is_none(), "it is verified once");
    assert_eq!(metric(&farm, "sdfarm_results_verified_total").await, 1);
    assert_eq!(metric(&farm, "sdfarm_results_refuted_total").await, 0);
    assert_eq!(text(&farm, id).await, truth(id));
    farm.stop().await;
}

#[tokio::test]
async fn who_lies_is_quarantined_and_all_its_unconfirmed_results_are_rendered_again() {
    let farm = verifying().await;
    let (liar, second, third) = (farm.worker("liar").await, farm.worker("second").await, farm.worker("third").await);
    let confirmed = farm.submit(&small_job(0)).await.id;
    assert!(liar.work_once().await && second.work_once().await, "rendered and verified");
    let mut wrong = Vec::new();
    for seed in 1..4 {
        wrong.push(farm.submit(&small_job(seed)).await.id);
        lie(&liar).await;
    }
    let twin = farm.submit(&small_job(1)).await.id;
    assert_state(&farm, twin, JobState::Succeeded).await;
    assert_eq!(text(&farm, twin).await, "a lie", "from the cache");
    assert!(second.work_once().await);
    assert_eq!(state_of(&farm, &liar).await, WorkerState::Ready, "one says this, the other that");
    let run = third.claim().await.expect("the deciding verification");
    assert_eq!(run.job, wrong[0]);
    let held = third.results(&run).await;
    third.report(held).await;
    assert_eq!(state_of(&farm, &liar).await, WorkerState::Quarantined);
    assert_eq!(state_of(&farm, &second).await, WorkerState::Ready);
    assert_state(&farm, confirmed, JobState::Succeeded).await;
    for id in wrong.iter().chain([&twin]) {
        assert_state(&farm, *id, JobState::Running).await;
    }
    assert!(liar.claim().await.is_none());
    while second.work_once().await || third.work_once().await {}
    for id in wrong {
        assert_state(&farm, id, JobState::Succeeded).await;
        assert_eq!(text(&farm, id).await, truth(id));
    }
    assert_ne!(text(&farm, twin).await, "a lie");
    let folder = farm.stop().await;
    let report = server::check_integrity(folder.path()).await.expect("checked");
    assert!(report.violations.is_empty(), "{:?}", report.violations);
}

#[tokio::test]
async fn a_verifier_that_lies_is_quarantined_instead() {
    let farm = verifying().await;
    let (honest, liar, third) = (farm.worker("honest").await, farm.worker("liar").await, farm.worker("third").await);
    let id = farm.submit(&small_job(1)).await.id;
    honest.work_once().await;
    lie(&liar).await;
    assert!(third.work_once().await);
    assert_eq!(state_of(&farm, &honest).await, WorkerState::Ready);
    assert_eq!(state_of(&farm, &liar).await, WorkerState::Quarantined);
    assert_state(&farm, id, JobState::Succeeded).await;
    assert_eq!(text(&farm, id).await, truth(id));
    farm.stop().await;
}

#[tokio::test]
async fn wrong_tiles_of_an_unfinished_frame_are_rendered_again() {
    let farm = verifying().await;
    let id = farm.submit(&job(1920, 1080, 4)).await.id;
    let (liar, second, third) = (farm.worker("liar").await, farm.worker("second").await, farm.worker("third").await);
    for _ in 0..2 {
        let lease = leases(&liar.claim().await.expect("work"))[0];
        liar.report(vec![liar.blob(lease, b"a lie").await]).await;
    }
    assert_eq!(farm.job(id).await.tiles.done, 2);
    for worker in [&second, &third] {
        let run = worker.claim().await.expect("a verification");
        let BatchWork::Render { tiles, whole_frame: false } = &run.work else { panic!("{run:?}") };
        assert_eq!(tiles.iter().map(|tile| tile.index).collect::<Vec<_>>(), [0, 1], "tiles are verified together");
        worker.report(worker.results(&run).await).await;
    }
    assert_eq!(state_of(&farm, &liar).await, WorkerState::Quarantined);
    assert_eq!(farm.job(id).await.tiles.done, 0);
    while second.work_once().await || third.work_once().await {}
    assert_state(&farm, id, JobState::Succeeded).await;
    assert_eq!(text(&farm, id).await, truth(id));
    let folder = farm.stop().await;
    let report = server::check_integrity(folder.path()).await.expect("checked");
    assert!(report.violations.is_empty(), "{:?}", report.violations);
}

#[tokio::test]
async fn a_lied_stitch_is_found_while_its_blobs_are_kept() {
    let farm = verifying().await;
    let id = farm.submit(&job(1920, 1080, 4)).await.id;
    let (liar, second, third) = (farm.worker("liar").await, farm.worker("second").await, farm.worker("third").await);
    let run = loop {
        let run = liar.claim().await.expect("work");
        if matches!(run.work, BatchWork::Stitch { .. }) {
            break run;
        }
        liar.report(liar.results(&run).await).await;
    };
    liar.report(liar.picture(&leases(&run), b"a lie").await).await;
    assert_eq!(text(&farm, id).await, "a lie");
    while second.work_once().await || third.work_once().await {}
    assert_eq!(state_of(&farm, &liar).await, WorkerState::Quarantined);
    assert_state(&farm, id, JobState::Succeeded).await;
    assert_eq!(text(&farm, id).await, truth(id));
    farm.stop().await;
}

#[tokio::test]
async fn results_of_a_single_worker_are_verified_once_another_joins() {
    let farm = verifying().await;
    let liar = farm.worker("only").await;
    let wrong = farm.submit(&small_job(1)).await.id;
    lie(&liar).await;
    let right = farm.submit(&small_job(2)).await.id;
    assert_eq!(liar.work_off().await, 1);
    // Long after the lease of the wrong result would have been forgotten.
    for _ in 0..300 {
        farm.hand.advance(LEASE / 2);
        assert!(liar.claim().await.is_none(), "it does not verify its own results");
    }
    assert_state(&farm, wrong, JobState::Succeeded).await;
    let (second, third) = (farm.worker("second").await, farm.worker("third").await);
    let new = farm.submit(&small_job(3)).await.id;
    assert_eq!(second.claim().await.expect("work").job, new, "new work precedes old verifications");
    let run = third.claim().await.expect("a verification");
    assert_eq!(run.job, wrong);
    third.report(third.results(&run).await).await;
    let fourth = farm.worker("fourth").await;
    while third.work_once().await || fourth.work_once().await {}
    assert_eq!(state_of(&farm, &liar).await, WorkerState::Quarantined);
    for id in [wrong, right] {
        assert_state(&farm, id, JobState::Succeeded).await;
        assert_eq!(text(&farm, id).await, truth(id));
    }
    farm.stop().await;
}

#[tokio::test]
async fn an_old_stitch_is_verified_by_rendering_its_frame() {
    let farm = verifying().await;
    let id = farm.submit(&job(1920, 1080, 4)).await.id;
    let liar = farm.worker("liar").await;
    let run = loop {
        let run = liar.claim().await.expect("work");
        if matches!(run.work, BatchWork::Stitch { .. }) {
            break run;
        }
        liar.report(liar.results(&run).await).await;
    };
    liar.report(liar.picture(&leases(&run), b"a lie").await).await;
    for _ in 0..60 {
        farm.hand.advance(LEASE / 2);
        liar.sync(Said::default()).await;
    }
    // The server looks for old verifications every second.
    let others = [farm.worker("second").await, farm.worker("third").await];
    in_time(async {
        while state_of(&farm, &liar).await != WorkerState::Quarantined {
            for other in &others {
                other.work_once().await;
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    })
    .await;
    while others[0].work_once().await || others[1].work_once().await {}
    assert_eq!(text(&farm, id).await, truth(id));
    farm.stop().await;
}

#[tokio::test]
async fn a_verifier_that_fails_is_not_asked_again() {
    let farm = verifying().await;
    let (one, failing) = (farm.worker("one").await, farm.worker("failing").await);
    farm.submit(&small_job(1)).await;
    one.work_once().await;
    let run = failing.claim().await.expect("the verification");
    let outcome = LeaseOutcome::Failed { message: "out of luck".to_owned() };
    failing
        .report(leases(&run).into_iter().map(|lease| LeaseReport { lease, outcome: outcome.clone() }).collect())
        .await;
    assert!(failing.claim().await.is_none() && one.claim().await.is_none());
    assert_eq!(metric(&farm, "sdfarm_results_unverified_total").await, 0);
    assert!(farm.worker("late").await.work_once().await);
    assert_eq!(metric(&farm, "sdfarm_results_verified_total").await, 1);
    farm.stop().await;
}

#[tokio::test]
async fn every_result_of_a_new_worker_is_verified_for_a_while() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let farm = Farm::start_in(folder, |config| config.verify_new = Duration::from_mins(3)).await;
    let (new, other) = (farm.worker("new").await, farm.worker("other").await);
    farm.submit(&small_job(1)).await;
    new.work_once().await;
    assert!(other.work_once().await, "a verification");
    for _ in 0..12 {
        farm.hand.advance(LEASE / 2);
        for worker in [&new, &other] {
            worker.sync(Said::default()).await;
        }
    }
    farm.submit(&small_job(2)).await;
    new.work_once().await;
    assert!(other.claim().await.is_none());
    farm.stop().await;
}

#[tokio::test]
async fn a_verification_whose_worker_vanishes_goes_to_another() {
    let farm = verifying().await;
    let (one, gone, other) = (farm.worker("one").await, farm.worker("gone").await, farm.worker("other").await);
    farm.submit(&small_job(1)).await;
    one.work_once().await;
    gone.claim().await.expect("the verification");
    assert!(other.claim().await.is_none());
    for _ in 0..3 {
        farm.hand.advance(LEASE / 2);
        other.sync(Said::default()).await;
    }
    let run = other.next().await;
    other.report(other.results(&run).await).await;
    assert_eq!(metric(&farm, "sdfarm_results_verified_total").await, 1);
    farm.stop().await;
}
