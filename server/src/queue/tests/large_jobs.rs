//! Large changes of a job are made in pieces: users see them complete from the first piece on, a killed server's
//! successor finishes them, and no transaction is long.

use std::time::Duration;

use proto::job::JobState;
use proto::worker_protocol::{Batch, LeaseOutcome, LeaseReport};
use proto::{JobId, WorkerId};

use super::{Fixture, execute, leases, speed, turn};
use crate::queue::{ChangeOutcome, DeleteOutcome, NextWork, SyncInput, SyncOutcome};

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
    sqlx::query_scalar(statement).fetch_one(bench.queue.readers()).await.expect("counts")
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
    let told =
        sync(&bench, SyncInput { held_leases: first.clone(), reports: results(&held[1], &blob()), ..turn(worker) })
            .await;
    let mut expected: Vec<_> = first.into_iter().chain(second).collect();
    let mut revoked = told.revoked_leases;
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
        "SELECT coalesce(sum(jobs), 0) FROM backlog",
        "SELECT coalesce(sum(jobs), 0) FROM share",
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
    assert_eq!(count(&bench, "SELECT coalesce(sum(jobs), 0) FROM backlog").await, 0);
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
    assert_eq!(bench.queue.retry(job).await.expect("retries"), ChangeOutcome::Done);
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

/// Adds a finished job with this many frames of ten tiles, with leases and events, as its state and its tiles' say.
async fn add_large_job(bench: &Fixture, frames: u32, open: bool) -> JobId {
    let job = bench.submit(frames, 1).await;
    for statement in [
        "UPDATE job SET tiles_total = frames_total * 10, frames_opened = frames_total",
        "WITH RECURSIVE number (n) AS (SELECT 0 UNION ALL SELECT n + 1 FROM number WHERE n < 99999)
         INSERT INTO frame (job, number, state, picture_key, tiles_total, tiles_done, picture, size_bytes)
         SELECT job.number, n, 'stored', 'key ' || n, 10, 10, 'picture ' || n, 5 FROM job CROSS JOIN number
         WHERE n < job.frames_total AND NOT EXISTS (SELECT 1 FROM frame WHERE frame.job = job.number)",
        "WITH RECURSIVE number (n) AS (SELECT 0 UNION ALL SELECT n + 1 FROM number WHERE n < 9)
         INSERT INTO tile (job, frame, kind, position, x_px, y_px, width_px, height_px, rays, state, blob, blob_bytes)
         SELECT frame.job, frame.number, 'render', n, 0, 0, 32, 32, 1, 'done', frame.number || ' ' || n, 5
         FROM frame CROSS JOIN number WHERE NOT EXISTS (SELECT 1 FROM tile WHERE tile.job = frame.job AND tile.frame = frame.number)",
        "INSERT INTO lease (id, tile, epoch, worker, generation, granted_ms, expires_ms, ended)
         SELECT 'lease ' || id, id, 1, (SELECT min(id) FROM worker), 1, 0, 0, 'done' FROM tile
         WHERE NOT EXISTS (SELECT 1 FROM lease WHERE lease.tile = tile.id)",
        "INSERT INTO picture (key, hash, size_bytes, media_type, stored_at_ms)
         SELECT picture_key, picture, size_bytes, 'image/png', 0 FROM frame WHERE true ON CONFLICT DO NOTHING",
    ] {
        execute(bench, statement).await;
    }
    if open {
        for statement in [
            "UPDATE frame SET state = 'open', picture = NULL, size_bytes = NULL, tiles_done = 0 WHERE number < 20000",
            "UPDATE tile SET state = iif(position = 0, 'leased', 'ready'), blob = NULL, blob_bytes = NULL WHERE frame < 20000",
            "UPDATE lease SET ended = NULL, expires_ms = 1000000000
             WHERE tile IN (SELECT id FROM tile WHERE state = 'leased')",
            "UPDATE job SET state = 'running', started_at_ms = 1",
        ] {
            execute(bench, statement).await;
        }
    } else {
        execute(bench, "UPDATE job SET state = 'cancelled', finished_at_ms = 1").await;
    }
    job
}

#[tokio::test]
#[ignore = "long: deletes, cancels and retries a job of 100,000 frames and 1 M tiles; 120 s"]
async fn no_transaction_is_long_whatever_is_deleted_cancelled_or_retried() {
    let bench = Fixture::in_memory().await;
    // The first worker holds the leases of the large jobs, the second one works on.
    let (_, worker) = (bench.worker(None).await, bench.worker(None).await);
    let longest = bench.queue.database.commits().longest_seconds.clone();
    for (what, open) in [("cancel", true), ("delete", false)] {
        let job = add_large_job(&bench, 100_000, open).await;
        longest.set(0.0);
        if open {
            bench.queue.cancel(job).await.expect("cancels");
        } else {
            assert!(matches!(bench.queue.delete(job).await.expect("deletes"), DeleteOutcome::Done(_)));
        }
        let mut pieces = 0;
        while bench.queue.clean_up_piece().await.expect("a piece").is_some() {
            pieces += 1;
            sync(&bench, SyncInput { wants_work: true, ..turn(worker) }).await;
        }
        eprintln!("{what}: {pieces} pieces, the longest transaction took {:.1} ms", longest.get() * 1e3);
        assert!(longest.get() <= MAX_TRANSACTION_SECONDS, "{what}: {} s", longest.get());
        if open {
            execute(&bench, "UPDATE job SET state = 'failed', error = 'no', tiles_dead = 1").await;
            execute(
                &bench,
                "UPDATE tile SET state = 'dead' WHERE id = (SELECT min(id) FROM tile WHERE state = 'void')",
            )
            .await;
            longest.set(0.0);
            assert_eq!(bench.queue.retry(job).await.expect("retries"), ChangeOutcome::Done);
            let pieces = clean_up(&bench).await;
            eprintln!("retry: {pieces} pieces, the longest transaction took {:.1} ms", longest.get() * 1e3);
            assert!(longest.get() <= MAX_TRANSACTION_SECONDS, "retry: {} s", longest.get());
            execute(&bench, "UPDATE job SET state = 'cancelled', finished_at_ms = 1").await;
            bench.queue.delete(job).await.expect("deletes");
            clean_up(&bench).await;
        }
        assert_eq!(count(&bench, if open { "SELECT 0" } else { "SELECT count(*) FROM job" }).await, 0);
    }
    let rows: i64 = count(&bench, "SELECT count(*) FROM tile").await;
    assert_eq!(rows, 0);
}
