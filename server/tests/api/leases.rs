//! Leases: results that count, results that do not, and tiles whose worker failed.

use std::time::Duration;

use proto::job::JobState;
use proto::pool::WorkerList;
use proto::worker_protocol::{BatchWork, LeaseOutcome, LeaseReport, SyncResponse};
use reqwest::StatusCode;

use super::fake_pictures::text_of;
use super::harness::{Farm, LEASE, Said, assert_state, in_time, job, leases, read, refused, small_job};

fn failed(lease: proto::LeaseId, message: &str) -> LeaseReport {
    LeaseReport { lease, outcome: LeaseOutcome::Failed { message: message.to_owned() } }
}

#[tokio::test]
async fn a_result_under_an_expired_lease_has_no_effect() {
    let farm = Farm::start().await;
    let posted = farm.submit(&small_job(1)).await;
    let slow = farm.worker("slow").await;
    let held = leases(&slow.claim().await.expect("work"));
    farm.hand.advance(LEASE);
    let quick = farm.worker("quick").await;
    let again = quick.claim().await.expect("the tile is ready again");
    let late = slow.picture(&held, b"late").await;
    refused(slow.try_sync(Said { results: late, ..Said::default() }).await, 404, "unknown_worker").await;
    assert_state(&farm, posted.id, JobState::Running).await;
    quick.report(quick.results(&again).await).await;
    let image = farm.get(&format!("/v1/jobs/{}/image", posted.id)).await;
    let image = in_time(image.bytes()).await.expect("bytes");
    assert_eq!(text_of(&image), format!("picture of frame 0 of {}", posted.id));
    farm.stop().await;
}

#[tokio::test]
async fn a_renewed_lease_does_not_expire() {
    let farm = Farm::start().await;
    let posted = farm.submit(&small_job(1)).await;
    let worker = farm.worker("steady").await;
    let run = worker.claim().await.expect("work");
    for _ in 0..4 {
        farm.hand.advance(LEASE / 2);
        assert_eq!(worker.sync(Said { holding: leases(&run), ..Said::default() }).await.revoked_leases, []);
    }
    assert_eq!(worker.report(worker.results(&run).await).await.revoked_leases, []);
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    farm.stop().await;
}

#[tokio::test]
async fn a_lease_its_worker_never_received_is_released() {
    let farm = Farm::start().await;
    farm.submit(&small_job(1)).await;
    let worker = farm.worker("deaf").await;
    let unheard = leases(&worker.claim().await.expect("work"));
    assert!(worker.claim().await.is_none(), "the response may still arrive");
    farm.hand.advance(Duration::from_secs(3));
    let heard = leases(&worker.claim().await.expect("the tile again"));
    assert_ne!(heard, unheard);
    farm.stop().await;
}

#[tokio::test]
async fn a_result_delivered_twice_counts_once() {
    let farm = Farm::start().await;
    let posted = farm.submit(&job(1920, 1080, 4)).await;
    let worker = farm.worker("twice").await;
    let run = worker.claim().await.expect("work");
    let results = worker.results(&run).await;
    assert_eq!(worker.report(results.clone()).await.revoked_leases, []);
    let done = farm.job(posted.id).await;
    assert_eq!(worker.report(results.clone()).await.revoked_leases, leases(&run));
    let other = worker.blob(leases(&run)[0], b"another result").await;
    assert_eq!(worker.report(vec![other]).await.revoked_leases, [leases(&run)[0]]);
    assert_eq!(farm.job(posted.id).await.tiles, done.tiles);
    let metrics = in_time(farm.get("/metrics").await.text()).await.expect("text");
    assert!(metrics.contains("sdfarm_results_fenced_total 2"), "{metrics}");
    farm.stop().await;
}

#[tokio::test]
async fn three_errors_kill_a_tile_and_fail_its_job() {
    let farm = Farm::start().await;
    let posted = farm.submit(&job(1920, 1080, 4)).await;
    let worker = farm.worker("one").await;
    let other = worker.claim().await.expect("work");
    for _ in 0..3 {
        farm.hand.advance(Duration::from_secs(6));
        let said = Said { wants_work: true, holding: leases(&other), ..Said::default() };
        let run = worker.sync(said).await.batch.expect("work");
        assert!(matches!(&run.work, BatchWork::Render { tiles, .. } if tiles[0].index == 1), "{run:?}");
        let held = leases(&run);
        let results = vec![failed(held[0], "the scene has no inside")];
        let said = Said { results, holding: leases(&other), ..Said::default() };
        worker.sync(said).await;
    }
    let failed = farm.job(posted.id).await;
    assert_eq!(failed.state, JobState::Failed);
    assert_eq!(failed.errors, ["frame 0 could not be rendered: the scene has no inside"]);
    let reply = worker.sync(Said { holding: leases(&other), ..Said::default() }).await;
    assert_eq!(reply.revoked_leases, leases(&other), "the job's other tiles are void");
    assert!(worker.claim().await.is_none());
    farm.stop().await;
}

#[tokio::test]
async fn a_failed_tile_is_offered_to_another_worker_first() {
    let farm = Farm::start().await;
    farm.submit(&small_job(1)).await;
    let (bad, good) = (farm.worker("bad").await, farm.worker("good").await);
    let held = leases(&bad.claim().await.expect("work"));
    bad.report(vec![failed(held[0], "no")]).await;
    farm.hand.advance(Duration::from_secs(6));
    assert!(bad.claim().await.is_none());
    assert!(good.claim().await.is_some());
    farm.stop().await;
}

#[tokio::test]
async fn releasing_a_tile_repeatedly_has_no_penalty() {
    let farm = Farm::start().await;
    let posted = farm.submit(&small_job(1)).await;
    let worker = farm.worker("unsteady").await;
    for _ in 0..60 {
        let held = leases(&worker.claim().await.expect("the tile is ready at once"));
        worker.report(vec![LeaseReport { lease: held[0], outcome: LeaseOutcome::Released }]).await;
    }
    worker.work_off().await;
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    farm.stop().await;
}

#[tokio::test]
async fn a_tile_is_dead_after_fifty_lost_workers() {
    let farm = Farm::start().await;
    let posted = farm.submit(&small_job(1)).await;
    for number in 0..50 {
        let worker = farm.worker(&format!("mayfly-{number}")).await;
        if worker.claim().await.is_none() {
            farm.hand.advance(Duration::from_secs(6));
            assert!(worker.claim().await.is_some(), "after {number} and the back-off");
        }
        farm.hand.advance(LEASE);
    }
    let last = farm.worker("last").await;
    assert!(last.claim().await.is_none());
    let failed = farm.job(posted.id).await;
    assert_eq!(failed.state, JobState::Failed);
    assert_eq!(failed.errors, ["frame 0 could not be rendered: its workers vanished repeatedly"]);
    farm.stop().await;
}

#[tokio::test]
async fn tiles_of_damaged_blobs_are_rendered_again_without_losing_progress() {
    let farm = Farm::start().await;
    let posted = farm.submit(&job(1920, 1080, 4)).await;
    let worker = farm.worker("one").await;
    let stitch = loop {
        let run = worker.claim().await.expect("work");
        if matches!(run.work, BatchWork::Stitch { .. }) {
            break run;
        }
        worker.report(worker.results(&run).await).await;
    };
    let BatchWork::Stitch { inputs, .. } = &stitch.work else { panic!("{stitch:?}") };
    std::fs::remove_file(farm.folder.path().join("tiles").join(&inputs[1].hash)).expect("a blob");
    std::fs::write(farm.folder.path().join("tiles").join(&inputs[3].hash), b"damaged").expect("a blob");
    let bad = LeaseReport { lease: leases(&stitch)[0], outcome: LeaseOutcome::BadBlobs { tiles: vec![0, 1, 3] } };
    worker.report(vec![bad]).await;
    let reopened = farm.job(posted.id).await;
    assert_eq!(reopened.tiles.done, reopened.tiles.total - 2);
    assert_eq!(reopened.progress, 1.0);
    let mut again = Vec::new();
    while let Some(run) = worker.claim().await {
        match &run.work {
            BatchWork::Render { tiles, whole_frame } => {
                assert!(!whole_frame);
                again.extend(tiles.iter().map(|tile| tile.index));
            }
            BatchWork::Stitch { inputs, .. } => assert_eq!(inputs.len() as u64, posted.tiles.total),
        }
        worker.report(worker.results(&run).await).await;
    }
    assert_eq!(again, [1, 3]);
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    farm.stop().await;
}

#[tokio::test]
async fn blobs_that_are_intact_are_not_rendered_again() {
    let farm = Farm::start().await;
    let posted = farm.submit(&job(1920, 1080, 4)).await;
    let liar = farm.worker("liar").await;
    for _ in 0..3 {
        let stitch = loop {
            let run = liar.claim().await.expect("work");
            if matches!(run.work, BatchWork::Stitch { .. }) {
                break run;
            }
            liar.report(liar.results(&run).await).await;
        };
        let outcome = LeaseOutcome::BadBlobs { tiles: vec![0, 1] };
        liar.report(vec![LeaseReport { lease: leases(&stitch)[0], outcome }]).await;
        assert_eq!(farm.job(posted.id).await.tiles.done, posted.tiles.total);
    }
    assert!(liar.claim().await.is_none(), "it is quarantined");
    assert_eq!(farm.worker("honest").await.work_off().await, 1, "the stitch");
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    farm.stop().await;
}

#[tokio::test]
async fn a_result_without_its_bytes_is_dropped() {
    let farm = Farm::start().await;
    let posted = farm.submit(&small_job(1)).await;
    let worker = farm.worker("hollow").await;
    let run = worker.claim().await.expect("work");
    let hash = blake3::hash(b"never put").to_hex().to_string();
    let outcome = LeaseOutcome::Picture { hash, size_bytes: 9 };
    worker.report(vec![LeaseReport { lease: leases(&run)[0], outcome }]).await;
    assert_state(&farm, posted.id, JobState::Running).await;
    assert_eq!(worker.work_off().await, 1);
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    farm.stop().await;
}

#[tokio::test]
async fn idle_workers_share_a_large_frame() {
    let farm = Farm::start().await;
    let posted = farm.submit(&job(1920, 1080, 4)).await;
    let (mut one, mut two) = (farm.worker("one").await, farm.worker("two").await);
    one.rays_per_second = Some(2e7);
    two.rays_per_second = Some(3e7);
    let first = one.claim().await.expect("work");
    let second = two.claim().await.expect("work");
    // The frame may be heavier than it seems, so each gets less than its part of what is left.
    let (of_one, of_two) = (leases(&first).len() as u64, leases(&second).len() as u64);
    assert!(of_one >= 1 && of_one <= posted.tiles.total / 2, "{of_one} of {}", posted.tiles.total);
    assert!(of_two >= 1 && of_two <= (posted.tiles.total - of_one) / 2, "{of_two} of {}", posted.tiles.total);
    one.report(one.results(&first).await).await;
    two.report(two.results(&second).await).await;
    one.work_off().await;
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    farm.stop().await;
}

#[tokio::test]
async fn a_frame_that_renders_quickly_is_not_split() {
    let farm = Farm::start().await;
    let posted = farm.submit(&job(1920, 1080, 4)).await;
    let (mut one, mut two) = (farm.worker("one").await, farm.worker("two").await);
    one.rays_per_second = Some(4e9);
    two.rays_per_second = Some(4e9);
    let run = one.claim().await.expect("work");
    assert!(matches!(&run.work, BatchWork::Render { whole_frame: true, .. }), "{run:?}");
    assert_eq!(leases(&run).len() as u64, posted.tiles.total);
    assert!(two.claim().await.is_none(), "no tile is left");
    farm.stop().await;
}

#[tokio::test]
async fn a_single_fast_worker_gets_the_complete_frame() {
    let farm = Farm::start().await;
    let posted = farm.submit(&job(1920, 1080, 4)).await;
    let mut worker = farm.worker("fast").await;
    worker.rays_per_second = Some(1e9);
    let run = worker.claim().await.expect("work");
    assert!(matches!(&run.work, BatchWork::Render { whole_frame: true, .. }), "{run:?}");
    worker.report(worker.results(&run).await).await;
    let done = farm.job(posted.id).await;
    assert_eq!(done.state, JobState::Succeeded);
    assert_eq!(done.tiles.done, done.tiles.total);
    farm.stop().await;
}

#[tokio::test]
async fn a_picture_needs_leases_for_all_tiles_of_its_frame() {
    let farm = Farm::start().await;
    let posted = farm.submit(&job(1920, 1080, 4)).await;
    let mut worker = farm.worker("fast").await;
    worker.rays_per_second = Some(1e9);
    let held = leases(&worker.claim().await.expect("work"));
    let mut results = worker.picture(&held[1..], b"half a picture").await;
    results.push(LeaseReport { lease: held[0], outcome: LeaseOutcome::Released });
    worker.report(results).await;
    let open = farm.job(posted.id).await;
    assert_eq!((open.state, open.tiles.done), (JobState::Running, 0));
    worker.work_off().await;
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    farm.stop().await;
}

#[tokio::test]
async fn a_waiting_worker_receives_new_work_at_once() {
    let farm = Farm::start().await;
    let worker = farm.worker("waiting").await;
    let submitted = async {
        // The worker's call is arriving or waiting already; in both cases it must not wait until its timeout.
        farm.submit(&small_job(1)).await
    };
    let (run, posted) = tokio::join!(worker.next(), submitted);
    assert_eq!(run.job, posted.id);
    farm.stop().await;
}

#[tokio::test]
async fn workers_are_listed_with_their_leases() {
    let farm = Farm::start().await;
    farm.submit(&small_job(1)).await;
    let mut worker = farm.worker("lister").await;
    worker.rays_per_second = Some(5e6);
    worker.claim().await.expect("work");
    let list: WorkerList = read(farm.get("/v1/workers").await, StatusCode::OK).await;
    let [listed] = list.workers.as_slice() else { panic!("{list:?}") };
    assert_eq!((listed.id, listed.name.as_str(), listed.device.as_str()), (worker.id, "lister", "cpu"));
    assert_eq!((listed.leases, listed.rays_per_second), (1, Some(5e6)));
    let held: SyncResponse = worker.sync(Said::default()).await;
    assert!(!held.drain);
    farm.stop().await;
}

#[tokio::test]
async fn a_worker_that_delivered_receives_the_next_job_at_once() {
    let farm = Farm::start().await;
    let worker = farm.worker("steady").await;
    for seed in 0..3 {
        let waiting = worker.next();
        let submitted = async {
            // By this time the worker's call waits at the server.
            for _ in 0..20 {
                assert_eq!(farm.get("/v1/workers").await.status(), StatusCode::OK);
            }
            farm.submit(&small_job(seed)).await
        };
        let (run, posted) = tokio::join!(waiting, submitted);
        assert_eq!(run.job, posted.id);
        let results = worker.results(&run).await;
        let said = Said { results, wants_work: true, ..Said::default() };
        assert!(worker.sync(said).await.batch.is_none());
    }
    farm.stop().await;
}

/// Every number of a sync, with a value that is allowed and values that are not, and where it is.
fn hostile_numbers() -> Vec<(serde_json::Value, String, bool)> {
    let lease = proto::LeaseId::new();
    let blob =
        serde_json::json!([{ "lease": lease, "outcome": { "blob": { "hash": "0".repeat(64), "size_bytes": 1 } } }]);
    let picture =
        serde_json::json!([{ "lease": lease, "outcome": { "picture": { "hash": "0".repeat(64), "size_bytes": 1 } } }]);
    let bad = serde_json::json!([{ "lease": lease, "outcome": { "bad_blobs": { "tiles": [1] } } }]);
    let metrics = serde_json::json!({ "timings": [{ "phase": "render", "took_ms": 1.0, "rays": 1 }],
                                      "memory": { "used_bytes": 1, "total_bytes": 1 } });
    let sync = |reports: serde_json::Value| {
        serde_json::json!({ "rays_per_second": 1.0, "held_leases": [], "reports": reports, "wants_work": true,
                            "wait_ms": 0, "metrics": metrics })
    };
    let mut cases = Vec::new();
    for body in [sync(blob), sync(picture), sync(bad)] {
        let mut places = Vec::new();
        numbers_in(&body, String::new(), &mut places);
        for place in places {
            // Clamped, as the protocol says.
            let is_clamped = ["/rays_per_second", "/wait_ms", "/took_ms"].iter().any(|name| place.ends_with(name));
            for number in [
                "1e-300",
                "0.5",
                "-1",
                "-9223372036854775809",
                "9007199254740993",
                "9223372036854775807",
                "18446744073709551615",
                "18446744073709551616",
                "1e300",
                "1e400",
            ] {
                let mut hostile = body.clone();
                let value: serde_json::Value = serde_json::from_str(number).unwrap_or_else(|_| "1e400".into());
                *hostile.pointer_mut(&place).expect("a number") = value;
                cases.push((hostile, place.clone(), is_clamped));
            }
        }
    }
    cases
}

fn numbers_in(value: &serde_json::Value, place: String, places: &mut Vec<String>) {
    match value {
        serde_json::Value::Number(_) => places.push(place),
        serde_json::Value::Array(items) => {
            items.iter().enumerate().for_each(|(index, item)| numbers_in(item, format!("{place}/{index}"), places));
        }
        serde_json::Value::Object(members) => {
            members.iter().for_each(|(name, member)| numbers_in(member, format!("{place}/{name}"), places));
        }
        _ => {}
    }
}

#[tokio::test]
async fn no_number_of_a_worker_stops_the_farm() {
    let farm = Farm::start().await;
    farm.submit(&job(1920, 1080, 4)).await;
    let hostile = farm.worker("hostile").await;
    let cases = hostile_numbers();
    assert!(cases.len() >= 200, "{}", cases.len());
    for (mut body, place, is_clamped) in cases {
        body["worker"] = serde_json::json!(hostile.id);
        let response = farm.post("/v1/worker/sync", body.to_string()).await;
        let status = response.status().as_u16();
        let value = body.pointer(&place).expect("a number").clone();
        assert!(status == 200 || status == 422, "{status} for {place} = {value}");
        if status == 422 {
            let problem: serde_json::Value = read(response, StatusCode::UNPROCESSABLE_ENTITY).await;
            let pointer = problem["errors"][0]["pointer"].as_str().expect("a place").to_owned();
            let last = place.rsplit('/').find(|part| part.parse::<u32>().is_err()).expect("a name");
            assert!(pointer.contains(last), "{pointer} for {place} = {value}");
        } else {
            let number = value.as_f64().expect("a number");
            assert!(is_clamped || (0.0..=9.1e15).contains(&number) && place.contains("tiles"), "{place} = {value}");
        }
    }
    farm.hand.advance(LEASE);
    let honest = farm.worker("honest").await;
    assert!(honest.claim().await.is_some(), "work for others");
    farm.stop().await;
}

#[tokio::test]
async fn absurdly_slow_workers_do_not_overflow_a_share() {
    let farm = Farm::start().await;
    for seed in 0..4 {
        farm.submit(&small_job(seed)).await;
    }
    let mut slow = farm.worker("slow").await;
    slow.rays_per_second = Some(1e-300);
    for _ in 0..4 {
        let run = slow.claim().await.expect("work");
        slow.report(slow.results(&run).await).await;
    }
    farm.stop().await;
}
