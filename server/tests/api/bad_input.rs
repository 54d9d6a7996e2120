//! Invalid requests of users, and their error responses.

use proto::worker_protocol;
use reqwest::header::{ALLOW, AUTHORIZATION, CONTENT_TYPE, HOST, HeaderName, ORIGIN};
use reqwest::{Method, Response, StatusCode};
use serde_json::json;

use super::harness::{Farm, Said, in_time, read, refused, small_job};

async fn send(farm: &Farm, method: Method, path: &str, headers: &[(HeaderName, &str)], body: &str) -> Response {
    let mut request = farm.client.request(method, farm.url(path)).body(body.to_owned());
    for (name, value) in headers {
        request = request.header(name, *value);
    }
    in_time(request.send()).await.expect("a response")
}

#[tokio::test]
async fn an_invalid_job_is_rejected_with_a_json_pointer() {
    let farm = Farm::start().await;
    let mut job = small_job(1);
    job["image"]["width"] = 0.into();
    let problem = refused(farm.post("/v1/jobs", job.to_string()).await, 422, "wrong_job").await;
    assert_eq!(problem.errors[0].pointer, "/image/width");
    assert!(problem.errors[0].line >= 1 && problem.errors[0].column >= 1);
    let problem = refused(farm.post("/v1/jobs?dry_run=true", job.to_string()).await, 422, "wrong_job").await;
    assert_eq!(problem.errors[0].pointer, "/image/width");
    farm.stop().await;
}

#[tokio::test]
async fn bodies_that_are_not_json_are_rejected() {
    let farm = Farm::start().await;
    for body in [b"".to_vec(), b"{\"name\": ".to_vec(), b"{\"name\": \"\xff\"}".to_vec(), b"nonsense".to_vec()] {
        let problem = refused(farm.post("/v1/jobs", body).await, 400, "not_json").await;
        assert_eq!(problem.errors[0].pointer, "");
    }
    let deep = format!("{}{}", "[".repeat(100_000), "]".repeat(100_000));
    assert!(farm.post("/v1/jobs", deep).await.status().is_client_error());
    farm.stop().await;
}

#[tokio::test]
async fn bodies_of_the_wrong_kind_or_size_are_rejected() {
    let farm = Farm::start().await;
    let large = " ".repeat((32 << 20) + 1);
    let problem = refused(farm.post("/v1/jobs", large).await, 413, "too_large").await;
    assert!(problem.detail.contains("33554432"), "{problem:?}");
    let text = [(CONTENT_TYPE, "text/plain")];
    refused(send(&farm, Method::POST, "/v1/jobs", &text, "{}").await, 415, "wrong_content_type").await;
    let json = [(CONTENT_TYPE, "application/json; charset=utf-8")];
    let sound = send(&farm, Method::POST, "/v1/jobs", &json, &small_job(1).to_string()).await;
    assert_eq!(sound.status(), StatusCode::CREATED);
    farm.stop().await;
}

#[tokio::test]
async fn unknown_routes_jobs_and_methods_are_problems_too() {
    let farm = Farm::start().await;
    refused(farm.get("/v2/jobs").await, 404, "unknown_route").await;
    for path in ["/v1/jobs/0", "/v1/jobs/00000000-0000-7000-8000-000000000000"] {
        refused(farm.get(path).await, 404, "unknown_job").await;
        refused(farm.get(&format!("{path}/image")).await, 404, "unknown_job").await;
        refused(farm.post(&format!("{path}/cancel"), "").await, 404, "unknown_job").await;
        refused(send(&farm, Method::DELETE, path, &[], "").await, 404, "unknown_job").await;
    }
    let wrong = send(&farm, Method::PUT, "/v1/jobs", &[], "").await;
    let allowed = wrong.headers()[ALLOW].to_str().expect("text").to_owned();
    assert!(allowed.contains("POST") && allowed.contains("GET"), "{allowed}");
    refused(wrong, 405, "wrong_method").await;
    for query in ["limit=0", "limit=1001", "limit=x", "state=gone", "cursor=x"] {
        refused(farm.get(&format!("/v1/jobs?{query}")).await, 422, "wrong_query").await;
    }
    farm.stop().await;
}

/// PostgreSQL stores no NUL, and `SQLite` does: no text with one reaches either.
#[tokio::test]
async fn texts_with_nul_are_rejected() {
    let farm = Farm::start().await;
    let mut job = small_job(1);
    job["name"] = "a\0b".into();
    let problem = refused(farm.post("/v1/jobs", job.to_string()).await, 422, "wrong_job").await;
    assert_eq!(problem.errors[0].pointer, "/name");
    job["name"] = "two\nlines".into();
    assert_eq!(farm.submit(&job).await.name, "two\nlines");
    for path in ["jobs?match=a%00b", "jobs?state=%00", "jobs?cursor=%00", "jobs?picture=%00", "audit?cursor=%00"] {
        refused(farm.get(&format!("/v1/{path}")).await, 422, "wrong_query").await;
    }
    let job = small_job(1).to_string();
    for query in ["keep=%00", "webhook=http://a.example/%00", "set=name=%22%00%22", "%00=1"] {
        let problem = refused(farm.post(&format!("/v1/jobs?{query}"), job.clone()).await, 422, "wrong_query").await;
        assert!(problem.detail.contains("has a control character"), "{problem:?}");
    }
    for (method, path) in [
        ("GET", "jobs/%00"),
        ("GET", "jobs/%00/image"),
        ("GET", "scenes/%00"),
        ("DELETE", "keys/%00"),
        ("POST", "workers/%00/drain"),
        ("DELETE", "pictures/%00"),
    ] {
        let method = Method::from_bytes(method.as_bytes()).expect("a method");
        let answer = send(&farm, method, &format!("/v1/{path}"), &[], "").await;
        assert!([404, 422].contains(&answer.status().as_u16()), "{path}: {}", answer.status());
    }
    let body = "{\n  \"name\": \"a\\\\\\u0000\" }";
    let problem = refused(farm.post("/v1/keys", body).await, 422, "wrong_body").await;
    assert_eq!((problem.errors[0].line, problem.errors[0].column), (2, 15), "{problem:?}");
    let register = json!({ "name": "a\0b", "device": "\0", "picture_version": 1 }).to_string();
    for route in [worker_protocol::REGISTER_PATH, worker_protocol::SYNC_PATH] {
        let problem = refused(farm.post(route, register.clone()).await, 422, "wrong_body").await;
        assert!(problem.errors[0].message.contains("cannot be stored"), "{problem:?}");
    }
    farm.stop().await;
}

#[tokio::test]
async fn a_pool_of_an_impossible_size_is_rejected() {
    let farm = Farm::start().await;
    for body in [json!({"workers": -1}), json!({"workers": 10_000}), json!({"workers": "two"}), json!({"workers": 1.5})]
    {
        let problem =
            refused(send(&farm, Method::PUT, "/v1/pool", &[], &body.to_string()).await, 422, "wrong_body").await;
        assert_eq!(problem.errors[0].pointer, "/workers", "{body}");
    }
    for body in [json!({}), json!({"workers": 1, "size": 2}), json!([])] {
        refused(send(&farm, Method::PUT, "/v1/pool", &[], &body.to_string()).await, 422, "wrong_body").await;
    }
    refused(send(&farm, Method::PUT, "/v1/pool", &[], "{").await, 400, "not_json").await;
    refused(send(&farm, Method::PUT, "/v1/pool", &[], &" ".repeat(5000)).await, 413, "too_large").await;
    farm.stop().await;
}

#[tokio::test]
async fn foreign_hosts_and_origins_are_rejected() {
    let farm = Farm::start().await;
    for host in ["evil.example", "evil.example:8080", "localhost.evil.example", "evil@127.0.0.1"] {
        refused(send(&farm, Method::GET, "/livez", &[(HOST, host)], "").await, 403, "foreign_host").await;
        refused(send(&farm, Method::POST, "/v1/jobs", &[(HOST, host)], "{}").await, 403, "foreign_host").await;
    }
    for host in ["localhost", "localhost:1234", "127.0.0.1", "[::1]:80"] {
        assert_eq!(send(&farm, Method::GET, "/livez", &[(HOST, host)], "").await.status(), StatusCode::OK, "{host}");
    }
    let body = small_job(1).to_string();
    for origin in ["http://evil.example", "null", "https://localhost:1"] {
        refused(send(&farm, Method::POST, "/v1/jobs", &[(ORIGIN, origin)], &body).await, 403, "foreign_origin").await;
        refused(send(&farm, Method::PUT, "/v1/pool", &[(ORIGIN, origin)], "{}").await, 403, "foreign_origin").await;
    }
    let own = format!("http://{}", farm.address);
    let both = [(ORIGIN, own.as_str()), (ORIGIN, "http://evil.example")];
    refused(send(&farm, Method::POST, "/v1/jobs", &both, &body).await, 400, "wrong_request").await;
    assert_eq!(send(&farm, Method::POST, "/v1/jobs", &[(ORIGIN, &own)], &body).await.status(), StatusCode::CREATED);
    farm.stop().await;
}

#[tokio::test]
async fn workers_with_invalid_token_release_or_name_are_rejected() {
    let farm = Farm::start().await;
    for route in [worker_protocol::REGISTER_PATH, worker_protocol::SYNC_PATH] {
        let token = [(AUTHORIZATION, "Bearer nonsense")];
        let answer = send(&farm, Method::POST, route, &token, "{}").await;
        assert_eq!(answer.headers()["www-authenticate"], "Bearer");
        refused(answer, 401, "wrong_token").await;
    }
    let hello = json!({"name": "old", "device": "cpu", "picture_version": 0, "max_nodes": null, "process": 1});
    refused(farm.post(worker_protocol::REGISTER_PATH, hello.to_string()).await, 422, "wrong_picture_version").await;
    refused(farm.post(worker_protocol::REGISTER_PATH, "{}").await, 422, "wrong_body").await;
    let mut stranger = farm.worker("known").await;
    stranger.id = proto::WorkerId::new();
    refused(stranger.try_sync(Said::default()).await, 404, "unknown_worker").await;
    farm.stop().await;
}

#[tokio::test]
async fn bytes_that_do_not_match_their_hash_are_not_stored() {
    let farm = Farm::start().await;
    let worker = farm.worker("liar").await;
    let hash = blake3::hash(b"the truth").to_hex().to_string();
    for path in [worker_protocol::blob_path(&hash), worker_protocol::picture_path(&hash)] {
        refused(worker.put(&path, b"a lie".to_vec()).await, 422, "wrong_bytes").await;
    }
    refused(farm.get(&worker_protocol::blob_path(&hash)).await, 404, "unknown_blob").await;
    refused(
        worker.put(&worker_protocol::blob_path("../../farm.sqlite"), b"a lie".to_vec()).await,
        404,
        "unknown_route",
    )
    .await;
    refused(worker.put(&worker_protocol::blob_path("..%2Ffarm.sqlite"), b"a lie".to_vec()).await, 422, "wrong_hash")
        .await;
    for folder in ["tiles", "pictures"] {
        assert_eq!(std::fs::read_dir(farm.folder.path().join(folder)).expect("lists").count(), 0);
    }
    farm.stop().await;
}

#[tokio::test]
async fn a_request_keeps_the_id_it_sends() {
    let farm = Farm::start().await;
    let id = HeaderName::from_static("x-request-id");
    let answer = send(&farm, Method::GET, "/v1/jobs/0", &[(id.clone(), "abc-1")], "").await;
    let problem = refused(answer, 404, "unknown_job").await;
    assert_eq!(problem.request_id.as_deref(), Some("abc-1"));
    let answer = send(&farm, Method::GET, "/livez", &[(id.clone(), "a b")], "").await;
    assert_ne!(answer.headers()[&id], "a b");
    farm.stop().await;
}

#[tokio::test]
async fn the_documentation_page_loads_nothing_from_other_servers() {
    let farm = Farm::start().await;
    let document: serde_json::Value = read(farm.get("/openapi.json").await, StatusCode::OK).await;
    assert!(document["openapi"].as_str().is_some_and(|version| version.starts_with("3.1")), "{}", document["openapi"]);
    for path in ["/v1/jobs", "/v1/jobs/{id}", "/v1/jobs/{id}/image", "/v1/pool", "/metrics"] {
        assert!(document["paths"][path].is_object(), "{path}");
    }
    assert!(document["components"]["schemas"]["Job"]["properties"]["scene"].is_object());
    let page = farm.get("/docs/").await;
    assert_eq!(page.status(), StatusCode::OK);
    let page = in_time(page.text()).await.expect("text");
    assert!(!page.contains("//cdn") && !page.contains("https://"), "{page}");
    let schema: serde_json::Value = read(farm.get("/v1/schema/job").await, StatusCode::OK).await;
    // Compared as text and parsed again: parsing may round a fraction differently than serializing.
    let known: serde_json::Value = serde_json::from_str(&scene::editor_schema().to_string()).expect("JSON");
    assert_eq!(schema, known);
    farm.stop().await;
}
