//! `GET /` and `/ui/`: the page for browsers, JSON for programs, and nothing private in either.

use std::io::Read as _;

use proto::farm::StartView;
use reqwest::header::{ACCEPT, ACCEPT_ENCODING, CONTENT_ENCODING, ETAG, HeaderMap, IF_NONE_MATCH};
use reqwest::{Method, Response, StatusCode};

use super::harness::{Farm, in_time, read, refused, small_job};
use super::keys::{locked_farm, make, new_key, send};

/// The policy of every file of the page, without which a name of a job could run as a script.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; \
                      connect-src 'self'; worker-src 'self'; base-uri 'none'; form-action 'none'; \
                      frame-ancestors 'none'";

async fn page(farm: &Farm) -> Response {
    in_time(farm.client.get(farm.url("/")).header(ACCEPT, "text/html,*/*;q=0.8").send()).await.expect("a response")
}

async fn file(farm: &Farm, method: Method, path: &str, header: Option<(&str, &str)>) -> Response {
    let request = farm.client.request(method, farm.url(path));
    let request = header.into_iter().fold(request, |request, (name, value)| request.header(name, value));
    in_time(request.send()).await.expect("a response")
}

async fn text(response: Response) -> String {
    in_time(response.text()).await.expect("a body")
}

fn header<'a>(headers: &'a HeaderMap, name: &str) -> &'a str {
    headers.get(name).map_or("", |value| value.to_str().expect("text"))
}

fn check_protection(headers: &HeaderMap, path: &str) {
    for (name, value) in [
        ("content-security-policy", POLICY),
        ("x-content-type-options", "nosniff"),
        ("referrer-policy", "no-referrer"),
        ("cross-origin-opener-policy", "same-origin"),
        ("cross-origin-resource-policy", "same-origin"),
        ("cache-control", "no-cache"),
    ] {
        assert_eq!(header(headers, name), value, "{path}: {name}");
    }
    for name in ["set-cookie", "access-control-allow-origin"] {
        assert!(!headers.contains_key(name), "{path}: {name}");
    }
}

/// Addresses that the page names in its attributes.
fn addresses(page: &str) -> Vec<String> {
    let values = ["src=\"", "href=\""].into_iter().flat_map(|name| page.split(name).skip(1));
    values.filter_map(|rest| rest.split('"').next()).map(str::to_owned).collect()
}

#[tokio::test]
async fn browsers_get_the_page_and_every_file_that_it_names() {
    let farm = Farm::start().await;
    let answer = page(&farm).await;
    assert_eq!(answer.status(), StatusCode::OK);
    check_protection(answer.headers(), "/");
    assert_eq!(header(answer.headers(), "content-type"), "text/html; charset=utf-8");
    assert_eq!(header(answer.headers(), "vary"), "accept, accept-encoding");
    let page = text(answer).await;
    let named = addresses(&page);
    for wanted in ["/ui/style.css", "/ui/main.js", "/docs/"] {
        assert!(named.iter().any(|name| name == wanted), "{wanted} is missing: {named:?}");
    }
    for path in named.iter().filter(|path| !path.starts_with('#')) {
        assert!(path.starts_with('/') && !path.starts_with("//"), "the page would load from elsewhere: {path}");
        assert_eq!(farm.get(path).await.status(), StatusCode::OK, "{path}");
    }
    for inline in ["<style", "style=", "onclick=", "onload=", "onerror=", "javascript:", "http-equiv"] {
        assert!(!page.contains(inline), "the policy would block {inline}");
    }
    farm.stop().await;
}

#[tokio::test]
async fn files_have_their_types_and_tags() {
    let farm = Farm::start().await;
    for (path, media_type) in [
        ("/ui/main.js", "text/javascript; charset=utf-8"),
        ("/ui/rooms/jobs.js", "text/javascript; charset=utf-8"),
        ("/ui/style.css", "text/css; charset=utf-8"),
        ("/ui/icon.svg", "image/svg+xml"),
        ("/ui/index.html", "text/html; charset=utf-8"),
    ] {
        let answer = file(&farm, Method::GET, path, None).await;
        assert_eq!((answer.status(), header(answer.headers(), "content-type")), (StatusCode::OK, media_type), "{path}");
        check_protection(answer.headers(), path);
        let tag = header(answer.headers(), "etag").to_owned();
        assert!(tag.starts_with('"'), "a strong tag: {tag}");
        let body = in_time(answer.bytes()).await.expect("a body");

        let head = file(&farm, Method::HEAD, path, None).await;
        assert_eq!(head.status(), StatusCode::OK, "{path}");
        assert_eq!(header(head.headers(), "content-length"), body.len().to_string(), "{path}");
        assert_eq!(header(head.headers(), "etag"), tag);
        assert!(in_time(head.bytes()).await.expect("no body").is_empty(), "{path}");

        let again = file(&farm, Method::GET, path, Some((IF_NONE_MATCH.as_str(), &tag))).await;
        assert_eq!(again.status(), StatusCode::NOT_MODIFIED, "{path}");
        check_protection(again.headers(), path);
        assert!(in_time(again.bytes()).await.expect("no body").is_empty(), "{path}");
        let other = file(&farm, Method::GET, path, Some((IF_NONE_MATCH.as_str(), "\"other\""))).await;
        assert_eq!(other.status(), StatusCode::OK, "{path}");
    }
    farm.stop().await;
}

#[tokio::test]
async fn compressed_files_are_the_same_under_another_tag() {
    let farm = Farm::start().await;
    let plain = file(&farm, Method::GET, "/ui/style.css", None).await;
    assert!(!plain.headers().contains_key(CONTENT_ENCODING));
    let plain_tag = header(plain.headers(), "etag").to_owned();
    let plain = in_time(plain.bytes()).await.expect("a body");
    let packed = file(&farm, Method::GET, "/ui/style.css", Some((ACCEPT_ENCODING.as_str(), "br, gzip"))).await;
    assert_eq!(header(packed.headers(), "content-encoding"), "gzip");
    assert_eq!(header(packed.headers(), "vary"), "accept-encoding");
    let packed_tag = packed.headers()[ETAG].to_str().expect("text").to_owned();
    assert_ne!(packed_tag, plain_tag, "the bytes differ, so the strong tags must");
    let packed = in_time(packed.bytes()).await.expect("a body");
    assert!(packed.len() < plain.len() / 2, "{} of {}", packed.len(), plain.len());
    let mut unpacked = Vec::new();
    flate2::read::GzDecoder::new(&packed[..]).read_to_end(&mut unpacked).expect("gzip");
    assert_eq!(unpacked, plain);
    let again = farm.client.get(farm.url("/ui/style.css")).header(ACCEPT_ENCODING, "gzip");
    let again = in_time(again.header(IF_NONE_MATCH, &packed_tag).send()).await.expect("a response");
    assert_eq!(again.status(), StatusCode::NOT_MODIFIED);
    farm.stop().await;
}

#[tokio::test]
async fn only_files_of_the_page_are_served() {
    let farm = Farm::start().await;
    for path in [
        "/ui/",
        "/ui/nothing.js",
        "/ui/rooms",
        "/ui/tsconfig.json",
        "/ui/../Cargo.toml",
        "/ui/%2e%2e/Cargo.toml",
        "/ui/..%2fREADME.md",
        "/ui/..%2f..%2fetc%2fpasswd.txt",
        "/ui/%2e%2e%2fscenes%2fcsg.json",
        "/ui//etc/hostname.txt",
        "/ui/rooms%5c..%5cmain.js",
    ] {
        let answer = file(&farm, Method::GET, path, None).await;
        assert_eq!(answer.status(), StatusCode::NOT_FOUND, "{path}");
    }
    refused(farm.get("/ui/nothing.js").await, 404, "unknown_route").await;
    refused(farm.post("/ui/main.js", "").await, 405, "wrong_method").await;
    farm.stop().await;
}

#[tokio::test]
async fn the_first_job_of_the_help_is_a_valid_job() {
    let farm = Farm::start().await;
    let shown = text(farm.get("/ui/rooms/help/first.json").await).await;
    let posted = farm.post("/v1/jobs?dry_run=true", shown).await;
    assert_eq!(posted.status(), StatusCode::OK, "{}", text(posted).await);
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
async fn the_page_is_the_same_for_every_caller() {
    let (farm, admin) = locked_farm().await;
    let anna = make(&farm, &admin, &new_key("anna", &[proto::api_key::Scope::Submit])).await.secret;
    let mut job = small_job(1);
    job["name"] = "secret project".into();
    let posted = send(&farm, &anna, Method::POST, "/v1/jobs", job.to_string()).await;
    assert_eq!(posted.status(), StatusCode::CREATED);
    let shown = page(&farm).await;
    check_protection(shown.headers(), "/");
    let shown = text(shown).await;
    let open = Farm::start().await;
    assert_eq!(shown, text(page(&open).await).await);
    open.stop().await;
    assert!(!shown.contains("secret project") && !shown.contains("anna"), "{shown}");
    let view: StartView = read(farm.get("/").await, StatusCode::OK).await;
    assert!(view.needs_key && view.farm.is_none(), "{view:?}");
    let foreign = in_time(farm.client.get(farm.url("/")).header("host", "evil.example").send()).await;
    refused(foreign.expect("a response"), 403, "foreign_host").await;
    farm.stop().await;
}
