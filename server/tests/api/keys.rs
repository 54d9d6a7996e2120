//! API keys: authorization, revocation, limits, and the audit log.

use std::time::Duration;

use futures_util::future::join_all;
use proto::api_key::{ApiKeyList, ApiKeyState, IssuedApiKey, NewApiKey, Scope};
use proto::audit::AuditPage;
use proto::worker_protocol;
use reqwest::header::AUTHORIZATION;
use reqwest::{Method, Response, StatusCode};
use serde_json::{Value, json};
use server::{Config, OfflineApiKeys};

use super::harness::{Farm, config, in_time, read, refused, small_job};

/// Request for a key, with defaults for the rest.
pub(crate) fn new_key(name: &str, scopes: &[Scope]) -> NewApiKey {
    NewApiKey {
        name: name.to_owned(),
        scopes: scopes.to_vec(),
        expires_in_seconds: None,
        max_jobs: None,
        max_rays: None,
        requests_per_second: None,
        max_priority: None,
    }
}

/// A farm that has one key, with scope admin.
pub(crate) async fn locked_farm() -> (Farm, String) {
    locked_farm_with(|_| {}).await
}

/// A farm that has one key, with scope admin, and this configuration.
pub(crate) async fn locked_farm_with(change: impl FnOnce(&mut Config)) -> (Farm, String) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut keys =
        OfflineApiKeys::open_or_create(folder.path(), config(folder.path()).database).await.expect("a folder of keys");
    let admin = keys.create(new_key("root", &[Scope::Admin])).await.expect("a key").secret;
    keys.close().await.expect("closes");
    (Farm::start_in(folder, change).await, admin)
}

/// Sends a request with a key.
pub(crate) async fn send(
    farm: &Farm,
    key: &str,
    method: Method,
    path: &str,
    body: impl Into<reqwest::Body>,
) -> Response {
    let request = farm.client.request(method, farm.url(path)).header(AUTHORIZATION, format!("Bearer {key}")).body(body);
    in_time(request.send()).await.expect("the server responds")
}

/// Creates a key over HTTP.
pub(crate) async fn make(farm: &Farm, admin: &str, new: &NewApiKey) -> IssuedApiKey {
    let body = serde_json::to_string(new).expect("JSON");
    read(send(farm, admin, Method::POST, "/v1/keys", body).await, StatusCode::CREATED).await
}

#[tokio::test]
async fn a_farm_with_keys_rejects_requests_without_one() {
    let (farm, admin) = locked_farm().await;
    let none = farm.get("/v1/jobs").await;
    assert_eq!(none.headers()["www-authenticate"], "Bearer");
    refused(none, 401, "missing_key").await;
    for (key, code) in [("nonsense", "unknown_key"), ("", "unknown_key"), (&*format!("{admin}x"), "unknown_key")] {
        let answer = send(&farm, key, Method::GET, "/v1/jobs", "").await;
        assert_eq!(answer.headers()["www-authenticate"], "Bearer error=\"invalid_token\"");
        refused(answer, 401, code).await;
    }
    assert_eq!(send(&farm, &admin, Method::GET, "/v1/jobs", "").await.status(), StatusCode::OK);
    for open in ["/livez", "/readyz", "/docs/", "/openapi.json", "/v1/schema/job"] {
        assert_eq!(farm.get(open).await.status(), StatusCode::OK, "{open}");
    }
    refused(farm.post(worker_protocol::REGISTER_PATH, "{}").await, 401, "missing_key").await;
    farm.stop().await;
}

#[tokio::test]
async fn a_submitter_reads_and_cancels_only_its_own_jobs() {
    let (farm, admin) = locked_farm().await;
    let anna = make(&farm, &admin, &new_key("anna", &[Scope::Submit])).await.secret;
    let bert = make(&farm, &admin, &new_key("bert", &[Scope::Submit, Scope::Read])).await.secret;
    let job: Value =
        read(send(&farm, &anna, Method::POST, "/v1/jobs", small_job(1).to_string()).await, StatusCode::CREATED).await;
    let path = format!("/v1/jobs/{}", job["id"].as_str().expect("an id"));
    assert_eq!(send(&farm, &anna, Method::GET, &path, "").await.status(), StatusCode::OK);
    assert_eq!(send(&farm, &bert, Method::GET, &path, "").await.status(), StatusCode::OK);
    let denied = send(&farm, &bert, Method::POST, &format!("{path}/cancel"), "").await;
    assert_eq!(denied.headers()["www-authenticate"], "Bearer error=\"insufficient_scope\", scope=\"admin\"");
    refused(denied, 403, "missing_scope").await;
    refused(send(&farm, &anna, Method::GET, "/v1/workers", "").await, 403, "missing_scope").await;
    assert_eq!(send(&farm, &anna, Method::POST, &format!("{path}/cancel"), "").await.status(), StatusCode::OK);
    assert_eq!(send(&farm, &anna, Method::DELETE, &path, "").await.status(), StatusCode::NO_CONTENT);
    farm.stop().await;
}

#[tokio::test]
async fn a_name_has_at_most_two_live_keys() {
    let (farm, admin) = locked_farm().await;
    let old = make(&farm, &admin, &new_key("anna", &[Scope::Read])).await;
    let new = make(&farm, &admin, &new_key("anna", &[Scope::Read])).await;
    let body = serde_json::to_string(&new_key("anna", &[Scope::Read])).expect("JSON");
    let third = refused(send(&farm, &admin, Method::POST, "/v1/keys", body.clone()).await, 409, "too_many_keys").await;
    assert!(third.detail.contains("sdfarm key revoke"), "{third:?}");
    for secret in [&old.secret, &new.secret] {
        assert_eq!(send(&farm, secret, Method::GET, "/v1/jobs", "").await.status(), StatusCode::OK);
    }
    let path = format!("/v1/keys/{}", old.key.id);
    let revoked: ApiKeyList = read(send(&farm, &admin, Method::DELETE, &path, "").await, StatusCode::OK).await;
    assert_eq!(
        revoked.keys.iter().map(|key| (&key.id, key.state)).collect::<Vec<_>>(),
        [(&old.key.id, ApiKeyState::Revoked)]
    );
    refused(send(&farm, &old.secret, Method::GET, "/v1/jobs", "").await, 401, "revoked_key").await;
    assert_eq!(send(&farm, &new.secret, Method::GET, "/v1/jobs", "").await.status(), StatusCode::OK);
    refused(send(&farm, &admin, Method::DELETE, &path, "").await, 404, "no_such_key").await;
    assert_eq!(send(&farm, &admin, Method::POST, "/v1/keys", body).await.status(), StatusCode::CREATED);
    farm.stop().await;
}

#[tokio::test]
async fn the_first_key_must_have_scope_admin() {
    let farm = Farm::start().await;
    let worker = serde_json::to_string(&new_key("host-7", &[Scope::Worker])).expect("JSON");
    let problem = refused(farm.post("/v1/keys", worker.clone()).await, 422, "wrong_key").await;
    assert!(problem.detail.contains("sdfarm key new admin --scope admin"), "{problem:?}");
    let mut keys = OfflineApiKeys::open(farm.folder.path(), None).await.expect("the folder is there");
    let error = keys
        .create(new_key("anna", &[Scope::Submit, Scope::Read]))
        .await
        .expect_err("no key could administer the farm");
    assert!(error.to_string().contains("--scope admin"), "{error}");
    assert!(keys.list().await.expect("reads").is_empty());
    assert_eq!(farm.get("/v1/jobs").await.status(), StatusCode::OK, "the farm still requires no key");
    let admin = keys.create(new_key("admin", &[Scope::Admin])).await.expect("a key").secret;
    keys.create(new_key("anna", &[Scope::Read])).await.expect("a second key needs no scope admin");
    keys.close().await.expect("closes");
    in_time(async {
        while farm.get("/v1/jobs").await.status() != StatusCode::UNAUTHORIZED {
            tokio::task::yield_now().await;
        }
    })
    .await;
    assert_eq!(send(&farm, &admin, Method::POST, "/v1/keys", worker).await.status(), StatusCode::CREATED);
    farm.stop().await;
}

#[tokio::test]
async fn a_key_expires_by_the_clock() {
    let (farm, admin) = locked_farm().await;
    let hour = NewApiKey { expires_in_seconds: Some(3600), ..new_key("anna", &[Scope::Read]) };
    let key = make(&farm, &admin, &hour).await.secret;
    assert_eq!(send(&farm, &key, Method::GET, "/v1/jobs", "").await.status(), StatusCode::OK);
    farm.hand.advance(Duration::from_hours(1));
    refused(send(&farm, &key, Method::GET, "/v1/jobs", "").await, 401, "expired_key").await;
    farm.stop().await;
}

#[tokio::test]
async fn a_waiting_worker_ends_when_its_key_is_revoked() {
    let (farm, admin) = locked_farm().await;
    let key = make(&farm, &admin, &new_key("host-7", &[Scope::Worker])).await;
    let hello = json!({"name": "w", "device": "cpu", "picture_version": scene::PICTURE_VERSION, "max_nodes": null, "process": 1});
    let welcome: worker_protocol::RegisterResponse = read(
        send(&farm, &key.secret, Method::POST, worker_protocol::REGISTER_PATH, hello.to_string()).await,
        StatusCode::OK,
    )
    .await;
    let wait = json!({"worker": welcome.worker, "rays_per_second": null, "held_leases": [], "reports": [],
        "wants_work": true, "wait_ms": 30_000});
    let waiting = send(&farm, &key.secret, Method::POST, worker_protocol::SYNC_PATH, wait.to_string());
    let revoke = async {
        // Revoked on the data folder, as the command line does; the server has to notice without a request.
        let mut keys = OfflineApiKeys::open(farm.folder.path(), None).await.expect("the folder is there");
        let revoked = keys.revoke("host-7").await.expect("it is live");
        keys.close().await.expect("closes");
        assert_eq!(revoked.len(), 1);
    };
    let (answer, ()) = tokio::join!(waiting, revoke);
    refused(answer, 401, "revoked_key").await;
    refused(
        send(&farm, &key.secret, Method::POST, worker_protocol::SYNC_PATH, wait.to_string()).await,
        401,
        "revoked_key",
    )
    .await;
    farm.stop().await;
}

#[tokio::test]
async fn keys_created_offline_work_on_the_running_server() {
    let farm = Farm::start().await;
    assert_eq!(farm.get("/v1/jobs").await.status(), StatusCode::OK);
    let mut keys = OfflineApiKeys::open(farm.folder.path(), None).await.expect("the folder is there");
    let secret = keys.create(new_key("anna", &[Scope::Admin])).await.expect("a key").secret;
    in_time(async {
        while farm.get("/v1/jobs").await.status() != StatusCode::UNAUTHORIZED {
            tokio::task::yield_now().await;
        }
    })
    .await;
    assert_eq!(send(&farm, &secret, Method::GET, "/v1/jobs", "").await.status(), StatusCode::OK);
    keys.revoke("anna").await.expect("it is live");
    keys.close().await.expect("closes");
    // A farm that had a key still requires one after the last has been revoked.
    in_time(async {
        while send(&farm, &secret, Method::GET, "/v1/jobs", "").await.status() != StatusCode::UNAUTHORIZED {
            tokio::task::yield_now().await;
        }
    })
    .await;
    refused(farm.get("/v1/jobs").await, 401, "missing_key").await;
    farm.stop().await;
}

#[tokio::test]
async fn invalid_keys_are_rejected_with_the_fix() {
    let (farm, admin) = locked_farm().await;
    for (body, code) in [
        (json!({"name": "", "scopes": ["read"]}), "wrong_key"),
        (json!({"name": "a b", "scopes": ["read"]}), "wrong_key"),
        (json!({"name": "local", "scopes": ["read"]}), "wrong_key"),
        (json!({"name": "*", "scopes": ["read"]}), "wrong_key"),
        (json!({"name": "x".repeat(65), "scopes": ["read"]}), "wrong_key"),
        (json!({"name": "anna", "scopes": []}), "wrong_key"),
        (json!({"name": "anna", "scopes": ["read"], "expires_in_seconds": 0}), "wrong_key"),
        (json!({"name": "anna", "scopes": ["read"], "expires_in_seconds": u64::MAX}), "wrong_key"),
        (json!({"name": "anna", "scopes": ["read"], "requests_per_second": 0}), "wrong_key"),
        (json!({"name": "anna", "scopes": ["root"]}), "wrong_body"),
        (json!({"name": "anna"}), "wrong_body"),
        (json!({"name": "anna", "scopes": ["read"], "color": 1}), "wrong_body"),
    ] {
        refused(send(&farm, &admin, Method::POST, "/v1/keys", body.to_string()).await, 422, code).await;
    }
    farm.stop().await;
}

#[tokio::test]
async fn quotas_and_rates_are_enforced_with_retry_after() {
    let (farm, admin) = locked_farm().await;
    let key = NewApiKey { max_jobs: Some(2), ..new_key("anna", &[Scope::Submit]) };
    let anna = make(&farm, &admin, &key).await.secret;
    let submit = async |key: &str, job: Value| send(&farm, key, Method::POST, "/v1/jobs", job.to_string()).await;
    let first: Value = read(submit(&anna, small_job(1)).await, StatusCode::CREATED).await;
    assert_eq!(submit(&anna, small_job(2)).await.status(), StatusCode::CREATED);
    let full = submit(&anna, small_job(3)).await;
    assert_eq!(full.headers()["retry-after"], "10");
    refused(full, 429, "quota").await;
    assert_eq!(submit(&admin, small_job(3)).await.status(), StatusCode::CREATED);
    let cancel = format!("/v1/jobs/{}/cancel", first["id"].as_str().expect("an id"));
    assert_eq!(send(&farm, &anna, Method::POST, &cancel, "").await.status(), StatusCode::OK);
    assert_eq!(submit(&anna, small_job(3)).await.status(), StatusCode::CREATED);

    let key = NewApiKey { max_rays: Some(5000), ..new_key("bert", &[Scope::Submit]) };
    let bert = make(&farm, &admin, &key).await.secret;
    assert_eq!(submit(&bert, small_job(1)).await.status(), StatusCode::CREATED);
    refused(submit(&bert, small_job(2)).await, 429, "quota").await;

    let key = NewApiKey { requests_per_second: Some(1), ..new_key("carl", &[Scope::Read]) };
    let carl = make(&farm, &admin, &key).await.secret;
    let first = send(&farm, &carl, Method::GET, "/v1/jobs", "").await;
    assert_eq!(first.headers()["ratelimit-policy"], "\"requests\";q=1;w=1");
    // If the machine stalls for 1 s between two of these requests, the next one is permitted again.
    let mut limited = None;
    for _ in 0..50 {
        let answer = send(&farm, &carl, Method::GET, "/v1/jobs", "").await;
        if answer.status() == StatusCode::TOO_MANY_REQUESTS {
            limited = Some(answer);
            break;
        }
    }
    let limited = limited.expect("the second request within 1 s exceeds the rate");
    assert_eq!(limited.headers()["retry-after"], "1");
    refused(limited, 429, "too_many_requests").await;
    farm.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn concurrent_submissions_do_not_exceed_a_limit_together() {
    let (farm, admin) = locked_farm().await;
    let jobs = NewApiKey { max_jobs: Some(1), ..new_key("anna", &[Scope::Submit]) };
    let rays = NewApiKey { max_rays: Some(64 * 64), ..new_key("bert", &[Scope::Submit]) };
    for limited in [jobs, rays] {
        let key = make(&farm, &admin, &limited).await.secret;
        let submissions = (0..50).map(|seed| send(&farm, &key, Method::POST, "/v1/jobs", small_job(seed).to_string()));
        let mut accepted = 0;
        for response in join_all(submissions).await {
            match response.status() {
                StatusCode::CREATED => accepted += 1,
                _ => drop(refused(response, 429, "quota").await),
            }
        }
        assert_eq!(accepted, 1, "{}", limited.name);
    }
    farm.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn concurrent_submissions_do_not_overfill_the_queue() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let farm = Farm::start_in(folder, |config| config.max_queued_jobs = 3).await;
    let submissions = (0..50).map(|seed| farm.post("/v1/jobs", small_job(seed).to_string()));
    let responses = join_all(submissions).await;
    assert_eq!(responses.iter().filter(|response| response.status() == StatusCode::CREATED).count(), 3);
    for response in responses.into_iter().filter(|response| response.status() != StatusCode::CREATED) {
        refused(response, 429, "queue_full").await;
    }
    farm.stop().await;
}

#[tokio::test]
async fn a_full_queue_rejects_before_the_body_is_read() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let farm = Farm::start_in(folder, |config| config.max_queued_jobs = 1).await;
    farm.submit(&small_job(1)).await;
    let full = farm.post("/v1/jobs", "not even JSON").await;
    assert_eq!(full.headers()["retry-after"], "10");
    refused(full, 429, "queue_full").await;
    farm.worker("one").await.work_off().await;
    farm.submit(&small_job(2)).await;
    farm.stop().await;
}

#[tokio::test]
async fn the_audit_log_has_changes_and_rejections() {
    let (farm, admin) = locked_farm().await;
    let anna = make(&farm, &admin, &new_key("anna", &[Scope::Submit])).await;
    let job: Value =
        read(send(&farm, &anna.secret, Method::POST, "/v1/jobs", small_job(1).to_string()).await, StatusCode::CREATED)
            .await;
    refused(send(&farm, &anna.secret, Method::PUT, "/v1/pool", "{}").await, 403, "missing_scope").await;
    refused(farm.get("/v1/jobs").await, 401, "missing_key").await;
    refused(send(&farm, &anna.secret, Method::GET, "/v1/audit", "").await, 403, "missing_scope").await;
    let page: AuditPage = in_time(async {
        loop {
            let page: AuditPage = read(send(&farm, &admin, Method::GET, "/v1/audit", "").await, StatusCode::OK).await;
            if page.entries.len() >= 6 {
                return page;
            }
            tokio::task::yield_now().await;
        }
    })
    .await;
    let received: Vec<_> = page
        .entries
        .iter()
        .rev()
        .map(|entry| (&*entry.who, &*entry.method, &*entry.route, entry.status, entry.code.as_deref()))
        .collect();
    assert_eq!(
        received,
        [
            // The first key was created on the server's machine.
            ("local", "POST", "/v1/keys", 201, None),
            ("root", "POST", "/v1/keys", 201, None),
            ("anna", "POST", "/v1/jobs", 201, None),
            ("anna", "PUT", "/v1/pool", 403, Some("missing_scope")),
            ("-", "GET", "/v1/jobs", 401, Some("missing_key")),
            ("anna", "GET", "/v1/audit", 403, Some("missing_scope")),
        ]
    );
    let submit = &page.entries[3];
    assert_eq!(submit.job.map(|id| id.to_string()).as_deref(), job["id"].as_str());
    assert_eq!((submit.key.as_deref(), submit.times), (Some(&*anna.key.id), 1));
    let one: AuditPage = read(send(&farm, &admin, Method::GET, "/v1/audit?limit=1", "").await, StatusCode::OK).await;
    assert_eq!((one.entries.len(), one.next_cursor.is_some()), (1, true));
    farm.stop().await;
}

#[tokio::test]
async fn a_public_address_is_rejected_until_a_key_exists() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let exposed = || {
        let mut config = config(folder.path());
        config.listen = ([0, 0, 0, 0], 0).into();
        server::Server::start(config)
    };
    let error = exposed().await.expect_err("there is no key").to_string();
    assert!(error.contains("sdfarm key new") && error.contains("--insecure"), "{error}");
    let mut keys = OfflineApiKeys::open(folder.path(), None).await.expect("a folder of keys");
    keys.create(new_key("root", &[Scope::Admin])).await.expect("a key");
    keys.close().await.expect("closes");
    exposed().await.expect("there is a key");
}

#[tokio::test]
async fn a_submitter_lists_only_jobs_of_its_name() {
    let (farm, admin) = locked_farm().await;
    let mut ids = Vec::new();
    for name in ["anna", "bert"] {
        let key = make(&farm, &admin, &new_key(name, &[Scope::Submit])).await.secret;
        let job = send(&farm, &key, Method::POST, "/v1/jobs", small_job(1).to_string()).await;
        let job: Value = read(job, StatusCode::CREATED).await;
        for path in ["/v1/jobs", "/v1/jobs?state=queued", "/v1/jobs?limit=1"] {
            let page: Value = read(send(&farm, &key, Method::GET, path, "").await, StatusCode::OK).await;
            let listed: Vec<&Value> = page["jobs"].as_array().expect("jobs").iter().map(|job| &job["id"]).collect();
            assert_eq!(listed, [&job["id"]], "{name} {path}");
            assert_eq!(page["next_cursor"], Value::Null, "{name} {path}");
        }
        ids.push(job["id"].clone());
    }
    let reader = make(&farm, &admin, &new_key("reader", &[Scope::Read])).await.secret;
    let page: Value = read(send(&farm, &reader, Method::GET, "/v1/jobs", "").await, StatusCode::OK).await;
    let listed: Vec<&Value> = page["jobs"].as_array().expect("jobs").iter().map(|job| &job["id"]).collect();
    assert_eq!(listed, [&ids[1], &ids[0]]);
    farm.stop().await;
}

#[tokio::test]
async fn a_replay_succeeds_even_if_the_quota_is_used_up() {
    let (farm, admin) = locked_farm().await;
    let key = NewApiKey { max_jobs: Some(1), ..new_key("anna", &[Scope::Submit]) };
    let anna = make(&farm, &admin, &key).await.secret;
    let options = async |name: &str| {
        let request = farm.client.post(farm.url("/v1/jobs")).header(AUTHORIZATION, format!("Bearer {anna}"));
        in_time(request.header("idempotency-key", name).body(small_job(1).to_string()).send())
            .await
            .expect("a response")
    };
    let first: Value = read(options("one").await, StatusCode::CREATED).await;
    let again: Value = read(options("one").await, StatusCode::OK).await;
    assert_eq!(first["id"], again["id"]);
    refused(options("two").await, 429, "quota").await;
    farm.stop().await;
}
