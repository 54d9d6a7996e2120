//! Records of tiles: stored with the results that they belong to, and named to jobs that are based on theirs.

use proto::JobId;
use proto::worker_protocol::{LeaseOutcome, LeaseReport, TileRecord};

use super::{Fixture, NewJob, SyncInput, leases, new_job, turn, workers};

#[tokio::test]
async fn records_of_counted_results_are_named_to_later_jobs() {
    let bench = Fixture::new().await;
    let worker = bench.worker(None).await;
    let hash = |text: &str| blake3::hash(text.as_bytes()).to_hex().to_string();
    let first = NewJob { recorded: true, ..new_job(1) };
    let (id, records) = (first.id, ["right", "../../outside", "right, but of another lease", ""]);
    bench.queue.submit(first).await.expect("accepted");
    let run = workers::claim(&bench, worker).await.expect("work");
    assert!(run.recording.as_ref().is_some_and(|recording| recording.earlier.is_none()), "{run:?}");
    let reports = leases(&run).enumerate().map(|(index, lease)| LeaseReport {
        lease,
        outcome: LeaseOutcome::Blob { hash: hash(&format!("blob {index}")), size_bytes: 1 },
    });
    let received = leases(&run).zip(records).map(|(lease, name)| TileRecord {
        lease: if name.ends_with("lease") { proto::LeaseId::new() } else { lease },
        hash: if name.starts_with("right") { hash(name) } else { name.to_owned() },
        size_bytes: 1,
        kept: false,
    });
    let input = SyncInput { reports: reports.collect(), records: received.collect(), ..turn(worker) };
    bench.turn(input).await.expect("known");
    bench.check().await;
    workers::claim(&bench, worker).await.expect("the stitch");
    let later = NewJob { recorded: true, based_on: Some(id), ..new_job(1) };
    bench.queue.submit(later).await.expect("accepted");
    let run = workers::claim(&bench, worker).await.expect("work");
    let earlier = run.recording.expect("it is recorded").earlier.expect("a recorded tile");
    assert_eq!(earlier.job, id);
    let [tile] = &earlier.tiles[..] else { panic!("{earlier:?}") };
    assert_eq!((&tile.record, &tile.pixels.hash), (&hash("right"), &hash("blob 0")));
    // Without the earlier job, everything is rendered.
    let stranger = NewJob { recorded: true, based_on: Some(JobId::new()), ..new_job(1) };
    bench.queue.submit(stranger).await.expect("accepted");
    let run = workers::claim(&bench, worker).await.expect("work");
    assert!(run.recording.expect("it is recorded").earlier.is_none());
}
