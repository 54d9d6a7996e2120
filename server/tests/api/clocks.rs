//! Jumps of the wall clock, set by a person or a time service: they affect no lease, job or worker.

use std::time::Duration;

use proto::job::JobState;

use super::harness::{Farm, LEASE, Said, assert_state, leases, small_job};

const YEAR_MS: i64 = 365 * 24 * 3_600_000;

#[tokio::test]
async fn a_jump_of_the_wall_clock_expires_no_lease() {
    let farm = Farm::start().await;
    let id = farm.submit(&small_job(1)).await.id;
    let worker = farm.worker("w").await;
    let run = worker.claim().await.expect("a run");
    for jump_ms in [YEAR_MS, -3 * YEAR_MS, 5 * YEAR_MS] {
        farm.hand.shift_wall_clock(jump_ms);
        farm.hand.advance(Duration::from_secs(1));
        let reply = worker.sync(Said { holding: leases(&run), ..Said::default() }).await;
        assert_eq!(reply.revoked_leases, [], "a jump of {jump_ms} ms ended a lease");
    }
    let results = worker.results(&run).await;
    assert_eq!(worker.report(results).await.revoked_leases, []);
    assert_state(&farm, id, JobState::Succeeded).await;
    farm.stop().await;
}

#[tokio::test]
async fn a_wall_clock_set_back_extends_no_lease() {
    let farm = Farm::start().await;
    let id = farm.submit(&small_job(2)).await.id;
    let sleeper = farm.worker("sleeper").await;
    let run = sleeper.claim().await.expect("a run");
    farm.hand.shift_wall_clock(-YEAR_MS);
    farm.hand.advance(2 * LEASE);
    let heir = farm.worker("heir").await;
    assert!(heir.work_once().await, "the expired tile is leased again");
    assert_state(&farm, id, JobState::Succeeded).await;
    let late = sleeper.try_sync(Said { holding: leases(&run), ..Said::default() }).await;
    assert!(late.status() == 404 || late.text().await.is_ok_and(|reply| reply.contains(&leases(&run)[0].to_string())));
    farm.stop().await;
}
