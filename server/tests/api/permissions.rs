//! Every route with every kind of key: which callers are authorized.
//!
//! The routes are the server's table; a route without a row here fails the test.

use std::collections::BTreeSet;
use std::time::Duration;

use proto::Problem;
use proto::api_key::{NewApiKey, Scope};
use reqwest::{Method, StatusCode};
use serde_json::Value;

use super::harness::{Farm, in_time, read, small_job};
use super::keys::{locked_farm, make, new_key, send};

/// Callers that a route authorizes; `admin` is always authorized.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Row {
    /// Every caller.
    Open,
    /// Every caller without a key, and every valid key.
    AnyOrNone,
    /// Keys with scope read.
    Read,
    /// Keys with scope submit.
    Submit,
    /// Keys with scope read or submit; submit alone sees its own jobs.
    ReadOrSubmit,
    /// Keys with scope read, and the job's submitter.
    ReadOrOwn,
    /// The job's submitter.
    Own,
    /// Workers.
    Worker,
    /// Administrators.
    Admin,
}

use Row::{Admin, AnyOrNone, Open, Own, Read, ReadOrOwn, ReadOrSubmit, Submit, Worker};

const ROWS: &[(&str, Row)] = &[
    ("GET /", Open),
    ("GET /livez", Open),
    ("GET /readyz", Open),
    ("GET /ui/{*path}", Open),
    ("GET /docs", Open),
    ("GET /docs/", Open),
    ("GET /docs/{*rest}", Open),
    ("GET /openapi.json", Open),
    ("GET /v1/schema/job", Open),
    ("GET /v1/schema/nodes", Open),
    ("GET /v1/scenes", Open),
    ("GET /v1/scenes/{name}", Open),
    ("GET /metrics", Read),
    ("GET /v1/alerts", Read),
    ("GET /v1/farm", Read),
    ("POST /v1/farm/pause", Admin),
    ("POST /v1/farm/resume", Admin),
    ("GET /v1/jobs", ReadOrSubmit),
    ("POST /v1/jobs", Submit),
    ("POST /v1/price", Submit),
    ("POST /v1/format", Submit),
    ("POST /v1/shader", Submit),
    ("GET /v1/jobs/{id}", ReadOrOwn),
    ("PATCH /v1/jobs/{id}", Own),
    ("POST /v1/jobs/{id}/move", Own),
    ("DELETE /v1/jobs/{id}", Own),
    ("POST /v1/jobs/{id}/cancel", Own),
    ("POST /v1/jobs/{id}/pause", Own),
    ("POST /v1/jobs/{id}/resume", Own),
    ("POST /v1/jobs/{id}/retry", Own),
    ("POST /v1/jobs/{id}/resubmit", Own),
    ("GET /v1/jobs/{id}/file", ReadOrOwn),
    ("GET /v1/jobs/{id}/events", ReadOrOwn),
    ("GET /v1/events", ReadOrSubmit),
    ("GET /v1/jobs/{id}/image", ReadOrOwn),
    ("GET /v1/jobs/{id}/webhooks", ReadOrOwn),
    ("GET /v1/jobs/{id}/tiles", ReadOrOwn),
    ("GET /v1/jobs/{id}/frames", ReadOrOwn),
    ("GET /v1/jobs/{id}/frames.zip", ReadOrOwn),
    ("GET /v1/jobs/{id}/frames/{frame}/image", ReadOrOwn),
    ("GET /v1/jobs/{id}/frames/{frame}/preview", ReadOrOwn),
    ("GET /v1/jobs/{id}/frames/{frame}/thumbnail", ReadOrOwn),
    ("GET /v1/jobs/{id}/frames/{frame}/layers", ReadOrOwn),
    ("GET /v1/jobs/{id}/frames/{frame}/layers/{layer}", ReadOrOwn),
    ("GET /v1/jobs/{id}/frames/{frame}/pixel", ReadOrOwn),
    ("POST /v1/jobs/{id}/frames/{frame}/link", ReadOrOwn),
    ("POST /v1/jobs/{id}/frames/{frame}/verify", ReadOrOwn),
    ("POST /v1/preview", Submit),
    ("POST /v1/pick", Submit),
    ("GET /v1/pictures/{id}/{frame}/{content}", Open),
    ("DELETE /v1/pictures/{hash}", Admin),
    ("POST /v1/gc", Admin),
    ("GET /v1/workers", Read),
    ("POST /v1/workers/{id}/drain", Admin),
    ("POST /v1/workers/{id}/quarantine", Admin),
    ("POST /v1/workers/{id}/release", Admin),
    ("GET /v1/pool", Read),
    ("GET /v1/history", Read),
    ("GET /v1/scaling", Read),
    ("PUT /v1/pool", Admin),
    ("GET /v1/keys", Admin),
    ("POST /v1/keys", Admin),
    ("DELETE /v1/keys/{id}", Admin),
    ("GET /v1/audit", Admin),
    ("GET /v1/caller", AnyOrNone),
    ("POST /v1/worker/register", Worker),
    ("POST /v1/worker/sync", Worker),
    ("GET /v1/worker/jobs/{id}", Worker),
    ("PUT /v1/worker/blobs/{hash}", Worker),
    ("GET /v1/worker/blobs/{hash}", Worker),
    ("PUT /v1/worker/pictures/{hash}", Worker),
];

/// Problem codes of the access control itself.
const KEY_PROBLEMS: [&str; 5] = ["missing_key", "unknown_key", "expired_key", "revoked_key", "missing_scope"];

/// Interval before a route is requested again.
const POLL_INTERVAL: Duration = Duration::from_millis(5);

/// The server's table of routes.
const TABLE: &str = include_str!("../../src/http.rs");

/// Whether a route is not in the document.
fn is_undocumented(route: &str) -> bool {
    route.contains("/v1/worker/") || route.contains("/docs") || route.contains("/ui/") || route == "GET /openapi.json"
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Bearer {
    Anonymous,
    Unknown,
    Expired,
    Revoked,
    Reader,
    Worker,
    /// A submitter with another name than the job's.
    Stranger,
    /// The job's submitter.
    Owner,
    Admin,
}

/// Response to a bearer: 401, 403, or any other status.
fn expected(row: Row, bearer: Bearer) -> Option<StatusCode> {
    let in_if = |lets_in: bool| if lets_in { None } else { Some(StatusCode::FORBIDDEN) };
    match bearer {
        _ if row == Open => None,
        Bearer::Unknown | Bearer::Expired | Bearer::Revoked => Some(StatusCode::UNAUTHORIZED),
        _ if row == AnyOrNone => None,
        Bearer::Anonymous => Some(StatusCode::UNAUTHORIZED),
        Bearer::Reader => in_if([Read, ReadOrOwn, ReadOrSubmit].contains(&row)),
        Bearer::Worker => in_if(row == Worker),
        Bearer::Stranger => in_if([Submit, ReadOrSubmit].contains(&row)),
        Bearer::Owner => in_if([Submit, ReadOrSubmit, ReadOrOwn, Own].contains(&row)),
        Bearer::Admin => None,
    }
}

/// Requests each route with one key; returns the differences from the table.
async fn walk(farm: &Farm, bearer: Bearer, key: Option<&str>, job: &str) -> Vec<String> {
    let mut wrong = Vec::new();
    for (route, row) in ROWS {
        let (method, path) = route.split_once(' ').expect("a method and a path");
        let path = path
            .replace("{id}", job)
            .replace("{frame}", "0")
            .replace("{content}", "image")
            .replace("{layer}", "color")
            .replace("{name}", "csg")
            .replace("{hash}", &"0".repeat(64))
            .replace("{*rest}", "index.css")
            .replace("{*path}", "style.css");
        let method: Method = method.parse().expect("a method");
        // Rejections are limited per second; above the limit the response is 429, and the request is repeated.
        let answer = loop {
            let answer = match key {
                Some(key) => send(farm, key, method.clone(), &path, "").await,
                None => in_time(farm.client.request(method.clone(), farm.url(&path)).send()).await.expect("a response"),
            };
            if answer.status() != StatusCode::TOO_MANY_REQUESTS {
                break answer;
            }
            tokio::time::sleep(POLL_INTERVAL).await;
        };
        let status = answer.status();
        // A route may reject a request for its own reasons, such as a wrong signature; those do not count.
        let refused = [StatusCode::UNAUTHORIZED, StatusCode::FORBIDDEN].contains(&status)
            && KEY_PROBLEMS.contains(&&*read::<Problem>(answer, status).await.code);
        if expected(*row, bearer) != refused.then_some(status) {
            wrong.push(format!("{route} for {bearer:?}: {status}"));
        }
    }
    wrong
}

#[tokio::test]
async fn each_route_authorizes_exactly_the_callers_of_the_table() {
    let (farm, admin) = locked_farm().await;
    let key = async |new: NewApiKey| make(&farm, &admin, &new).await.secret;
    let expired = key(NewApiKey { expires_in_seconds: Some(1), ..new_key("late", &Scope::ALL) }).await;
    farm.hand.advance(Duration::from_secs(2));
    let revoked = key(new_key("gone", &Scope::ALL)).await;
    assert_eq!(send(&farm, &admin, Method::DELETE, "/v1/keys/gone", "").await.status(), StatusCode::OK);
    let reader = key(new_key("reader", &[Scope::Read])).await;
    let worker = key(new_key("host", &[Scope::Worker])).await;
    let stranger = key(new_key("stranger", &[Scope::Submit])).await;
    let owner = key(new_key("owner", &[Scope::Submit])).await;
    let job: Value =
        read(send(&farm, &owner, Method::POST, "/v1/jobs", small_job(1).to_string()).await, StatusCode::CREATED).await;
    let job = job["id"].as_str().expect("an id");
    let mut wrong = Vec::new();
    for (bearer, key) in [
        (Bearer::Anonymous, None),
        (Bearer::Unknown, Some("sdf_AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA")),
        (Bearer::Expired, Some(&*expired)),
        (Bearer::Revoked, Some(&*revoked)),
        (Bearer::Reader, Some(&*reader)),
        (Bearer::Worker, Some(&*worker)),
        (Bearer::Stranger, Some(&*stranger)),
        (Bearer::Owner, Some(&*owner)),
        (Bearer::Admin, Some(&*admin)),
    ] {
        wrong.extend(walk(&farm, bearer, key, job).await);
    }
    assert_eq!(wrong, Vec::<String>::new());
    farm.stop().await;
}

#[test]
fn every_route_has_a_row_and_every_row_a_route() {
    let routes: BTreeSet<String> = TABLE.lines().filter_map(route_of_line).collect();
    let rows: BTreeSet<String> = ROWS.iter().map(|(route, _)| (*route).to_owned()).collect();
    let missing: Vec<_> = routes.difference(&rows).collect();
    assert!(missing.is_empty(), "these routes have no row in the table of permissions: {missing:?}");
    let stale: Vec<_> = rows.difference(&routes).collect();
    assert!(stale.is_empty(), "these rows have no route: {stale:?}");
}

/// Method and path of a row of the server's table, by its first line: `GET "/livez" …`.
fn route_of_line(line: &str) -> Option<String> {
    let (method, rest) = line.trim().split_once(' ')?;
    let path = rest.trim().strip_prefix('"')?.split('"').next()?;
    method.chars().all(|letter| letter.is_ascii_uppercase()).then(|| format!("{method} {path}"))
}

#[tokio::test]
async fn the_document_has_the_routes_of_users() {
    let farm = Farm::start().await;
    let document: Value = read(farm.get("/openapi.json").await, StatusCode::OK).await;
    let mut routes = BTreeSet::new();
    for (path, methods) in document["paths"].as_object().expect("paths") {
        for method in methods.as_object().expect("methods").keys() {
            routes.insert(format!("{} {path}", method.to_uppercase()));
        }
    }
    let rows: BTreeSet<String> =
        ROWS.iter().map(|(route, _)| (*route).to_owned()).filter(|route| !is_undocumented(route)).collect();
    assert_eq!(routes, rows);
    farm.stop().await;
}
