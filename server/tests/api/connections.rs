//! Connections: idle ones, too many of them, slow bodies, and TLS.

use std::path::Path;

use proto::api_key::Scope;
use proto::job::JobView;
use proto::worker_protocol::REGISTER_PATH;
use proto::{Client, ClientAuth, ClientError, JobId};
use rcgen::{BasicConstraints, CertificateParams, IsCa, Issuer, KeyPair};
use reqwest::{Method, Response, StatusCode};
use server::{StartError, TlsFiles};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use super::harness::{Farm, config, in_time, read, refused, small_job};
use super::keys::{locked_farm, locked_farm_with, make, new_key, send};

/// A certificate authority for tests.
struct Authority {
    issuer: Issuer<'static, KeyPair>,
    pem: String,
}

impl Authority {
    fn new() -> Self {
        let key = KeyPair::generate().expect("a key");
        let mut params = CertificateParams::new(Vec::new()).expect("no names");
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let pem = params.self_signed(&key).expect("a certificate").pem();
        Self { issuer: Issuer::new(params, key), pem }
    }

    /// Writes a certificate for this machine, its key, and the CA certificate.
    fn write(&self, folder: &Path) -> TlsFiles {
        let key = KeyPair::generate().expect("a key");
        let names = vec!["localhost".to_owned(), "127.0.0.1".to_owned()];
        let certificate = CertificateParams::new(names).expect("names").signed_by(&key, &self.issuer);
        let files = TlsFiles { certificate: folder.join("cert.pem"), key: folder.join("key.pem") };
        std::fs::write(&files.key, key.serialize_pem()).expect("written");
        std::fs::write(&files.certificate, certificate.expect("a certificate").pem()).expect("written");
        std::fs::write(folder.join("ca.pem"), &self.pem).expect("written");
        files
    }
}

fn client(farm: &Farm, authority: &Path) -> Client {
    let access = ClientAuth::new(None, Some(authority)).expect("an authority");
    Client::with_auth(&format!("https://{}", farm.address), access).expect("a client")
}

#[tokio::test]
async fn health_responds_when_every_connection_is_idle() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let farm = Farm::start_in(folder, |config| config.max_connections = 8).await;
    let mut idle = Vec::new();
    for number in 0..40 {
        let mut stream = TcpStream::connect(farm.address).await.expect("connects");
        // Half of the connections send the beginning of a request.
        if number % 2 == 0 {
            stream.write_all(b"GET /livez HTTP/1.1\r\nHost: loc").await.expect("written");
        }
        idle.push(stream);
    }
    assert_eq!(farm.get("/livez").await.status(), StatusCode::OK);
    assert_eq!(farm.get("/v1/jobs").await.status(), StatusCode::OK);
    let mut first = idle.swap_remove(0);
    let mut rest = Vec::new();
    // The oldest connection was evicted first.
    drop(in_time(first.read_to_end(&mut rest)).await);
    farm.stop().await;
}

#[tokio::test]
async fn oversized_heads_and_too_many_headers_are_rejected() {
    let farm = Farm::start().await;
    for head in [format!("X-Long: {}\r\n", "x".repeat(100 << 10)), "X: y\r\n".repeat(200)] {
        let mut stream = TcpStream::connect(farm.address).await.expect("connects");
        let request = format!("GET /livez HTTP/1.1\r\nHost: localhost\r\n{head}\r\n");
        // The server may close the connection before it has received everything.
        drop(stream.write_all(request.as_bytes()).await);
        let mut answer = vec![0; 12];
        in_time(stream.read_exact(&mut answer)).await.expect("a response");
        assert_eq!(answer, b"HTTP/1.1 431");
    }
    assert_eq!(farm.get("/livez").await.status(), StatusCode::OK);
    farm.stop().await;
}

#[tokio::test]
async fn clients_that_trust_the_ca_connect_over_https() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let certificates = tempfile::tempdir().expect("a temporary folder");
    let authority = Authority::new();
    let files = authority.write(certificates.path());
    let farm = Farm::start_in(folder, |config| config.tls = Some(files)).await;
    let trusting = client(&farm, &certificates.path().join("ca.pem"));
    assert!(in_time(trusting.jobs(None, 1, None)).await.expect("a response").jobs.is_empty());

    let others = tempfile::tempdir().expect("a temporary folder");
    Authority::new().write(others.path());
    let wary = client(&farm, &others.path().join("ca.pem"));
    let error = in_time(wary.jobs(None, 1, None)).await.expect_err("another authority");
    assert!(matches!(error, ClientError::Unreachable { .. } | ClientError::ConnectionLost { .. }), "{error:?}");

    // Plain HTTP is not a TLS handshake, and affects no other connection.
    let plain = in_time(farm.client.get(farm.url("/livez")).send()).await;
    assert!(plain.is_err());
    assert!(in_time(trusting.jobs(None, 1, None)).await.is_ok());
    farm.stop().await;
}

#[tokio::test]
async fn a_new_certificate_is_used_without_a_restart() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let certificates = tempfile::tempdir().expect("a temporary folder");
    let files = Authority::new().write(certificates.path());
    let farm = Farm::start_in(folder, |config| config.tls = Some(files)).await;
    let ca = certificates.path().join("ca.pem");
    assert!(in_time(client(&farm, &ca).jobs(None, 1, None)).await.is_ok());
    Authority::new().write(certificates.path());
    in_time(async {
        while client(&farm, &ca).jobs(None, 1, None).await.is_err() {
            tokio::task::yield_now().await;
        }
    })
    .await;
    farm.stop().await;
}

#[tokio::test]
async fn unusable_certificates_are_named_in_the_error() {
    let certificates = tempfile::tempdir().expect("a temporary folder");
    let others = tempfile::tempdir().expect("a temporary folder");
    let good = Authority::new().write(certificates.path());
    let other = Authority::new().write(others.path());
    std::fs::write(others.path().join("empty.pem"), "").expect("written");
    for (certificate, key, word) in [
        (others.path().join("none.pem"), good.key.clone(), "none.pem"),
        (others.path().join("empty.pem"), good.key.clone(), "empty.pem"),
        (good.certificate.clone(), others.path().join("empty.pem"), "empty.pem"),
        (good.certificate.clone(), good.certificate.clone(), "cert.pem"),
        (good.certificate.clone(), other.key.clone(), "key.pem"),
    ] {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let mut config = config(folder.path());
        config.tls = Some(TlsFiles { certificate, key });
        let error = server::Server::start(config).await.expect_err("the certificate is unusable");
        assert!(matches!(error, StartError::Tls(_)), "{error:?}");
        assert!(error.to_string().contains(word) && error.to_string().contains("--tls-cert"), "{error}");
    }
}

/// Opens an event stream of a job, which stays open; or returns the response that is not one.
async fn event_stream(farm: &Farm, key: &str, job: JobId) -> Response {
    send(farm, key, Method::GET, &format!("/v1/jobs/{job}/events"), "").await
}

#[tokio::test]
async fn a_caller_with_too_many_event_streams_leaves_places_for_others() {
    const OF_A_CALLER: usize = 10;
    let (farm, admin) = locked_farm_with(|config| {
        // 40 for users, 16 for workers, 8 for health checks and administrators.
        config.max_connections = 64;
        config.max_requests_per_caller = OF_A_CALLER as u32;
    })
    .await;
    let mut keys = Vec::new();
    for name in ["anna", "bert", "carl", "dora", "emil"] {
        keys.push(make(&farm, &admin, &new_key(name, &[Scope::Submit, Scope::Read])).await.secret);
    }
    let host = make(&farm, &admin, &new_key("host", &[Scope::Worker])).await.secret;
    let job: JobView =
        read(send(&farm, &keys[0], Method::POST, "/v1/jobs", small_job(1).to_string()).await, StatusCode::CREATED)
            .await;
    let mut streams = Vec::new();
    for key in &keys[..4] {
        for _ in 0..OF_A_CALLER {
            let stream = event_stream(&farm, key, job.id).await;
            assert_eq!(stream.status(), StatusCode::OK);
            streams.push(stream);
        }
        let over = event_stream(&farm, key, job.id).await;
        assert_eq!(over.headers()["retry-after"], "5");
        let problem = refused(over, 429, "too_many_at_once").await;
        assert!(problem.detail.contains("at most 10 requests in progress"), "{problem:?}");
    }
    // Every place of the users is taken.
    refused(event_stream(&farm, &keys[4], job.id).await, 503, "busy").await;
    assert_eq!(farm.get("/livez").await.status(), StatusCode::OK);
    assert_eq!(send(&farm, &admin, Method::GET, "/v1/jobs", "").await.status(), StatusCode::OK);
    let hello = serde_json::json!({
        "name": "host", "device": "cpu", "picture_version": scene::PICTURE_VERSION, "process": 1
    });
    let registered = send(&farm, &host, Method::POST, REGISTER_PATH, hello.to_string()).await;
    assert_eq!(registered.status(), StatusCode::OK);
    drop(streams);
    in_time(async {
        while event_stream(&farm, &keys[4], job.id).await.status() != StatusCode::OK {
            tokio::task::yield_now().await;
        }
    })
    .await;
    farm.stop().await;
}

#[tokio::test]
async fn an_unread_response_is_in_progress_until_it_is_received() {
    let (farm, admin) = locked_farm_with(|config| config.max_requests_per_caller = 1).await;
    let key = make(&farm, &admin, &new_key("anna", &[Scope::Submit])).await.secret;
    // Larger than the buffers of sockets.
    let text = small_job(1).to_string() + &" ".repeat(7 << 20);
    let job: JobView =
        read(send(&farm, &admin, Method::POST, "/v1/jobs", text.clone()).await, StatusCode::CREATED).await;
    let reader = make(&farm, &admin, &new_key("bert", &[Scope::Read])).await.secret;
    let path = format!("/v1/jobs/{}/file", job.id);
    let mut unread = TcpStream::connect(farm.address).await.expect("connects");
    let request = format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {reader}\r\n\r\n");
    unread.write_all(request.as_bytes()).await.expect("written");
    let mut start = [0; 12];
    in_time(unread.read_exact(&mut start)).await.expect("a response");
    assert_eq!(&start, b"HTTP/1.1 200");
    refused(send(&farm, &reader, Method::GET, &path, "").await, 429, "too_many_at_once").await;
    assert_eq!(send(&farm, &key, Method::GET, "/v1/jobs", "").await.status(), StatusCode::OK, "another caller");
    let mut received = 0;
    let mut buffer = vec![0; 1 << 20];
    while received < text.len() {
        received += in_time(unread.read(&mut buffer)).await.expect("the rest");
    }
    in_time(async {
        while send(&farm, &reader, Method::GET, &path, "").await.status() != StatusCode::OK {
            tokio::task::yield_now().await;
        }
    })
    .await;
    farm.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn unfinished_bodies_of_a_caller_are_bounded_together() {
    const BODY_BYTES: usize = 8 << 20;
    // Eight fit into the part of one caller.
    const BODIES: usize = 12;
    let (farm, admin) = locked_farm().await;
    let anna = make(&farm, &admin, &new_key("anna", &[Scope::Submit])).await.secret;
    let bert = make(&farm, &admin, &new_key("bert", &[Scope::Submit])).await.secret;
    let spaces = vec![b' '; BODY_BYTES - 1];
    let mut unfinished = Vec::new();
    for _ in 0..BODIES {
        let mut stream = TcpStream::connect(farm.address).await.expect("connects");
        let head = format!(
            "POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {anna}\r\nConnection: close\r\n\
             Content-Length: {BODY_BYTES}\r\n\r\n"
        );
        stream.write_all(head.as_bytes()).await.expect("written");
        in_time(stream.write_all(&spaces)).await.expect("written");
        unfinished.push(stream);
    }
    let small = send(&farm, &anna, Method::POST, "/v1/jobs", small_job(1).to_string()).await;
    assert_eq!(small.status(), StatusCode::CREATED, "small bodies are not counted");
    refused(send(&farm, &bert, Method::POST, "/v1/jobs", " ".repeat(1 << 20)).await, 400, "not_json").await;
    let (mut read_to_the_end, mut rejected) = (0, 0);
    for mut stream in unfinished {
        stream.write_all(b" ").await.expect("written");
        let mut answer = String::new();
        in_time(stream.read_to_string(&mut answer)).await.expect("a response");
        if answer.contains("not_json") {
            read_to_the_end += 1;
        } else if answer.contains("slow_body") {
            // This machine needed 20 s to send the others.
        } else {
            assert!(answer.starts_with("HTTP/1.1 429") && answer.contains("too_many_at_once"), "{answer}");
            assert!(answer.contains("retry-after: 5") && answer.contains("key anna has at most 67108864"), "{answer}");
            rejected += 1;
        }
    }
    assert!(rejected > 0 && read_to_the_end > 0, "{rejected} rejected, {read_to_the_end} read");
    refused(send(&farm, &anna, Method::POST, "/v1/jobs", spaces).await, 400, "not_json").await;
    farm.stop().await;
}

/// Head of a submission, with only part of its body.
const HALF_A_REQUEST: &str = "POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100000\r\n\r\n{\"name\":";

#[tokio::test]
#[ignore = "long: waits for the server's limit of 20 s"]
async fn a_stalled_body_times_out() {
    let farm = Farm::start().await;
    let mut stalled = TcpStream::connect(farm.address).await.expect("connects");
    stalled.write_all(HALF_A_REQUEST.as_bytes()).await.expect("written");
    let mut answer = String::new();
    in_time(stalled.read_to_string(&mut answer)).await.expect("a response");
    assert!(answer.starts_with("HTTP/1.1 408") && answer.contains("slow_body"), "{answer}");
    assert_eq!(farm.get("/livez").await.status(), StatusCode::OK);
    farm.stop().await;
}

#[tokio::test]
async fn an_interrupted_body_is_dropped_and_the_farm_continues() {
    let farm = Farm::start().await;
    let mut stalled = TcpStream::connect(farm.address).await.expect("connects");
    stalled.write_all(HALF_A_REQUEST.as_bytes()).await.expect("written");
    let mut broken = TcpStream::connect(farm.address).await.expect("connects");
    broken.write_all(HALF_A_REQUEST.as_bytes()).await.expect("written");
    broken.shutdown().await.expect("shut");
    let mut answer = String::new();
    in_time(broken.read_to_string(&mut answer)).await.expect("a response");
    assert!(answer.starts_with("HTTP/1.1 400") && answer.contains("broken_body"), "{answer}");
    assert_eq!(farm.get("/livez").await.status(), StatusCode::OK);
    refused(farm.post("/v1/jobs", "{").await, 400, "not_json").await;
    farm.stop().await;
}
