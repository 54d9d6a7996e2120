//! Every route for every kind of key: who is let in, who is not.
//!
//! The routes are those of the served document and the workers'; one that has no row here fails the test.

use std::collections::BTreeSet;
use std::time::Duration;

use proto::Problem;
use proto::api_key::{NewApiKey, Scope};
use reqwest::{Method, StatusCode};
use serde_json::Value;

use super::harness::{Farm, in_time, read, small_job};
use super::keys::{locked_farm, make, new_key, send};

/// Who is let in by a key of one scope; `admin` is everywhere.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Row {
    /// Anyone.
    Open,
    /// Whoever may read.
    Read,
    /// Whoever may submit.
    Submit,
    /// Whoever may read, and who may submit: that one sees its own.
    ReadOrSubmit,
    /// Whoever may read, and whose job it is.
    ReadOrOwn,
    /// Whose job it is.
    Own,
    /// Workers.
    Worker,
    /// Administrators.
    Admin,
}

use Row::{Admin, Open, Own, Read, ReadOrOwn, ReadOrSubmit, Submit, Worker};

const ROWS: &[(&str, Row)] = &[
    ("GET /", Open),
    ("GET /livez", Open),
    ("GET /readyz", Open),
    ("GET /docs/", Open),
    ("GET /openapi.json", Open),
    ("GET /v1/schema/job", Open),
    ("GET /metrics", Read),
    ("GET /v1/farm", Read),
    ("POST /v1/farm/pause", Admin),
    ("POST /v1/farm/resume", Admin),
    ("GET /v1/jobs", ReadOrSubmit),
    ("POST /v1/jobs", Submit),
    ("GET /v1/jobs/{id}", ReadOrOwn),
    ("PATCH /v1/jobs/{id}", Own),
    ("DELETE /v1/jobs/{id}", Own),
    ("POST /v1/jobs/{id}/cancel", Own),
    ("POST /v1/jobs/{id}/pause", Own),
    ("POST /v1/jobs/{id}/resume", Own),
    ("POST /v1/jobs/{id}/retry", Own),
    ("POST /v1/jobs/{id}/resubmit", Own),
    ("GET /v1/jobs/{id}/file", ReadOrOwn),
    ("GET /v1/jobs/{id}/events", ReadOrOwn),
    ("GET /v1/jobs/{id}/image", ReadOrOwn),
    ("GET /v1/jobs/{id}/webhooks", ReadOrOwn),
    ("GET /v1/jobs/{id}/frames", ReadOrOwn),
    ("GET /v1/jobs/{id}/frames.zip", ReadOrOwn),
    ("GET /v1/jobs/{id}/frames/{frame}/image", ReadOrOwn),
    ("GET /v1/jobs/{id}/frames/{frame}/preview", ReadOrOwn),
    ("GET /v1/jobs/{id}/frames/{frame}/thumbnail", ReadOrOwn),
    ("POST /v1/jobs/{id}/frames/{frame}/link", ReadOrOwn),
    ("GET /v1/pictures/{id}/{frame}/{content}", Open),
    ("POST /v1/gc", Admin),
    ("GET /v1/workers", Read),
    ("GET /v1/pool", Read),
    ("PUT /v1/pool", Admin),
    ("GET /v1/keys", Admin),
    ("POST /v1/keys", Admin),
    ("DELETE /v1/keys/{id}", Admin),
    ("GET /v1/audit", Admin),
    ("POST /v1/worker/register", Worker),
    ("POST /v1/worker/sync", Worker),
    ("GET /v1/worker/jobs/{id}", Worker),
    ("PUT /v1/worker/blobs/{hash}", Worker),
    ("GET /v1/worker/blobs/{hash}", Worker),
    ("PUT /v1/worker/pictures/{hash}", Worker),
];

/// What the doors themselves answer.
const KEY_PROBLEMS: [&str; 5] = ["missing_key", "unknown_key", "expired_key", "revoked_key", "missing_scope"];

/// How soon a route is asked again.
const POLL_INTERVAL: Duration = Duration::from_millis(5);

/// Rows whose routes the document leaves out.
fn is_undocumented(route: &str) -> bool {
    route.contains("/v1/worker/") || ["GET /docs/", "GET /openapi.json"].contains(&route)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Bearer {
    Nobody,
    Unknown,
    Expired,
    Revoked,
    Reader,
    Worker,
    /// Of another name than the job's.
    Stranger,
    /// Who handed the job in.
    Owner,
    Admin,
}

/// What a bearer is answered: 401, 403, or anything else.
fn expected(row: Row, bearer: Bearer) -> Option<StatusCode> {
    let in_if = |lets_in: bool| if lets_in { None } else { Some(StatusCode::FORBIDDEN) };
    match bearer {
        _ if row == Open => None,
        Bearer::Nobody | Bearer::Unknown | Bearer::Expired | Bearer::Revoked => Some(StatusCode::UNAUTHORIZED),
        Bearer::Reader => in_if([Read, ReadOrOwn, ReadOrSubmit].contains(&row)),
        Bearer::Worker => in_if(row == Worker),
        Bearer::Stranger => in_if([Submit, ReadOrSubmit].contains(&row)),
        Bearer::Owner => in_if([Submit, ReadOrSubmit, ReadOrOwn, Own].contains(&row)),
        Bearer::Admin => None,
    }
}

/// Asks each route as one bearer; returns what differs from the table.
async fn walk(farm: &Farm, bearer: Bearer, key: Option<&str>, job: &str) -> Vec<String> {
    let mut wrong = Vec::new();
    for (route, row) in ROWS {
        let (method, path) = route.split_once(' ').expect("a method and a path");
        let path = path
            .replace("{id}", job)
            .replace("{frame}", "0")
            .replace("{content}", "image")
            .replace("{hash}", &"0".repeat(64));
        let method: Method = method.parse().expect("a method");
        // Refusals are counted, and too many in a second are answered otherwise: then it is asked again.
        let answer = loop {
            let answer = match key {
                Some(key) => send(farm, key, method.clone(), &path, "").await,
                None => in_time(farm.client.request(method.clone(), farm.url(&path)).send()).await.expect("an answer"),
            };
            if answer.status() != StatusCode::TOO_MANY_REQUESTS {
                break answer;
            }
            tokio::time::sleep(POLL_INTERVAL).await;
        };
        let status = answer.status();
        // A route may refuse for reasons of its own, as a link that is signed wrongly; those are not meant.
        let refused = [StatusCode::UNAUTHORIZED, StatusCode::FORBIDDEN].contains(&status)
            && KEY_PROBLEMS.contains(&&*read::<Problem>(answer, status).await.code);
        if expected(*row, bearer) != refused.then_some(status) {
            wrong.push(format!("{route} for {bearer:?}: {status}"));
        }
    }
    wrong
}

#[tokio::test]
async fn every_route_lets_in_whom_the_table_says_and_nobody_else() {
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
        (Bearer::Nobody, None),
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

#[tokio::test]
async fn every_route_has_a_row_and_every_row_a_route() {
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
    let missing: Vec<_> = routes.difference(&rows).collect();
    assert!(missing.is_empty(), "these routes have no row in the table of who may what: {missing:?}");
    let stale: Vec<_> = rows.difference(&routes).collect();
    assert!(stale.is_empty(), "these rows have no route: {stale:?}");
    farm.stop().await;
}
