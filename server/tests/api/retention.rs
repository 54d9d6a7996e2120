//! Retention: jobs are deleted by age and by size, oldest first; pictures that others use stay. The clock is
//! manual.

use std::time::Duration;

use proto::JobId;
use proto::retention::{GcReport, RemovalReason};
use reqwest::StatusCode;
use serde_json::Value;

use super::harness::{Farm, Worker, in_time, leases, read, refused, small_job};

const DAY: Duration = Duration::from_hours(24);

async fn start(change: impl FnOnce(&mut server::Config)) -> Farm {
    Farm::start_in(tempfile::tempdir().expect("a temporary folder"), change).await
}

async fn submit(farm: &Farm, job: &Value, query: &str) -> JobId {
    let response = farm.post(&format!("/v1/jobs{query}"), job.to_string()).await;
    read::<proto::job::JobView>(response, StatusCode::CREATED).await.id
}

/// Renders the next job as a picture of `size_bytes` bytes, different for each letter.
async fn store(worker: &Worker<'_>, letter: u8, size_bytes: usize) {
    let run = worker.claim().await.expect("work");
    let results = worker.picture(&leases(&run), &vec![letter; size_bytes]).await;
    worker.report(results).await;
}

async fn collect(farm: &Farm, dry_run: bool) -> GcReport {
    read(farm.post(&format!("/v1/gc?dry_run={dry_run}"), "").await, StatusCode::OK).await
}

fn ids(collection: &GcReport) -> Vec<JobId> {
    collection.jobs.iter().map(|job| job.id).collect()
}

async fn is_there(farm: &Farm, id: JobId) -> bool {
    farm.get(&format!("/v1/jobs/{id}")).await.status() == StatusCode::OK
}

/// Waits until the folder has this many pictures: content is swept after the response.
async fn until_pictures(farm: &Farm, count: usize) {
    let folder = farm.folder.path().join("pictures");
    in_time(async {
        while std::fs::read_dir(&folder).expect("lists").count() != count {
            tokio::task::yield_now().await;
        }
    })
    .await;
}

#[tokio::test]
async fn jobs_are_deleted_after_their_own_or_the_default_retention() {
    let farm = start(|config| config.job_retention = Some(10 * DAY)).await;
    let worker = farm.worker("one").await;
    let mut jobs = Vec::new();
    for (seed, keep) in ["", "?keep=2d", "?keep=30d", "?keep=forever", "?keep=0s"].into_iter().enumerate() {
        jobs.push(submit(&farm, &small_job(seed as u32), keep).await);
        store(&worker, seed as u8, 400).await;
    }
    let waiting = submit(&farm, &small_job(99), "?keep=0s").await;
    for (days, gone) in
        [(0, vec![4]), (1, vec![]), (1, vec![1]), (7, vec![]), (1, vec![0]), (20, vec![2]), (3000, vec![])]
    {
        farm.hand.advance(days * DAY);
        let gone: Vec<JobId> = gone.into_iter().map(|index: usize| jobs[index]).collect();
        let received = collect(&farm, true).await;
        assert_eq!((ids(&received), received.dry_run), (gone.clone(), true), "after {days} days");
        for id in &gone {
            assert!(is_there(&farm, *id).await, "a dry run deletes nothing");
        }
        let done = collect(&farm, false).await;
        assert_eq!((ids(&done), done.freed_bytes), (gone.clone(), received.freed_bytes));
        assert!(done.jobs.iter().all(|job| job.reason == RemovalReason::Age && job.freed_bytes == 400), "{done:?}");
        for id in gone {
            refused(farm.get(&format!("/v1/jobs/{id}")).await, 404, "unknown_job").await;
        }
    }
    assert!(is_there(&farm, jobs[3]).await && is_there(&farm, waiting).await);
    until_pictures(&farm, 1).await;
    farm.stop().await;
}

#[tokio::test]
async fn a_full_store_deletes_the_jobs_that_finished_first() {
    let farm = start(|config| config.max_store_bytes = Some(2_500)).await;
    let worker = farm.worker("one").await;
    let mut jobs = Vec::new();
    for (seed, keep) in ["", "?keep=forever", "?keep=30d", ""].into_iter().enumerate() {
        farm.hand.advance(Duration::from_secs(1));
        jobs.push(submit(&farm, &small_job(seed as u32), keep).await);
        store(&worker, seed as u8, 1_000).await;
    }
    let received = collect(&farm, true).await;
    assert_eq!((received.store_bytes, received.max_store_bytes, received.freed_bytes), (4_000, Some(2_500), 2_000));
    assert_eq!(ids(&received), [jobs[0], jobs[2]]);
    assert!(received.jobs.iter().all(|job| job.reason == RemovalReason::Size));
    assert_eq!(ids(&collect(&farm, false).await), [jobs[0], jobs[2]]);
    until_pictures(&farm, 2).await;
    assert_eq!(ids(&collect(&farm, false).await), []);
    assert!(is_there(&farm, jobs[1]).await && is_there(&farm, jobs[3]).await);
    farm.stop().await;
}

#[tokio::test]
async fn jobs_whose_pictures_would_stay_are_not_deleted() {
    let farm = start(|config| config.max_store_bytes = Some(1_500)).await;
    let worker = farm.worker("one").await;
    let first = submit(&farm, &small_job(1), "").await;
    store(&worker, 1, 1_000).await;
    farm.hand.advance(Duration::from_secs(1));
    let again = submit(&farm, &small_job(1), "?keep=forever").await;
    farm.hand.advance(Duration::from_secs(1));
    let other = submit(&farm, &small_job(2), "").await;
    store(&worker, 2, 1_000).await;
    let done = collect(&farm, false).await;
    assert_eq!(ids(&done), [other], "the first job's picture would stay anyway");
    until_pictures(&farm, 1).await;
    assert!(is_there(&farm, first).await);
    assert_eq!(farm.get(&format!("/v1/jobs/{again}/image")).await.status(), StatusCode::OK);
    farm.stop().await;
}

#[tokio::test]
async fn a_shared_picture_is_deleted_with_both_jobs() {
    let farm = start(|config| config.max_store_bytes = Some(500)).await;
    let worker = farm.worker("one").await;
    let first = submit(&farm, &small_job(1), "").await;
    store(&worker, 1, 1_000).await;
    farm.hand.advance(Duration::from_secs(1));
    let again = submit(&farm, &small_job(1), "").await;
    let done = collect(&farm, false).await;
    assert_eq!((ids(&done), done.freed_bytes), (vec![first, again], 1_000));
    until_pictures(&farm, 0).await;
    // A deleted picture is rendered again.
    submit(&farm, &small_job(1), "").await;
    assert!(worker.claim().await.is_some());
    farm.stop().await;
}

#[tokio::test]
async fn a_starting_server_deletes_jobs_past_their_retention() {
    let farm = start(|_| {}).await;
    let worker = farm.worker("one").await;
    let job = submit(&farm, &small_job(1), "?keep=0s").await;
    store(&worker, 1, 100).await;
    let folder = farm.stop().await;
    let farm = Farm::start_in(folder, |_| {}).await;
    in_time(async {
        while is_there(&farm, job).await {
            tokio::task::yield_now().await;
        }
    })
    .await;
    until_pictures(&farm, 0).await;
    farm.stop().await;
}

#[tokio::test]
async fn an_invalid_retention_is_rejected() {
    let farm = Farm::start().await;
    for keep in ["7", "soon", "-1d", "7.5d", "101000w"] {
        let answer = farm.post(&format!("/v1/jobs?keep={keep}"), small_job(1).to_string()).await;
        let problem = refused(answer, 422, "wrong_query").await;
        assert!(problem.detail.contains("36h"), "{problem:?}");
    }
    refused(farm.post("/v1/gc?dry_run=maybe", "").await, 422, "wrong_query").await;
    farm.stop().await;
}
