//! The farm's throughput by minutes.

use std::time::Duration;

use proto::history::{HistoryPoint, HistoryView};
use reqwest::StatusCode;

use super::harness::{Farm, in_time, job, leases, read, refused, small_job};

async fn history(farm: &Farm, query: &str) -> HistoryView {
    read(farm.get(&format!("/v1/history{query}")).await, StatusCode::OK).await
}

/// Lets a minute pass, and waits until it is recorded.
async fn pass_minute(farm: &Farm) -> HistoryPoint {
    farm.hand.advance(Duration::from_mins(1));
    in_time(async {
        loop {
            let mut last = history(farm, "?seconds=60").await.points;
            assert_eq!(last.len(), 1);
            let point = last.remove(0);
            if point.jobs_queued + point.jobs_running > 0.0 {
                return point;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    })
    .await
}

#[tokio::test]
async fn each_minute_has_what_was_rendered_in_it_also_after_a_restart() {
    let farm = Farm::start().await;
    farm.submit(&job(3072, 1024, 2)).await;
    let idle = pass_minute(&farm).await;
    assert_eq!((idle.rays, idle.tiles, idle.frames, idle.jobs_queued, idle.busy), (0, 0, 0, 1.0, 0.0));
    assert_eq!((idle.at.as_str(), idle.workers), ("1970-01-01T00:00:00.000Z", 0.0));
    assert!(idle.queued_tiles > 0.0);
    let worker = farm.worker("one").await;
    let run = worker.claim().await.expect("work");
    let tiles = leases(&run).len() as u64;
    worker.report(worker.results(&run).await).await;
    let busy = pass_minute(&farm).await;
    assert_eq!((busy.tiles, busy.frames, busy.jobs_running), (tiles, 0, 1.0));
    assert!(busy.rays > 0);
    let worker = farm.worker("two").await;
    worker.work_off().await;
    farm.submit(&small_job(1)).await;
    let last = pass_minute(&farm).await;
    assert_eq!((last.frames, last.jobs_queued), (1, 1.0));
    assert_eq!(last.rays + busy.rays, 3072 * 1024 * 2);

    let whole = history(&farm, "?seconds=180&points=1").await;
    assert_eq!((whole.step_seconds, whole.points.len()), (180, 1));
    assert_eq!((whole.points[0].rays, whole.points[0].frames), (3072 * 1024 * 2, 1));
    assert_eq!(whole.points[0].tiles, busy.tiles + last.tiles);
    let hour = history(&farm, "").await;
    assert_eq!((hour.step_seconds, hour.points.len()), (60, 60));
    let recorded = hour.points[57..].iter().map(|point| point.rays).collect::<Vec<_>>();
    assert_eq!(recorded, [0, busy.rays, last.rays]);
    let week = history(&farm, "?seconds=604800&points=100").await;
    assert_eq!((week.step_seconds, week.points.len()), (101 * 60, 100));
    for query in ["seconds=59", "seconds=604801", "points=0", "points=1001", "minutes=1"] {
        refused(farm.get(&format!("/v1/history?{query}")).await, 422, "wrong_query").await;
    }

    // The clock of a test starts again with the server: the rows stay.
    let farm = Farm::start_in(farm.stop().await, |_| {}).await;
    farm.hand.advance(Duration::from_mins(3));
    let points = history(&farm, "?seconds=180").await.points;
    assert_eq!(points.iter().map(|point| point.rays).collect::<Vec<_>>(), recorded);
    farm.stop().await;
}
