//! Moved jobs: each is rendered at its place, also after more moves than places fit between two.

use proto::JobId;
use proto::job::JobState;

use super::{Fixture, NewJob, new_job};
use crate::queue::{QueuePosition, ReorderOutcome};

/// Jobs in the order of their places.
async fn queued(bench: &Fixture) -> Vec<JobId> {
    let mut jobs = bench.queue.jobs(None, None, 1000, None).await.expect("lists").jobs;
    jobs.sort_by_key(|job| job.queue_position.expect("it waits"));
    let positions: Vec<_> = jobs.iter().map(|job| job.queue_position.expect("it waits")).collect();
    assert!(positions.into_iter().eq(1..=jobs.len() as u32));
    jobs.into_iter().map(|job| job.id).collect()
}

async fn reorder_job(bench: &Fixture, job: JobId, place: QueuePosition) {
    let moved = bench.queue.reorder_job(job, place, 0).await.expect("moves");
    assert_eq!(moved, ReorderOutcome::Done);
    bench.check().await;
}

#[tokio::test]
async fn jobs_are_claimed_in_the_order_they_were_moved_to() {
    let bench = Fixture::new().await;
    let mut expected = Vec::new();
    for _ in 0..6 {
        expected.push(bench.submit(1, 1).await);
    }
    assert_eq!(queued(&bench).await, expected);
    // Twice as many moves as halves fit between two places, in all directions.
    for step in 0..60_usize {
        let (from, to) = (step * 7 % 6, step * 5 % 6);
        let (job, other) = (expected[from], expected[to]);
        let place = match step % 3 {
            0 => QueuePosition::Before(other),
            1 => QueuePosition::After(other),
            _ => QueuePosition::First,
        };
        reorder_job(&bench, job, place).await;
        if job != other || place == QueuePosition::First {
            expected.remove(from);
            let at = |wanted: JobId, jobs: &[JobId]| jobs.iter().position(|job| *job == wanted).expect("listed");
            let index = match place {
                QueuePosition::Before(other) => at(other, &expected),
                QueuePosition::After(other) => at(other, &expected) + 1,
                QueuePosition::First => 0,
            };
            expected.insert(index, job);
        }
        assert_eq!(queued(&bench).await, expected, "step {step}");
    }
    // Always between the same two.
    for _ in 0..50 {
        let last = expected.pop().expect("six jobs");
        reorder_job(&bench, last, QueuePosition::Before(expected[1])).await;
        expected.insert(1, last);
        assert_eq!(queued(&bench).await, expected);
    }
    // A later job comes after all of them.
    expected.push(bench.submit(1, 1).await);
    assert_eq!(queued(&bench).await, expected);
    let worker = bench.worker(None).await;
    for job in expected {
        assert_eq!(super::workers::claim(&bench, worker).await.expect("work").job, job);
    }
}

#[tokio::test]
async fn a_job_beside_another_takes_its_priority() {
    let bench = Fixture::new().await;
    let urgent = bench.queue.submit(NewJob { priority: 5, ..new_job(1) }).await;
    urgent.expect("accepted");
    let first = queued(&bench).await[0];
    let job = bench.submit(1, 1).await;
    assert_eq!(
        bench.queue.reorder_job(job, QueuePosition::Before(first), 5).await.expect("moves"),
        ReorderOutcome::Done
    );
    assert_eq!(queued(&bench).await, [job, first]);
    assert_eq!(bench.queue.job(job).await.expect("reads").expect("there").priority, 5);
    bench.check().await;
    let stranger = JobId::new();
    for place in [QueuePosition::Before(stranger), QueuePosition::After(stranger)] {
        assert_eq!(bench.queue.reorder_job(job, place, 0).await.expect("answers"), ReorderOutcome::Unknown(stranger));
    }
    assert_eq!(
        bench.queue.reorder_job(stranger, QueuePosition::First, 0).await.expect("answers"),
        ReorderOutcome::Unknown(stranger)
    );
    bench.queue.cancel(first).await.expect("cancels");
    let finished = ReorderOutcome::Finished(first, JobState::Cancelled);
    assert_eq!(bench.queue.reorder_job(job, QueuePosition::After(first), 0).await.expect("answers"), finished);
    assert_eq!(bench.queue.reorder_job(first, QueuePosition::First, 0).await.expect("answers"), finished);
}
