//! Workers of one key are one witness: their word about a tile or a result counts once, and they send no more than their
//! leases need.

use proto::api_key::Scope;
use proto::job::{JobState, JobView};
use proto::pool::{WorkerList, WorkerState};
use proto::worker_protocol::{self, LeaseOutcome, LeaseReport};
use proto::{JobId, WorkerId};
use reqwest::{Method, StatusCode};

use super::harness::{Farm, LEASE, Said, Worker, in_time, leases, read, refused, small_job};
use super::keys::{locked_farm, locked_farm_with, make, new_key, send};

/// A farm with two keys for workers.
struct Keys {
    farm: Farm,
    admin: String,
    bad: String,
    good: String,
}

impl Keys {
    async fn of((farm, admin): (Farm, String)) -> Self {
        let bad = make(&farm, &admin, &new_key("bad", &[Scope::Worker])).await.secret;
        let good = make(&farm, &admin, &new_key("good", &[Scope::Worker])).await.secret;
        Self { farm, admin, bad, good }
    }

    async fn submit(&self, seed: u32) -> JobId {
        let posted = send(&self.farm, &self.admin, Method::POST, "/v1/jobs", small_job(seed).to_string()).await;
        read::<JobView>(posted, StatusCode::CREATED).await.id
    }

    async fn job(&self, id: JobId) -> JobView {
        let path = format!("/v1/jobs/{id}");
        read(send(&self.farm, &self.admin, Method::GET, &path, "").await, StatusCode::OK).await
    }

    async fn state(&self, worker: WorkerId) -> WorkerState {
        let list = send(&self.farm, &self.admin, Method::GET, "/v1/workers", "").await;
        let list: WorkerList = read(list, StatusCode::OK).await;
        list.workers.iter().find(|view| view.id == worker).expect("listed").state
    }

    /// Has workers fail whatever they get for longer than any back-off, while others are present.
    async fn fail(&self, workers: &[Worker<'_>], present: &[&Worker<'_>]) {
        for _ in 0..20 {
            self.farm.hand.advance(LEASE / 4);
            for worker in present {
                worker.report(Vec::new()).await;
            }
            for worker in workers {
                if let Some(run) = worker.claim().await {
                    let outcome = LeaseOutcome::Failed { message: "I do not want to".to_owned() };
                    let report = |lease| LeaseReport { lease, outcome: outcome.clone() };
                    worker.report(leases(&run).into_iter().map(report).collect()).await;
                }
            }
        }
    }
}

#[tokio::test]
async fn workers_of_one_key_kill_no_job_that_another_could_render_and_get_no_more() {
    let keys = Keys::of(locked_farm().await).await;
    let honest = keys.farm.worker_of(&keys.good, "honest").await;
    let mut liars = Vec::new();
    for number in 0..4 {
        liars.push(keys.farm.worker_of(&keys.bad, &format!("liar-{number}")).await);
    }
    for seed in 1..=3 {
        let id = keys.submit(seed).await;
        keys.fail(&liars, &[&honest]).await;
        assert_eq!(keys.job(id).await.state, JobState::Running, "job {seed}");
        assert!(honest.work_once().await);
        assert_eq!(keys.job(id).await.state, JobState::Succeeded);
    }
    for liar in &liars {
        assert_eq!(keys.state(liar.id).await, WorkerState::Quarantined);
    }
    let again = keys.farm.worker_of(&keys.bad, "again").await;
    assert_eq!(keys.state(again.id).await, WorkerState::Quarantined);
    assert_eq!(keys.state(keys.farm.worker_of(&keys.good, "another").await.id).await, WorkerState::Ready);
    let release = format!("/v1/workers/{}/release", again.id);
    let released = send(&keys.farm, &keys.admin, Method::POST, &release, "").await;
    assert_eq!(released.status(), StatusCode::OK, "{}", in_time(released.text()).await.expect("a body"));
    assert_eq!(keys.state(keys.farm.worker_of(&keys.bad, "trusted").await.id).await, WorkerState::Ready);
    keys.farm.stop().await;
}

#[tokio::test]
async fn workers_of_one_key_keep_no_tile_from_another() {
    let keys = Keys::of(locked_farm().await).await;
    let [first, second] =
        [keys.farm.worker_of(&keys.bad, "first").await, keys.farm.worker_of(&keys.bad, "second").await];
    let id = keys.submit(1).await;
    let mut held = vec![(&first, leases(&first.claim().await.expect("work")))];
    // Each renews its leases, and delivers nothing.
    for _ in 0..150 {
        keys.farm.hand.advance(LEASE / 4);
        for (worker, leases) in &held {
            worker.sync(Said { holding: leases.clone(), ..Said::default() }).await;
        }
        if held.len() == 1 {
            held.extend(second.claim().await.map(|run| (&second, leases(&run))));
        }
    }
    assert_eq!(held.len(), 2, "the second worker of the key has the tile, too");
    let honest = keys.farm.worker_of(&keys.good, "honest").await;
    assert!(honest.work_once().await, "two leases of one key are no reason to wait");
    assert_eq!(keys.job(id).await.state, JobState::Succeeded);
    keys.farm.stop().await;
}

#[tokio::test]
async fn a_job_that_fails_on_workers_of_two_keys_fails() {
    let keys = Keys::of(locked_farm().await).await;
    let workers = [
        keys.farm.worker_of(&keys.bad, "one").await,
        keys.farm.worker_of(&keys.bad, "two").await,
        keys.farm.worker_of(&keys.good, "three").await,
    ];
    let id = keys.submit(1).await;
    keys.fail(&workers, &[]).await;
    let job = keys.job(id).await;
    assert_eq!(job.state, JobState::Failed);
    assert_eq!(job.errors, ["frame 0 could not be rendered: I do not want to"]);
    keys.farm.stop().await;
}

#[tokio::test]
async fn a_worker_verifies_no_result_of_its_own_key_while_another_could() {
    let keys = Keys::of(locked_farm_with(|config| config.verify_share = 1.0).await).await;
    let [one, accomplice] =
        [keys.farm.worker_of(&keys.bad, "one").await, keys.farm.worker_of(&keys.bad, "accomplice").await];
    let honest = keys.farm.worker_of(&keys.good, "honest").await;
    let id = keys.submit(1).await;
    let run = one.claim().await.expect("work");
    one.report(one.picture(&leases(&run), b"a lie").await).await;
    assert!(accomplice.claim().await.is_none(), "the other key verifies it");
    let run = honest.claim().await.expect("the verification");
    honest.report(honest.results(&run).await).await;
    assert!(accomplice.claim().await.is_none(), "one of the two keys must not decide");
    let judge_key = make(&keys.farm, &keys.admin, &new_key("judge", &[Scope::Worker])).await.secret;
    let judge = keys.farm.worker_of(&judge_key, "judge").await;
    assert!(judge.work_once().await, "a third key decides");
    assert_eq!(keys.state(one.id).await, WorkerState::Quarantined);
    assert_eq!(keys.state(honest.id).await, WorkerState::Ready);
    while honest.work_once().await || accomplice.work_once().await || judge.work_once().await {}
    assert_eq!(keys.job(id).await.state, JobState::Succeeded);
    keys.farm.stop().await;
}

#[tokio::test]
async fn a_key_sends_no_more_than_its_leases_need() {
    let keys = Keys::of(locked_farm().await).await;
    let worker = keys.farm.worker_of(&keys.bad, "one").await;
    let put = |path: String, bytes: Vec<u8>| {
        let (farm, key) = (&keys.farm, &keys.bad);
        async move { send(farm, key, Method::PUT, &path, bytes).await }
    };
    let picture = |bytes: &[u8]| worker_protocol::picture_path(blake3::hash(bytes).to_hex().as_str());
    let blob = |bytes: &[u8]| worker_protocol::blob_path(blake3::hash(bytes).to_hex().as_str());
    let id = keys.submit(1).await;
    let run = worker.claim().await.expect("work");
    let huge = vec![1; 1 << 20];
    refused(put(picture(&huge), huge.clone()).await, 413, "too_large").await;
    refused(put(blob(&huge), huge).await, 413, "too_large").await;
    // The lease is of 64 × 64 pixels.
    let mut stored = 0;
    let full = loop {
        let junk = vec![stored; 200_000];
        let answer = put(picture(&junk), junk).await;
        if answer.status() != StatusCode::NO_CONTENT {
            break answer;
        }
        stored += 1;
    };
    refused(full, 413, "unneeded_bytes").await;
    assert!((2..10).contains(&stored), "{stored} pictures were stored");
    tokio::time::sleep(std::time::Duration::from_secs(6)).await;
    worker.report(worker.results(&run).await).await;
    assert_eq!(keys.job(id).await.state, JobState::Succeeded, "old junk makes room");
    keys.farm.stop().await;
}
