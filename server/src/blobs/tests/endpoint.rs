//! Endpoints that behave worse than S3: they ignore conditions, do not know them, or fail for a while.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};

use axum::Router;
use axum::body::Bytes;
use axum::extract::{Request, State};
use axum::http::{Method, StatusCode, header};
use axum::response::{IntoResponse, Response};

use super::*;

const LISTED: &str = "<ListBucketResult><IsTruncated>false</IsTruncated></ListBucketResult>";
const DELETED: &str = "<DeleteResult><Deleted><Key>any</Key></Deleted></DeleteResult>";

/// Endpoint with one object.
#[derive(Debug, Default)]
struct Endpoint {
    object: Mutex<Bytes>,
    /// Whether conditions are answered with 501.
    knows_no_conditions: bool,
    /// Answer to every request.
    fixed: Option<(StatusCode, &'static str)>,
    /// Requests that are answered with 503 before the others.
    failures_left: AtomicU32,
    requests: AtomicU32,
}

impl Endpoint {
    async fn answer(State(this): State<Arc<Self>>, request: Request) -> Response {
        this.requests.fetch_add(1, Ordering::Relaxed);
        let fails = this.failures_left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1));
        if fails.is_ok() {
            return StatusCode::SERVICE_UNAVAILABLE.into_response();
        }
        if let Some(answer) = this.fixed {
            return answer.into_response();
        }
        let is_list = request.uri().query().is_some_and(|query| query.contains("list-type"));
        match *request.method() {
            Method::GET if is_list => LISTED.into_response(),
            Method::GET => {
                let modified = [(header::LAST_MODIFIED, "Thu, 01 Jan 2026 00:00:00 GMT"), (header::ETAG, "\"1\"")];
                (modified, this.object.lock().expect("no holder panics").clone()).into_response()
            }
            Method::PUT if this.knows_no_conditions && request.headers().contains_key(header::IF_NONE_MATCH) => {
                StatusCode::NOT_IMPLEMENTED.into_response()
            }
            Method::PUT => {
                let body = axum::body::to_bytes(request.into_body(), 1 << 20).await.expect("a body");
                *this.object.lock().expect("no holder panics") = body;
                [(header::ETAG, "\"1\"")].into_response()
            }
            _ => DELETED.into_response(),
        }
    }

    /// Serves until the test ends; returns the settings of its clients.
    async fn serve(self: &Arc<Self>) -> [(&'static str, String); 5] {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("an address");
        let router = Router::new().fallback(Self::answer).with_state(Arc::clone(self));
        tokio::spawn(async move { axum::serve(listener, router).await });
        [
            ("AWS_ACCESS_KEY_ID", "key".to_owned()),
            ("AWS_SECRET_ACCESS_KEY", "secret".to_owned()),
            ("AWS_REGION", "us-east-1".to_owned()),
            ("AWS_ENDPOINT_URL", format!("http://{address}")),
            ("AWS_ALLOW_HTTP", "true".to_owned()),
        ]
    }
}

#[tokio::test]
async fn an_endpoint_without_create_if_absent_is_refused() {
    for knows_no_conditions in [false, true] {
        let endpoint = Arc::new(Endpoint { knows_no_conditions, ..Endpoint::default() });
        let (location, bucket) = location("s3://renders/farm");
        let settings = Settings::from_env(&location, &bucket).with(&endpoint.serve().await);
        let error = settings.check().await.expect_err("conditions have no effect");
        assert_eq!(error.fault(), BucketFault::NoConditionalPut, "{error}");
    }
}

/// The answer of `SeaweedFS` to a request that was signed an hour ago.
const SKEWED: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<Error><Code>RequestTimeTooSkewed</Code><Message>The difference between the request time and the server&#39;s time is too large.</Message><Resource>/renders</Resource><RequestId>18EB316FDE9E8F072B631DFB</RequestId><BucketName>renders</BucketName></Error>"#;

#[tokio::test]
async fn a_wrong_clock_and_another_kind_of_server_are_explained() {
    for (fixed, fault, words) in [
        (
            (StatusCode::FORBIDDEN, SKEWED),
            BucketFault::ClockSkewed,
            "(RequestTimeTooSkewed: The difference between the request time and the server's time is too large)",
        ),
        ((StatusCode::OK, "<html>Hello</html>"), BucketFault::Failed, "did not answer as an S3 store does"),
        ((StatusCode::NOT_FOUND, "nothing here"), BucketFault::Failed, "did not answer as an S3 store does"),
        ((StatusCode::BAD_GATEWAY, "no upstream"), BucketFault::Unavailable, "502 Bad Gateway: no upstream"),
    ] {
        let endpoint = Arc::new(Endpoint { fixed: Some(fixed), ..Endpoint::default() });
        let (location, bucket) = location("s3://renders/farm");
        let settings = Settings::from_env(&location, &bucket).with(&endpoint.serve().await);
        let error = settings.check().await.expect_err("it is no S3 store, or refuses");
        assert_eq!(error.fault(), fault, "{error}");
        let received = error.to_string();
        assert!(received.contains(words) && received.contains(fault.cure()), "{received}");
        println!("{received}");
    }
}

#[tokio::test]
async fn a_request_that_fails_is_sent_again() {
    let endpoint = Arc::new(Endpoint { failures_left: AtomicU32::new(3), ..Endpoint::default() });
    let (location, bucket) = location("s3://renders/farm");
    let opened = Settings::from_env(&location, &bucket).with(&endpoint.serve().await).open().expect("opens");
    let data = data();
    let store = BlobStore::with_bucket(&location, Bucket::S3(opened), data.path(), MIN_OBJECT_SWEEP_AGE);
    let bytes = content(1, 1000);
    let name = put(&store, PICTURE, &bytes).await;
    assert_eq!(endpoint.requests.load(Ordering::Relaxed), 4);
    assert_eq!(read(&store, PICTURE, &name, None).await, Some(bytes));
}

#[tokio::test]
async fn errors_name_the_object_and_the_cure() {
    let endpoint = Arc::new(Endpoint { failures_left: AtomicU32::new(u32::MAX), ..Endpoint::default() });
    let (location, bucket) = location("s3://renders/farm");
    let opened = Settings::from_env(&location, &bucket).with(&endpoint.serve().await).without_retries();
    let data = data();
    let store = BlobStore::with_bucket(&location, Bucket::S3(opened), data.path(), MIN_OBJECT_SWEEP_AGE);
    let error =
        store.put(PICTURE, &name(b"x"), chunks(&Bytes::from_static(b"x")), u64::MAX).await.expect_err("it fails");
    let words = error.to_string();
    let key = format!("the store s3://renders/farm could not write pictures/{}; ", name(b"x").as_str());
    assert!(words.starts_with(&key) && words.ends_with(BucketFault::Unavailable.cure()), "{words}");
    assert!(!error.is_full());
}
