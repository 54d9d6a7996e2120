//! The caller of a request, and the page that only shows.

use std::time::Duration;

use proto::api_key::Scope;
use proto::caller::CallerView;
use reqwest::header::{AUTHORIZATION, ORIGIN};
use reqwest::{Method, Response, StatusCode};
use serde_json::json;

use super::harness::{Farm, in_time, read, refused, small_job};
use super::keys::{locked_farm_with, make, new_key, send};

async fn caller(farm: &Farm, key: &str) -> CallerView {
    read(send(farm, key, Method::GET, "/v1/caller", "").await, StatusCode::OK).await
}

#[tokio::test]
async fn a_farm_without_keys_lets_everyone_do_everything() {
    let farm = Farm::start().await;
    let wanted = CallerView {
        needs_key: false,
        name: Some("local".to_owned()),
        scope: None,
        scopes: None,
        read_only: false,
        version: env!("CARGO_PKG_VERSION").to_owned(),
    };
    assert_eq!(read::<CallerView>(farm.get("/v1/caller").await, StatusCode::OK).await, wanted);
    let posted = farm.submit(&small_job(1)).await;
    assert_eq!(Some(posted.submitter), wanted.name, "jobs are submitted under the caller's name");
    farm.stop().await;
}

#[tokio::test]
async fn each_key_gets_its_name_and_scopes_and_a_wrong_one_is_rejected() {
    let (farm, admin) = locked_farm_with(|_| {}).await;
    let unknown: CallerView = read(farm.get("/v1/caller").await, StatusCode::OK).await;
    assert_eq!((unknown.needs_key, unknown.name, unknown.scope, unknown.scopes), (true, None, None, None));
    for (name, scopes, most) in [
        ("reader", &[Scope::Read][..], Scope::Read),
        ("host", &[Scope::Worker], Scope::Worker),
        ("anna", &[Scope::Submit, Scope::Read], Scope::Submit),
        ("all", &Scope::ALL, Scope::Admin),
    ] {
        let key = make(&farm, &admin, &new_key(name, scopes)).await.secret;
        let view = caller(&farm, &key).await;
        assert_eq!((view.needs_key, view.name.as_deref(), view.scope), (true, Some(name), Some(most)));
        assert_eq!(view.scopes.as_deref(), Some(scopes));
    }
    let late = proto::api_key::NewApiKey { expires_in_seconds: Some(1), ..new_key("late", &[Scope::Read]) };
    let late = make(&farm, &admin, &late).await.secret;
    farm.hand.advance(Duration::from_secs(2));
    for (key, code) in [("nonsense", "unknown_key"), ("", "unknown_key"), (&*late, "expired_key")] {
        refused(send(&farm, key, Method::GET, "/v1/caller", "").await, 401, code).await;
    }
    farm.stop().await;
}

/// Sends what a page of the server sends.
async fn from_page(farm: &Farm, key: &str, method: Method, path: &str, body: &str) -> Response {
    let request = farm.client.request(method, farm.url(path)).header(ORIGIN, farm.url(""));
    let request = request.header(AUTHORIZATION, format!("Bearer {key}")).body(body.to_owned());
    in_time(request.send()).await.expect("the server responds")
}

#[tokio::test]
async fn a_read_only_page_changes_nothing_and_programs_change_all() {
    let (farm, admin) = locked_farm_with(|config| config.read_only_page = true).await;
    assert!(caller(&farm, &admin).await.read_only);
    let job = small_job(1).to_string();
    refused(from_page(&farm, &admin, Method::POST, "/v1/jobs", &job).await, 403, "read_only_page").await;
    let posted: proto::job::JobView =
        read(send(&farm, &admin, Method::POST, "/v1/jobs", job.clone()).await, StatusCode::CREATED).await;
    let path = format!("/v1/jobs/{}", posted.id);
    let new_key = serde_json::to_string(&new_key("mallory", &[Scope::Admin])).expect("JSON");
    for (method, path, body) in [
        (Method::POST, "/v1/jobs?dry_run=false", &*job),
        (Method::POST, "/v1/jobs?dry_run=true&dry_run=false", &*job),
        (Method::PATCH, &*path, "{\"priority\": -1}"),
        (Method::DELETE, &path, ""),
        (Method::POST, &format!("{path}/cancel"), ""),
        (Method::POST, &format!("{path}/cancel?dry_run=true"), ""),
        (Method::POST, &format!("{path}/pause?dry_run=true"), ""),
        (Method::POST, &format!("{path}/resubmit"), ""),
        (Method::POST, "/v1/farm/pause", ""),
        (Method::PUT, "/v1/pool", "{\"workers\": 1}"),
        (Method::POST, "/v1/gc", ""),
        (Method::POST, "/v1/keys?dry_run=true", &new_key),
        (Method::DELETE, "/v1/keys/root", ""),
    ] {
        let answer = from_page(&farm, &admin, method, path, body).await;
        let problem = refused(answer, 403, "read_only_page").await;
        assert!(problem.detail.contains("--read-only-page"), "{problem:?}");
    }
    for (method, path, body) in [
        (Method::GET, "/v1/jobs", ""),
        (Method::GET, &*path, ""),
        (Method::GET, "/v1/keys", ""),
        (Method::POST, "/v1/jobs?dry_run=true", &*job),
        (Method::POST, &format!("{path}/resubmit?dry_run=true"), ""),
        (Method::DELETE, &format!("{path}?dry_run=true"), ""),
        (Method::POST, "/v1/gc?dry_run=true", ""),
    ] {
        assert_eq!(
            from_page(&farm, &admin, method.clone(), path, body).await.status(),
            StatusCode::OK,
            "{method} {path}"
        );
    }
    let jobs: proto::job::JobPage = read(send(&farm, &admin, Method::GET, "/v1/jobs", "").await, StatusCode::OK).await;
    let [job] = &jobs.jobs[..] else { panic!("the page submitted a job: {jobs:?}") };
    assert_eq!((job.state, job.paused, job.priority), (posted.state, false, posted.priority), "the page changed it");
    let patch = json!({ "priority": 3 }).to_string();
    assert_eq!(send(&farm, &admin, Method::PATCH, &path, patch).await.status(), StatusCode::OK);
    farm.stop().await;
}
