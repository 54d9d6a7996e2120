//! Large changes of a job are made in pieces: users see them complete from the first piece on, a killed server's
//! successor finishes them, and no transaction is long.

use std::time::Duration;

use proto::job::JobState;
use proto::worker_protocol::{Batch, LeaseOutcome, LeaseReport};
use proto::{JobId, WorkerId};

use super::{Fixture, execute, leases, speed, turn};
use crate::db;
use crate::queue::{BacklogLimits, ChangeOutcome, DeleteOutcome, NextWork, RetryOutcome, SyncInput, SyncOutcome};

/// Rows of a piece in the quick tests.
const FEW_ROWS: i64 = 5;

/// A farm in which pieces are small.
async fn small_pieces() -> Fixture {
    let mut bench = Fixture::in_memory().await;
    bench.queue.piece_rows = FEW_ROWS;
    bench
}

/// Makes all pieces that are left; returns their number.
async fn clean_up(bench: &Fixture) -> usize {
    let mut pieces = 0;
    while bench.queue.clean_up_piece().await.expect("a piece").is_some() {
        pieces += 1;
    }
    pieces
}

async fn sync(bench: &Fixture, said: SyncInput) -> SyncOutcome {
    bench.turn(said).await.expect("known")
}

/// Claims a batch of a few tiles.
async fn claim(bench: &Fixture, worker: WorkerId) -> Batch {
    let said = SyncInput { wants_work: true, rays_per_second: speed(3000.0), ..turn(worker) };
    match sync(bench, said).await.next {
        NextWork::Run(run) => run,
        other @ (NextWork::OpenFrame { .. } | NextWork::Nothing(_)) => panic!("{other:?}"),
    }
}

fn results(run: &Batch, outcome: &LeaseOutcome) -> Vec<LeaseReport> {
    leases(run).map(|lease| LeaseReport { lease, outcome: outcome.clone() }).collect()
}

fn blob() -> LeaseOutcome {
    LeaseOutcome::Blob { hash: blake3::hash(b"pixels").to_hex().to_string(), size_bytes: 1 }
}

/// A running job with tiles that are done, leased and ready; the worker holds the returned batches.
async fn running_job(bench: &Fixture, worker: WorkerId) -> (JobId, Vec<Batch>) {
    let job = bench.submit(3, 1).await;
    let done = claim(bench, worker).await;
    sync(bench, SyncInput { reports: results(&done, &blob()), ..turn(worker) }).await;
    let held = vec![claim(bench, worker).await, claim(bench, worker).await];
    (job, held)
}

async fn state(bench: &Fixture, job: JobId) -> Option<JobState> {
    bench.queue.job(job).await.expect("reads").map(|view| view.state)
}

async fn count(bench: &Fixture, statement: &'static str) -> i64 {
    db::query_scalar(statement).fetch_one(bench.queue.readers()).await.expect("counts")
}

#[tokio::test]
async fn a_cancelled_job_is_voided_in_pieces_by_the_next_server() {
    let mut bench = small_pieces().await;
    let worker = bench.worker(None).await;
    let (job, held) = running_job(&bench, worker).await;
    bench.queue.cancel(job).await.expect("cancels");
    assert_eq!(state(&bench, job).await, Some(JobState::Cancelled));
    // Its leases are revoked at once, also those whose tiles are not void yet, and results have no effect.
    let (first, second) = (leases(&held[0]).collect::<Vec<_>>(), leases(&held[1]).collect::<Vec<_>>());
    let received =
        sync(&bench, SyncInput { held_leases: first.clone(), reports: results(&held[1], &blob()), ..turn(worker) })
            .await;
    let mut expected: Vec<_> = first.into_iter().chain(second).collect();
    let mut revoked = received.revoked_leases;
    expected.sort();
    revoked.sort();
    assert_eq!(revoked, expected);
    assert!(count(&bench, "SELECT count(*) FROM tile WHERE state IN ('ready', 'leased')").await > 0, "pieces are left");
    bench.restart().await;
    bench.queue.piece_rows = FEW_ROWS;
    assert!(clean_up(&bench).await > 0);
    assert_eq!(count(&bench, "SELECT count(*) FROM tile WHERE state IN ('ready', 'leased')").await, 0);
    bench.check().await;
}

#[tokio::test]
async fn a_deleted_job_is_hidden_at_once_and_removed_in_pieces() {
    let mut bench = small_pieces().await;
    let worker = bench.worker(None).await;
    let (job, _) = running_job(&bench, worker).await;
    assert_eq!(bench.queue.delete(job).await.expect("a response"), DeleteOutcome::Running);
    bench.queue.cancel(job).await.expect("cancels");
    assert!(matches!(bench.queue.delete(job).await.expect("deletes"), DeleteOutcome::Done(_)));
    assert!(count(&bench, "SELECT count(*) FROM tile").await > 0, "pieces are left");
    bench.restart().await;
    bench.queue.piece_rows = FEW_ROWS;
    assert_eq!(state(&bench, job).await, None);
    assert!(bench.queue.jobs(None, None, 10, None).await.expect("lists").jobs.is_empty());
    assert!(bench.queue.jobs_like(None, "latest", 10).await.expect("lists").jobs.is_empty());
    assert_eq!(bench.queue.file(job).await.expect("reads"), None);
    assert_eq!(bench.queue.frames(job).await.expect("reads"), None);
    assert_eq!(bench.queue.oldest_jobs(None, 10).await.expect("reads").len(), 0);
    assert_eq!(bench.queue.delete(job).await.expect("a response"), DeleteOutcome::Unknown);
    assert!(clean_up(&bench).await > 2);
    for rows in [
        "SELECT count(*) FROM job",
        "SELECT count(*) FROM job_file",
        "SELECT count(*) FROM frame",
        "SELECT count(*) FROM tile",
        "SELECT count(*) FROM lease",
        "SELECT count(*) FROM outbox",
        "SELECT count(*) FROM speed",
        "SELECT CAST(coalesce(sum(jobs), 0) AS BIGINT) FROM backlog",
        "SELECT CAST(coalesce(sum(jobs), 0) AS BIGINT) FROM share",
    ] {
        assert_eq!(count(&bench, rows).await, 0, "{rows}");
    }
    bench.check().await;
}

#[tokio::test]
async fn a_deleted_job_that_waits_is_not_rendered() {
    let bench = small_pieces().await;
    let worker = bench.worker(None).await;
    let job = bench.submit(1, 1).await;
    // As if all but the last of many frames had been found in the cache.
    execute(&bench, "UPDATE job SET frames_total = 20, frames_opened = 18, tiles_total = 240").await;
    execute(
        &bench,
        "WITH RECURSIVE number (n) AS (SELECT 0 UNION ALL SELECT n + 1 FROM number WHERE n < 17)
         INSERT INTO frame (job, number, state, picture_key, tiles_total, tiles_done, picture, size_bytes)
         SELECT job.number, n, 'stored', 'key', 12, 12, 'picture', 5 FROM number, job",
    )
    .await;
    assert!(matches!(bench.queue.delete(job).await.expect("deletes"), DeleteOutcome::Done(_)));
    assert!(count(&bench, "SELECT count(*) FROM frame").await > 0, "pieces are left");
    let said = SyncInput { wants_work: true, ..turn(worker) };
    assert!(matches!(sync(&bench, said).await.next, NextWork::Nothing(_)));
    assert!(clean_up(&bench).await > 0);
    assert_eq!(count(&bench, "SELECT count(*) FROM job").await, 0);
    assert_eq!(count(&bench, "SELECT CAST(coalesce(sum(jobs), 0) AS BIGINT) FROM backlog").await, 0);
    bench.check().await;
}

#[tokio::test]
async fn a_failed_job_is_voided_and_retried_in_pieces() {
    let bench = small_pieces().await;
    let worker = bench.worker(None).await;
    let (job, held) = running_job(&bench, worker).await;
    let failed = LeaseOutcome::Failed { message: "no".to_owned() };
    sync(&bench, SyncInput { reports: results(&held[0], &failed), ..turn(worker) }).await;
    while state(&bench, job).await != Some(JobState::Failed) {
        bench.hand.advance(Duration::from_millis(300));
        let run = claim(&bench, worker).await;
        sync(&bench, SyncInput { reports: results(&run, &failed), ..turn(worker) }).await;
    }
    // Retrying waits until everything is void.
    assert_eq!(
        bench.queue.retry(job, BacklogLimits::default()).await.expect("retries"),
        RetryOutcome::Changed(ChangeOutcome::Done)
    );
    assert_eq!(state(&bench, job).await, Some(JobState::Running));
    clean_up(&bench).await;
    bench.check().await;
    assert_eq!(count(&bench, "SELECT count(*) FROM tile WHERE state IN ('dead', 'void')").await, 0);
    for _ in 0..200 {
        if state(&bench, job).await == Some(JobState::Succeeded) {
            break;
        }
        bench.hand.advance(Duration::from_millis(300));
        let run = claim(&bench, worker).await;
        let picture = LeaseOutcome::Picture { hash: blake3::hash(b"picture").to_hex().to_string(), size_bytes: 1 };
        let is_stitch = matches!(run.work, proto::worker_protocol::BatchWork::Stitch { .. });
        let is_whole = matches!(run.work, proto::worker_protocol::BatchWork::Render { whole_frame: true, .. });
        let outcome = if is_stitch || is_whole { picture } else { blob() };
        sync(&bench, SyncInput { reports: results(&run, &outcome), ..turn(worker) }).await;
    }
    assert_eq!(state(&bench, job).await, Some(JobState::Succeeded));
    bench.check().await;
}

/// Maximum duration of a transaction, in seconds.
const MAX_TRANSACTION_SECONDS: f64 = 0.05;

/// Adds a running job with this many frames of ten tiles, each with a lease. A fifth of the frames is open, with nine
/// ready tiles and one leased; the others are stored.
async fn add_large_job(bench: &Fixture, frames: u32) -> JobId {
    let job = bench.submit(frames, 1).await;
    for statement in [
        "UPDATE job SET tiles_total = frames_total * 10, frames_opened = frames_total, state = 'running', started_at_ms = 1",
        "WITH RECURSIVE counted (n) AS (SELECT 0 UNION ALL SELECT n + 1 FROM counted WHERE n < 99999)
         INSERT INTO frame (job, number, state, picture_key, tiles_total, tiles_done, picture, size_bytes)
         SELECT job.number, n, iif(n % 5 = 0, 'open', 'stored'), 'key ' || n, 10, iif(n % 5 = 0, 0, 10),
                iif(n % 5 = 0, NULL, 'picture ' || n), iif(n % 5 = 0, NULL, 5)
         FROM job @join counted WHERE n < job.frames_total",
        "WITH RECURSIVE counted (n) AS (SELECT 0 UNION ALL SELECT n + 1 FROM counted WHERE n < 9)
         INSERT INTO tile (job, frame, kind, position, x_px, y_px, width_px, height_px, rays, state, blob, blob_bytes)
         SELECT frame.job, frame.number, 'render', n, 0, 0, 32, 32, 1,
                iif(frame.state = 'stored', 'done', iif(n = 0, 'leased', 'ready')),
                iif(frame.state = 'stored', frame.number || ' ' || n, NULL), iif(frame.state = 'stored', 5, NULL)
         FROM frame @join counted",
        "INSERT INTO lease (id, tile, epoch, worker, generation, granted_ms, expires_ms, ended)
         SELECT 'lease ' || id, id, 1, (SELECT min(id) FROM worker), 1, 0, 1000000000,
                iif(state = 'leased', NULL, 'done') FROM tile",
        "INSERT INTO picture (key, hash, size_bytes, media_type, stored_at_ms)
         SELECT picture_key, picture, size_bytes, 'image/png', 0 FROM frame WHERE picture IS NOT NULL",
    ] {
        execute(bench, statement).await;
    }
    job
}

/// Longest transactions of a large change, in seconds: of its pieces, and of a worker's syncs between them.
#[derive(Debug, Default)]
struct Longest {
    pieces: usize,
    piece_seconds: f64,
    sync_seconds: f64,
}

/// Makes all pieces of a change that has begun, while a worker asks for work.
async fn finish(bench: &Fixture, worker: WorkerId) -> Longest {
    let longest = &bench.queue.database.commits().longest_seconds;
    let mut seen = Longest { piece_seconds: longest.get(), ..Longest::default() };
    loop {
        longest.set(0.0);
        if bench.queue.clean_up_piece().await.expect("a piece").is_none() {
            return seen;
        }
        seen.pieces += 1;
        seen.piece_seconds = seen.piece_seconds.max(longest.get());
        longest.set(0.0);
        sync(bench, turn(worker)).await;
        seen.sync_seconds = seen.sync_seconds.max(longest.get());
    }
}

#[tokio::test]
#[ignore = "long: deletes, cancels and retries a job of 100,000 frames and 1 M tiles; 120 s"]
async fn no_transaction_is_long_whatever_is_deleted_cancelled_or_retried() {
    let bench = Fixture::in_memory().await;
    // The first worker holds the leases of the large job, the second one works on.
    let (_, worker) = (bench.worker(None).await, bench.worker(None).await);
    let job = add_large_job(&bench, 100_000).await;
    let mut all = Vec::new();
    let reset = || bench.queue.database.commits().longest_seconds.set(0.0);

    reset();
    bench.queue.cancel(job).await.expect("cancels");
    all.push(("cancel", finish(&bench, worker).await));
    assert_eq!(count(&bench, "SELECT count(*) FROM tile WHERE state IN ('ready', 'leased')").await, 0);

    execute(&bench, "UPDATE job SET state = 'failed', error = 'no', tiles_dead = 1").await;
    execute(&bench, "UPDATE tile SET state = 'dead' WHERE id = (SELECT min(id) FROM tile WHERE state = 'void')").await;
    reset();
    assert_eq!(
        bench.queue.retry(job, BacklogLimits::default()).await.expect("retries"),
        RetryOutcome::Changed(ChangeOutcome::Done)
    );
    all.push(("retry", finish(&bench, worker).await));
    assert_eq!(count(&bench, "SELECT count(*) FROM tile WHERE state IN ('dead', 'void')").await, 0);

    bench.queue.cancel(job).await.expect("cancels");
    clean_up(&bench).await;
    reset();
    assert!(matches!(bench.queue.delete(job).await.expect("deletes"), DeleteOutcome::Done(_)));
    all.push(("delete", finish(&bench, worker).await));
    assert_eq!(count(&bench, "SELECT (SELECT count(*) FROM job) + (SELECT count(*) FROM tile)").await, 0);
    eprintln!("{all:?}");
    let is_idle = std::env::var_os("SDFARM_CHECK_TIMES").is_some();
    for (what, longest) in &all {
        assert!(longest.pieces > 1000, "{what}: {longest:?}");
        assert!(
            !is_idle || longest.piece_seconds.max(longest.sync_seconds) <= MAX_TRANSACTION_SECONDS,
            "{what}: {longest:?}"
        );
    }
}
