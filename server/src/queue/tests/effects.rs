//! Effects that random sequences do not reach: of frames from the cache, of pictures that are forgotten, and of
//! verification's undoing. No trigger has a part in them.

use proto::job::JobState;
use proto::worker_protocol::{LeaseOutcome, LeaseReport};
use proto::{JobId, WorkerId};

use super::{Fixture, leases, new_job, speed, turn};
use crate::db;
use crate::postgres_server;
use crate::queue::tiles::undo;
use crate::queue::{FrameOpening, NewJob, NextWork, OpenOutcome, SyncInput};

/// Key of the picture that all jobs of these tests show.
const KEY: &str = "key";

/// Accepts a job of one frame that may come from the cache; returns its number.
async fn submit(bench: &Fixture) -> (i64, JobId) {
    let new = NewJob { no_cache: false, ..new_job(1) };
    let id = new.id;
    (bench.queue.submit(new).await.expect("accepted"), id)
}

fn opening(job: i64) -> FrameOpening {
    let plan = new_job(1).plan;
    FrameOpening { job, frame: 0, picture_key: KEY.to_owned(), scene: None, tiles: plan.tiles(), samples: plan.samples }
}

/// Claims with this speed, and delivers the outcome for all leases.
async fn render(bench: &Fixture, worker: WorkerId, job: i64, rays_per_second: f64, outcome: LeaseOutcome) {
    let asks = SyncInput { wants_work: true, rays_per_second: speed(rays_per_second), ..turn(worker) };
    let asks = SyncInput { opening: Some(opening(job)), ..asks };
    let synced = bench.queue.turn(asks).await.expect("a sync").expect("known");
    let NextWork::Run(run) = synced.next else { panic!("there is work: {:?}", synced.next) };
    let reports = leases(&run).map(|lease| LeaseReport { lease, outcome: outcome.clone() }).collect();
    bench.queue.turn(SyncInput { reports, ..turn(worker) }).await.expect("a sync").expect("known");
}

fn picture() -> LeaseOutcome {
    LeaseOutcome::Picture { hash: hash(), size_bytes: 5 }
}

fn hash() -> String {
    blake3::hash(b"picture").to_hex().to_string()
}

/// Events of a job after one: their kinds, or states.
async fn events(bench: &Fixture, job: i64, after: i64) -> Vec<String> {
    let events = bench.queue.job_events_after(job, after, 1000).await.expect("reads");
    events.into_iter().map(|event| event.state.map_or(event.kind, |state| state.name().to_owned())).collect()
}

async fn count(bench: &Fixture, statement: &'static str) -> i64 {
    db::query_scalar(statement).fetch_one(bench.queue.readers()).await.expect("counts")
}

#[tokio::test]
async fn frames_from_the_cache_and_forgotten_pictures_have_their_events() {
    let bench = Fixture::new().await;
    let worker = bench.worker(None).await;
    let (first, first_id) = submit(&bench).await;
    render(&bench, worker, first, 1e9, picture()).await;
    let tiles = vec!["tile".to_owned(); 12];
    let rendered =
        [&["queued", "running"].map(str::to_owned)[..], &tiles, &["frame", "progress", "succeeded"].map(str::to_owned)];
    assert_eq!(events(&bench, first, 0).await, rendered.concat());

    let (second, second_id) = submit(&bench).await;
    assert_eq!(bench.queue.reuse(opening(second)).await.expect("opens"), OpenOutcome::Stored);
    assert_eq!(events(&bench, second, 0).await, ["queued", "frame", "progress", "succeeded"]);
    let stored = bench.queue.job_events_after(second, 0, 2).await.expect("reads").pop().expect("two events");
    let image = format!("/v1/jobs/{second_id}/frames/0/image");
    let body = format!(r#"{{"frame":0,"picture":"{}","size_bytes":5,"image":"{image}"}}"#, hash());
    assert_eq!(stored.body, body);
    assert_eq!(count(&bench, "SELECT jobs FROM backlog WHERE submitter = '*'").await, 0);

    let newest = bench.queue.newest_event().await.expect("reads");
    assert_eq!(bench.queue.forget_picture(&hash()).await.expect("forgets").reopened.frames, 2);
    for (job, id) in [(first, first_id), (second, second_id)] {
        assert_eq!(events(&bench, job, newest).await, ["running"]);
        assert_eq!(bench.queue.job(id).await.expect("reads").expect("a job").state, JobState::Running);
    }
    assert_eq!(count(&bench, "SELECT jobs FROM backlog WHERE submitter = 'local'").await, 2);
    assert_eq!(count(&bench, "SELECT jobs FROM share").await, 2);
    bench.check().await;
}

#[tokio::test]
async fn undone_tiles_have_their_events_and_no_progress() {
    let bench = Fixture::new().await;
    let (worker, _) = (bench.worker(None).await, bench.worker(None).await);
    let (job, _) = submit(&bench).await;
    let blob = LeaseOutcome::Blob { hash: hash(), size_bytes: 5 };
    render(&bench, worker, job, 3000.0, blob.clone()).await;
    let rendered = events(&bench, job, 0).await;
    let done = rendered.iter().filter(|kind| *kind == "tile").count();
    assert!(done > 0 && done < 12, "{rendered:?}");
    assert_eq!(rendered.last().map(String::as_str), Some("progress"));
    let newest = bench.queue.newest_event().await.expect("reads");
    let undo = bench.queue.database.write(db::Durability::Relaxed, move |connection| {
        Box::pin(async move { undo::undo_unconfirmed(connection, &worker.to_string(), None).await })
    });
    undo.await.expect("undoes");
    assert_eq!(events(&bench, job, newest).await, vec!["tile"; done]);
    bench.check().await;
    // Rays that are done again are no progress.
    let newest = bench.queue.newest_event().await.expect("reads");
    render(&bench, worker, job, 3000.0, blob).await;
    assert_eq!(events(&bench, job, newest).await, vec!["tile"; done]);
    bench.check().await;
}

#[tokio::test]
async fn no_trigger_is_left() {
    if postgres_server::server().is_some() {
        return;
    }
    let bench = Fixture::new().await;
    assert_eq!(count(&bench, "SELECT count(*) FROM sqlite_master WHERE type = 'trigger'").await, 0);
}
