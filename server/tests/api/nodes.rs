//! Scenes that are too large for some workers: which workers get them, and the warnings of their jobs.

use proto::JobId;
use proto::job::{JobPage, JobState};
use proto::worker_protocol::{BatchWork, LeaseOutcome, LeaseReport};
use reqwest::StatusCode;
use serde_json::{Value, json};

use super::harness::{Farm, LEASE, Said, assert_state, job, leases, read, small_job};

/// Largest scene that a small worker of these tests renders, in nodes.
const MAX_NODES: u32 = 500;

/// Gives a job a scene with `nodes` nodes, which are not cut into leaves.
fn with_nodes(mut job: Value, nodes: usize) -> Value {
    let spheres = vec![json!({ "sphere": { "radius": 1 } }); nodes - 1];
    job["scene"]["objects"][0]["shape"] = json!({ "intersection": { "of": spheres } });
    job
}

async fn warnings(farm: &Farm, id: JobId) -> Vec<String> {
    farm.job(id).await.warnings
}

#[tokio::test]
async fn a_worker_never_gets_a_scene_above_its_maximum() {
    let farm = Farm::start().await;
    let mut large = with_nodes(small_job(1), 501);
    large["priority"] = 5.into();
    let large = farm.submit(&large).await;
    let fitting = farm.submit(&with_nodes(small_job(2), 500)).await;
    let small = farm.small_worker("small", MAX_NODES).await;
    assert_eq!(small.claim().await.expect("the job that fits").job, fitting.id);
    assert!(small.claim().await.is_none());
    assert_state(&farm, large.id, JobState::Queued).await;
    let any = farm.worker("any").await;
    assert_eq!(any.claim().await.expect("the large job").job, large.id);
    farm.stop().await;
}

#[tokio::test]
async fn a_released_large_tile_waits_for_a_suitable_worker() {
    let farm = Farm::start().await;
    let posted = farm.submit(&with_nodes(small_job(1), 501)).await;
    let any = farm.worker("any").await;
    let held = leases(&any.claim().await.expect("work"));
    any.report(vec![LeaseReport { lease: held[0], outcome: LeaseOutcome::Released }]).await;
    let small = farm.small_worker("small", MAX_NODES).await;
    assert!(small.claim().await.is_none());
    assert_eq!(any.work_off().await, 1);
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    farm.stop().await;
}

#[tokio::test]
async fn a_small_worker_stitches_large_scenes_but_opens_no_frame() {
    let farm = Farm::start().await;
    let mut two_frames = with_nodes(job(1920, 1080, 4), 501);
    two_frames["frames"] = json!({ "count": 2 });
    let posted = farm.submit(&two_frames).await;
    let (any, small) = (farm.worker("any").await, farm.small_worker("small", MAX_NODES).await);
    for frame in 0..2 {
        for _ in 0..posted.tiles.total / 2 {
            assert!(small.claim().await.is_none());
            assert!(any.work_once().await);
        }
        let stitch = small.claim().await.expect("the stitch");
        assert!(matches!(stitch.work, BatchWork::Stitch { .. }), "{stitch:?}");
        assert_eq!(stitch.frame, frame);
        assert!(small.claim().await.is_none(), "the other tiles are too large for it");
        small.report(small.results(&stitch).await).await;
    }
    assert_state(&farm, posted.id, JobState::Succeeded).await;
    farm.stop().await;
}

#[tokio::test]
async fn a_later_frames_stitch_does_not_wait_for_earlier_tiles() {
    let farm = Farm::start().await;
    let mut two_frames = with_nodes(job(1920, 1080, 4), 501);
    two_frames["frames"] = json!({ "count": 2 });
    let posted = farm.submit(&two_frames).await;
    let (any, small) = (farm.worker("any").await, farm.small_worker("small", MAX_NODES).await);
    let first = leases(&any.claim().await.expect("work"))[0];
    for _ in 1..posted.tiles.total {
        assert!(any.work_once().await);
    }
    any.report(vec![LeaseReport { lease: first, outcome: LeaseOutcome::Released }]).await;
    let run = small.claim().await.expect("a stitch");
    assert!(matches!(run.work, BatchWork::Stitch { .. }) && run.frame == 1, "{run:?}");
    assert!(small.claim().await.is_none());
    farm.stop().await;
}

#[tokio::test]
async fn a_large_frame_is_not_shared_with_unsuitable_workers() {
    let farm = Farm::start().await;
    farm.submit(&with_nodes(job(1920, 1080, 4), 501)).await;
    farm.small_worker("idle", MAX_NODES).await;
    let mut any = farm.worker("any").await;
    any.rays_per_second = Some(1e9);
    let run = any.claim().await.expect("work");
    assert!(matches!(run.work, BatchWork::Render { whole_frame: true, .. }), "{run:?}");
    farm.stop().await;
}

#[tokio::test]
async fn a_failed_tile_returns_to_the_only_suitable_worker() {
    let farm = Farm::start().await;
    farm.submit(&with_nodes(small_job(1), 501)).await;
    let (any, small) = (farm.worker("any").await, farm.small_worker("small", MAX_NODES).await);
    let held = leases(&any.claim().await.expect("work"));
    any.report(vec![LeaseReport { lease: held[0], outcome: LeaseOutcome::Failed { message: "no".to_owned() } }]).await;
    farm.hand.advance(std::time::Duration::from_secs(6));
    assert!(small.claim().await.is_none());
    assert!(any.claim().await.is_some());
    farm.stop().await;
}

#[tokio::test]
async fn a_job_has_a_warning_until_a_suitable_worker_exists() {
    let farm = Farm::start().await;
    let large = farm.submit(&with_nodes(small_job(1), 812)).await;
    let fitting = farm.submit(&with_nodes(small_job(2), 500)).await;
    assert_eq!(warnings(&farm, large.id).await, [""; 0], "a farm without workers reports that elsewhere");

    farm.small_worker("smaller", 20).await;
    let small = farm.small_worker("small", MAX_NODES).await;
    let sentence = "no worker of this farm renders scenes of more than 500 nodes, and this scene has 812: \
                    start a CPU worker (`sdfarm worker --device cpu`)";
    assert_eq!(warnings(&farm, large.id).await, [sentence]);
    assert_eq!(warnings(&farm, fitting.id).await, [""; 0]);
    let page: JobPage = read(farm.get("/v1/jobs?limit=1&cursor=2").await, StatusCode::OK).await;
    assert_eq!((page.jobs[0].id, page.jobs[0].warnings.as_slice()), (large.id, [sentence.to_owned()].as_slice()));

    let any = farm.worker("any").await;
    assert_eq!(warnings(&farm, large.id).await, [""; 0]);
    assert_eq!(any.claim().await.expect("work").job, large.id);

    // That worker vanishes with its tile; the small one stays.
    for _ in 0..2 {
        farm.hand.advance(LEASE / 2);
        small.sync(Said::default()).await;
    }
    assert_eq!(warnings(&farm, large.id).await, [sentence]);

    farm.worker("last").await.work_once().await;
    for _ in 0..2 {
        farm.hand.advance(LEASE / 2);
        small.sync(Said::default()).await;
    }
    assert_state(&farm, large.id, JobState::Succeeded).await;
    assert_eq!(warnings(&farm, large.id).await, [""; 0], "a finished job waits for no worker");
    farm.stop().await;
}
