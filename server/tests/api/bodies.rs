//! Compressed bodies of submissions.

use flate2::Compression;
use flate2::write::GzEncoder;
use proto::job::JobView;
use reqwest::header::{ACCEPT_ENCODING, CONTENT_ENCODING};
use reqwest::{Response, StatusCode};
use ruzstd::encoding::{CompressionLevel, compress_to_vec};
use serde_json::{Value, json};
use std::io::Write;

use super::harness::{Farm, in_time, read, refused, small_job};

fn gzip(text: &str) -> Vec<u8> {
    let mut writer = GzEncoder::new(Vec::new(), Compression::default());
    writer.write_all(text.as_bytes()).and_then(|()| writer.finish()).expect("in memory")
}

fn zstd(text: &str) -> Vec<u8> {
    compress_to_vec(text.as_bytes(), CompressionLevel::Fastest)
}

async fn post(farm: &Farm, path: &str, encoding: &str, body: Vec<u8>) -> Response {
    let request = farm.client.post(farm.url(path)).header(CONTENT_ENCODING, encoding);
    in_time(request.header("idempotency-key", "the same").body(body).send()).await.expect("a response")
}

#[tokio::test]
async fn a_compressed_job_is_the_job_of_its_text() {
    let farm = Farm::start().await;
    let text = format!("{}\n", small_job(1));
    let first: JobView = read(post(&farm, "/v1/jobs", "gzip", gzip(&text)).await, StatusCode::CREATED).await;
    for (encoding, body) in [("zstd", zstd(&text)), ("identity", text.clone().into()), ("gzip", gzip(&text))] {
        let again: JobView = read(post(&farm, "/v1/jobs", encoding, body).await, StatusCode::OK).await;
        assert_eq!(again.id, first.id, "{encoding}");
    }
    let file = farm.get(&format!("/v1/jobs/{}/file", first.id)).await;
    assert_eq!(in_time(file.text()).await.expect("text"), text);
    let dry: Value = read(post(&farm, "/v1/jobs?dry_run=true", "gzip", gzip(&text)).await, StatusCode::OK).await;
    assert_eq!(dry["valid"], true);
    let patch = json!({ "name": "second" }).to_string();
    let path = format!("/v1/jobs/{}/resubmit?keep=1h", first.id);
    let resubmit = farm.client.post(farm.url(&path)).header(CONTENT_ENCODING, "zstd").body(zstd(&patch));
    let second: JobView = read(in_time(resubmit.send()).await.expect("a response"), StatusCode::CREATED).await;
    assert_eq!(second.name, "second");
    farm.stop().await;
}

#[tokio::test]
async fn errors_of_a_compressed_job_have_their_places_in_its_text() {
    let farm = Farm::start().await;
    let mut job = small_job(1);
    job["image"]["width"] = 0.into();
    let text = job.to_string();
    let plain = refused(farm.post("/v1/jobs", text.clone()).await, 422, "wrong_job").await;
    let packed = refused(post(&farm, "/v1/jobs", "gzip", gzip(&text)).await, 422, "wrong_job").await;
    assert_eq!(packed.errors, plain.errors);
    farm.stop().await;
}

#[tokio::test]
async fn bodies_that_unpack_to_too_much_or_to_nothing_are_rejected() {
    let farm = Farm::start().await;
    let large = " ".repeat(1 << 20);
    for (encoding, body) in [("gzip", gzip(&large)), ("zstd", zstd(&large))] {
        let half = body[..body.len() / 2].to_vec();
        let problem = refused(post(&farm, "/v1/jobs", encoding, half).await, 400, "damaged_body").await;
        assert!(problem.detail.contains(encoding) && problem.detail.contains("compress it again"), "{problem:?}");
        let problem = refused(post(&farm, "/v1/jobs", encoding, body.repeat(1 << 10)).await, 413, "too_large").await;
        assert!(problem.detail.contains("33554432") && problem.detail.contains(encoding), "{problem:?}");
    }
    let unknown = post(&farm, "/v1/jobs", "br", b"{}".to_vec()).await;
    assert_eq!(unknown.headers()[ACCEPT_ENCODING], "gzip, zstd");
    let problem = refused(unknown, 415, "wrong_content_encoding").await;
    assert!(problem.detail.contains("\"br\"") && problem.detail.contains("without Content-Encoding"), "{problem:?}");
    let pool = farm.client.put(farm.url("/v1/pool")).header(CONTENT_ENCODING, "gzip").body(gzip("{\"workers\": 1}"));
    let pool = in_time(pool.send()).await.expect("a response");
    assert_eq!(pool.headers()[ACCEPT_ENCODING], "identity");
    refused(pool, 415, "wrong_content_encoding").await;
    farm.stop().await;
}
