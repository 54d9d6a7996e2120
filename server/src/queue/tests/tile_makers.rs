//! The maker of a tile is known as long as the tile is there, though leases and workers are deleted.

use proto::tile_history::{TileOutcome, TileView};
use proto::worker_protocol::{LeaseOutcome, LeaseReport};
use proto::{JobId, WorkerId};

use super::{Fixture, leases, new_job, turn};
use crate::db::{self, Durability, Statement};
use crate::queue::{LeaseEnd, NextWork, SyncInput};

async fn run(bench: &Fixture, statement: impl FnOnce() -> Statement + Send + 'static) {
    let done = bench.queue.database.write(Durability::Relaxed, move |connection| {
        Box::pin(async move { statement().execute(connection).await.map(drop) })
    });
    done.await.expect("runs");
}

/// Makes all leases as old as the year 1970, and prunes.
async fn forget_leases(bench: &Fixture) {
    run(bench, || db::query("UPDATE lease SET id = '00000000' || substr(id, 9)")).await;
    bench.queue.prune().await.expect("prunes");
}

async fn count(bench: &Fixture, statement: &'static str) -> i64 {
    db::query_scalar(statement).fetch_one(bench.queue.readers()).await.expect("counts")
}

/// Claims, and delivers this outcome after a while.
async fn render(bench: &Fixture, worker: WorkerId, outcome: LeaseOutcome) {
    let synced = bench.turn(SyncInput { wants_work: true, ..turn(worker) }).await.expect("known");
    let NextWork::Run(run) = synced.next else { panic!("there is work: {:?}", synced.next) };
    bench.hand.advance(std::time::Duration::from_millis(250));
    let reports = leases(&run).map(|lease| LeaseReport { lease, outcome: outcome.clone() }).collect();
    bench.queue.turn(SyncInput { reports, ..turn(worker) }).await.expect("a sync").expect("known");
}

async fn tiles(bench: &Fixture, job: JobId) -> Vec<TileView> {
    bench.queue.tiles(job, None, None, 1000).await.expect("reads").expect("a job").tiles
}

#[tokio::test]
async fn makers_outlive_leases_and_workers_and_end_with_the_job() {
    let bench = Fixture::new().await;
    let new = new_job(1);
    let id = new.id;
    bench.queue.submit(new).await.expect("accepted");
    let worker = bench.register(None, Some(7)).await;
    let failed = LeaseOutcome::Failed { message: "no".to_owned() };
    render(&bench, worker, failed).await;
    bench.hand.advance(std::time::Duration::from_mins(1));
    let hash = blake3::hash(b"picture").to_hex().to_string();
    render(&bench, worker, LeaseOutcome::Picture { hash, size_bytes: 5 }).await;
    let before = tiles(&bench, id).await;
    let made = bench.queue.makers(id, 0).await.expect("reads").expect("known");
    assert!(before.iter().all(|tile| tile.leases.last().is_some_and(|lease| lease.outcome == Some(TileOutcome::Done))));
    bench.queue.worker_exited(7, LeaseEnd::Lost, String::new()).await.expect("ends");
    for _ in 0..2 {
        forget_leases(&bench).await;
        assert_eq!(count(&bench, "SELECT count(*) FROM lease").await, 0);
        assert_eq!(count(&bench, "SELECT count(*) FROM worker").await, 0);
        assert_eq!(count(&bench, "SELECT count(*) FROM maker").await, 1);
        for (now, before) in tiles(&bench, id).await.iter().zip(&before) {
            assert_eq!(now.leases[..], before.leases[before.leases.len() - 1..]);
            assert_eq!((now.state, now.attempts), (before.state, before.attempts));
        }
        assert_eq!(bench.queue.makers(id, 0).await.expect("reads").as_ref(), Some(&made));
    }
    bench.queue.delete(id).await.expect("deletes");
    while bench.queue.clean_up_piece().await.expect("cleans").is_some() {}
    assert_eq!(count(&bench, "SELECT count(*) FROM tile_maker").await, 0);
    bench.queue.prune().await.expect("prunes");
    assert_eq!(count(&bench, "SELECT count(*) FROM maker").await, 0);
}

#[tokio::test]
async fn the_last_result_of_a_tile_is_the_one_that_is_kept() {
    let bench = Fixture::new().await;
    let new = new_job(1);
    let id = new.id;
    bench.queue.submit(new).await.expect("accepted");
    let (first, second) = (bench.worker(None).await, bench.worker(None).await);
    let hash = blake3::hash(b"picture").to_hex().to_string();
    render(&bench, first, LeaseOutcome::Picture { hash: hash.clone(), size_bytes: 5 }).await;
    let is_first_forgotten = [false, true];
    for is_forgotten in is_first_forgotten {
        if is_forgotten {
            forget_leases(&bench).await;
        }
        bench.queue.forget_picture(&hash).await.expect("forgets");
        let worker = if is_forgotten { first } else { second };
        render(&bench, worker, LeaseOutcome::Picture { hash: hash.clone(), size_bytes: 5 }).await;
        forget_leases(&bench).await;
        for tile in tiles(&bench, id).await {
            assert_eq!(tile.leases.len(), 1, "{tile:?}");
            assert_eq!((tile.leases[0].worker, tile.leases[0].seconds.is_some()), (worker, true));
        }
    }
}
