//! Tiles of a job and their workers.

use std::time::Duration;

use proto::JobId;
use proto::tile_history::{TileOutcome, TilePage, TileState};
use proto::worker_protocol::{LeaseOutcome, LeaseReport};
use reqwest::StatusCode;

use super::harness::{Farm, Said, job, leases, read, refused};

async fn page(farm: &Farm, job: JobId, query: &str) -> TilePage {
    read(farm.get(&format!("/v1/jobs/{job}/tiles{query}")).await, StatusCode::OK).await
}

#[tokio::test]
async fn each_tile_shows_who_had_it_and_when() {
    let farm = Farm::start().await;
    let posted = farm.submit(&job(3072, 1024, 2)).await;
    assert!(page(&farm, posted.id, "").await.tiles.is_empty(), "no frame is opened yet");
    let (first, second) = (farm.worker("first").await, farm.worker("second").await);
    let failing = first.claim().await.expect("work");
    farm.hand.advance(Duration::from_millis(300));
    let outcome = LeaseOutcome::Failed { message: "no".to_owned() };
    first
        .report(leases(&failing).into_iter().map(|lease| LeaseReport { lease, outcome: outcome.clone() }).collect())
        .await;
    farm.hand.advance(Duration::from_secs(10));
    first.sync(Said::default()).await;
    let again = second.claim().await.expect("work");
    farm.hand.advance(Duration::from_millis(500));
    let open = page(&farm, posted.id, "").await;
    let held = open.tiles.iter().find(|tile| tile.state == TileState::Leased).expect("a leased tile");
    let live = held.leases.last().expect("its lease");
    assert_eq!((live.worker, live.worker_name.as_str(), live.device.as_str()), (second.id, "second", "cpu"));
    assert_eq!((live.started_at.as_str(), &live.ended_at, live.outcome), ("1970-01-01T00:00:10.300Z", &None, None));
    let failed: Vec<_> =
        open.tiles.iter().flat_map(|tile| &tile.leases).filter(|lease| lease.worker == first.id).collect();
    assert_eq!(failed.len(), leases(&failing).len());
    assert_eq!((failed[0].outcome, failed[0].seconds), (Some(TileOutcome::Failed), None));
    assert_eq!(failed[0].started_at, "1970-01-01T00:00:00.000Z");
    assert_eq!(failed[0].ended_at.as_deref(), Some("1970-01-01T00:00:00.300Z"));
    second.report(second.results(&again).await).await;
    let (x, y) = (held.x, held.y);
    let done = page(&farm, posted.id, "").await;
    let tile = done.tiles.iter().find(|tile| (tile.x, tile.y) == (x, y)).expect("the same tile");
    let lease = tile.leases.last().expect("its lease");
    assert_eq!((tile.state, tile.attempts), (TileState::Done, tile.leases.len() as u64));
    assert_eq!((lease.outcome, lease.ended_at.as_deref()), (Some(TileOutcome::Done), Some("1970-01-01T00:00:10.800Z")));
    assert_eq!(lease.seconds, Some(0.5 / leases(&again).len() as f64));
    farm.stop().await;
}

#[tokio::test]
async fn tiles_come_by_pages_and_by_frame() {
    let farm = Farm::start().await;
    let mut animation = job(3072, 1024, 2);
    animation["frames"] = serde_json::json!({ "count": 2, "fps": 24 });
    let posted = farm.submit(&animation).await;
    let worker = farm.worker("one").await;
    worker.work_off().await;
    let all = page(&farm, posted.id, "").await;
    assert_eq!((all.tiles.len() as u64, &all.next_cursor), (posted.tiles.total, &None));
    let mut paged = Vec::new();
    let mut query = "?limit=2".to_owned();
    loop {
        let next = page(&farm, posted.id, &query).await;
        assert!(next.tiles.len() <= 2);
        paged.extend(next.tiles);
        let Some(cursor) = next.next_cursor else { break };
        query = format!("?limit=2&cursor={cursor}");
    }
    assert_eq!(paged, all.tiles);
    let of_frame = page(&farm, posted.id, "?frame=1").await.tiles;
    assert_eq!(of_frame, all.tiles.iter().filter(|tile| tile.frame == 1).cloned().collect::<Vec<_>>());
    assert!(!of_frame.is_empty());
    for query in ["limit=0", "limit=1001", "cursor=x", "cursor=1", "frame=x", "page=1"] {
        refused(farm.get(&format!("/v1/jobs/{}/tiles?{query}", posted.id)).await, 422, "wrong_query").await;
    }
    refused(farm.get(&format!("/v1/jobs/{}/tiles", JobId::new())).await, 404, "unknown_job").await;
    farm.stop().await;
}
