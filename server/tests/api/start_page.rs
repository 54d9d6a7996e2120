//! `GET /`: a page for browsers, JSON for programs, and nothing private in either.

use proto::farm::StartView;
use reqwest::header::ACCEPT;
use reqwest::{Response, StatusCode};

use super::harness::{Farm, in_time, read, refused, small_job};
use super::keys::{locked_farm, make, new_key, send};

async fn page(farm: &Farm) -> Response {
    in_time(farm.client.get(farm.url("/")).header(ACCEPT, "text/html,*/*;q=0.8").send()).await.expect("a response")
}

async fn text(response: Response) -> String {
    in_time(response.text()).await.expect("a body")
}

#[tokio::test]
async fn the_page_has_a_summary_and_examples() {
    let farm = Farm::start().await;
    let mut job = small_job(1);
    job["name"] = "<script>alert(1)</script> {state}".into();
    let posted = farm.submit(&job).await;
    let answer = page(&farm).await;
    assert_eq!(answer.status(), StatusCode::OK);
    let header = |name: &str| answer.headers()[name].to_str().expect("text").to_owned();
    assert_eq!(header("content-type"), "text/html; charset=utf-8");
    assert!(header("content-security-policy").starts_with("default-src 'none'"));
    assert_eq!((header("x-content-type-options"), header("vary")), ("nosniff".to_owned(), "accept".to_owned()));
    let page = text(answer).await;
    for words in [
        "1 queued",
        "No worker is ready",
        "href=\"/docs/\"",
        "href=\"/openapi.json\"",
        "href=\"/v1/schema/job\"",
        "sdfarm submit job.json",
        &farm.url("/v1/jobs"),
        &format!("href=\"/v1/jobs/{}\"", posted.id),
        "&lt;script&gt;alert(1)&lt;/script&gt; {state}",
    ] {
        assert!(page.contains(words), "{words}:\n{page}");
    }
    assert!(!page.contains("<script"), "{page}");
    for attribute in ["src=", "url(", "@import", "href=\"http", "href=\"//"] {
        assert!(!page.contains(attribute), "the page would load something: {attribute}");
    }
    farm.stop().await;
}

#[tokio::test]
async fn the_page_warns_of_a_paused_farm() {
    let farm = Farm::start().await;
    farm.post("/v1/farm/pause", "").await;
    assert!(text(page(&farm).await).await.contains("The farm is paused"));
    farm.post("/v1/farm/resume", "").await;
    assert!(!text(page(&farm).await).await.contains("The farm is paused"));
    farm.stop().await;
}

#[tokio::test]
async fn programs_get_json_with_counts() {
    let farm = Farm::start().await;
    farm.submit(&small_job(1)).await;
    farm.post("/v1/farm/pause", "").await;
    let view: StartView = read(farm.get("/").await, StatusCode::OK).await;
    assert_eq!((view.name.as_str(), view.needs_key), ("sdfarm", false));
    let counts = view.farm.expect("a farm without keys returns its numbers");
    assert_eq!((counts.queued, counts.running, counts.workers_ready, counts.paused), (1, 0, 0, true));
    for path in [view.docs, view.openapi, view.job_schema] {
        assert_eq!(farm.get(&path).await.status(), StatusCode::OK, "{path}");
    }
    refused(farm.post("/", "").await, 405, "wrong_method").await;
    farm.stop().await;
}

#[tokio::test]
async fn a_farm_with_keys_returns_only_that_it_needs_one() {
    let (farm, admin) = locked_farm().await;
    let anna = make(&farm, &admin, &new_key("anna", &[proto::api_key::Scope::Submit])).await.secret;
    let mut job = small_job(1);
    job["name"] = "secret project".into();
    let posted = send(&farm, &anna, reqwest::Method::POST, "/v1/jobs", job.to_string()).await;
    assert_eq!(posted.status(), StatusCode::CREATED);
    let shown = text(page(&farm).await).await;
    assert!(shown.contains("needs a key") && shown.contains("Authorization: Bearer"), "{shown}");
    for private in ["secret project", "queued", "ready.", "anna"] {
        assert!(!shown.contains(private), "{private}: {shown}");
    }
    let view: StartView = read(farm.get("/").await, StatusCode::OK).await;
    assert!(view.needs_key && view.farm.is_none(), "{view:?}");
    let foreign = in_time(farm.client.get(farm.url("/")).header("host", "evil.example").send()).await;
    refused(foreign.expect("a response"), 403, "foreign_host").await;
    farm.stop().await;
}
