//! Limits of what a bucket may answer: the client of S3 keeps the text of an error and a page of a listing in memory,
//! however large they are.

use async_trait::async_trait;
use http_body_util::{BodyExt, Limited};
use object_store::client::{
    ClientOptions, HttpClient, HttpConnector, HttpError, HttpErrorKind, HttpRequest, HttpResponse, HttpResponseBody,
    HttpService, ReqwestConnector,
};
use reqwest::{Method, header};

use super::ContentKind;

/// Maximum size of an answer that is no object: a page of a listing has at most 1,000 names of 1,024 bytes.
const MAX_TEXT_BYTES: u64 = 8 << 20;

/// Connects clients that read no more of an answer than it may have.
#[derive(Debug)]
pub(super) struct BoundedConnector;

impl HttpConnector for BoundedConnector {
    fn connect(&self, options: &ClientOptions) -> object_store::Result<HttpClient> {
        Ok(HttpClient::new(BoundedClient(ReqwestConnector::default().connect(options)?)))
    }
}

#[derive(Debug)]
struct BoundedClient(HttpClient);

#[async_trait]
impl HttpService for BoundedClient {
    async fn call(&self, request: HttpRequest) -> Result<HttpResponse, HttpError> {
        let object_bytes = max_object_bytes(&request);
        let (parts, body) = self.0.execute(request).await?.into_parts();
        let max_bytes = object_bytes.filter(|_| parts.status.is_success()).unwrap_or(MAX_TEXT_BYTES);
        let limited =
            Limited::new(body, max_bytes as usize).map_err(move |error| match error.downcast::<HttpError>() {
                Ok(error) => *error,
                Err(_) => HttpError::new(HttpErrorKind::Decode, TooLong { max_bytes }),
            });
        Ok(HttpResponse::from_parts(parts, HttpResponseBody::new(limited)))
    }
}

/// Maximum size of the object, or of the range of one, that a request asks for; `None` if it asks for none.
fn max_object_bytes(request: &HttpRequest) -> Option<u64> {
    if request.method() != Method::GET || request.uri().query().is_some() {
        return None;
    }
    let largest = ContentKind::ALL.map(ContentKind::max_bytes).into_iter().max().unwrap_or_default();
    let range = request.headers().get(header::RANGE).and_then(|range| range.to_str().ok()?.strip_prefix("bytes="));
    let ends = range.and_then(|range| range.split_once('-'));
    let ends = ends.and_then(|(first, last)| Some((first.parse::<u64>().ok()?, last.parse::<u64>().ok()?)));
    Some(ends.map_or(largest, |(first, last)| last.saturating_sub(first).saturating_add(1)))
}

#[derive(Debug, thiserror::Error)]
#[error("the answer has more than {max_bytes} bytes")]
struct TooLong {
    max_bytes: u64,
}
