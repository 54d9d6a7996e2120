//! Signed links: created by callers who may read a picture, valid for any client until they expire.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Uri, header};
use axum::response::Response;
use proto::link::{LinkContent, LinkRequest, LinkView};
use serde::Deserialize;

use crate::clock::rfc3339;
use crate::http::body::{self, RequestBody};
use crate::http::error::ApiError;
use crate::http::frames::images::{self, StoredPictures};
use crate::http::frames::previews::{PreviewClient, Previews};
use crate::http::jobs::job_id;
use crate::queue::{Queue, StoredImage};
use crate::signed_links::{LinkClaims, LinkSigner};

/// Under this name, which no key has, previews of links wait for a helper.
const LINK_READER: &str = " links";
/// Maximum size of a request body.
const MAX_BYTES: usize = 4 << 10;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LinkQuery {
    expires: i64,
    signature: String,
}

/// Sign a link to a frame's picture.
///
/// Any client with the link can read that picture without a key until the link expires. The picture need not
/// be stored yet.
#[utoipa::path(
    post, path = "", tag = "pictures", operation_id = "sign_link",
    params(
        ("id" = String, Path, description = "The job"),
        ("frame" = u32, Path, description = "The frame, from 0"),
    ),
    request_body(content = ref("#/components/schemas/LinkRequest"), content_type = "application/json"),
    responses((status = 200, description = "The link", body = ref("#/components/schemas/LinkView")))
)]
pub(in crate::http) async fn sign(
    State(links): State<Arc<LinkSigner>>,
    State(queue): State<Queue>,
    Path((id, frame)): Path<(String, String)>,
    headers: HeaderMap,
    request: RequestBody,
) -> Result<Json<LinkView>, ApiError> {
    let requested: LinkRequest = body::read_json(&headers, request, MAX_BYTES).await?;
    let (job, frame) = images::frame_of(&queue, &id, &frame).await?;
    match queue.image(job, frame).await? {
        StoredImage::Stored { .. } | StoredImage::NotYet(_) => {}
        StoredImage::NoFrame(frames) => return Err(ApiError::UnknownFrame { job, frame: frame.to_string(), frames }),
        StoredImage::NoJob => return Err(ApiError::UnknownJob(id)),
    }
    let expires_seconds = queue.wall_seconds() + i64::from(requested.expires_in_seconds);
    let signature = links.sign(&LinkClaims { job, frame, content: requested.shows, expires_seconds });
    Ok(Json(LinkView {
        url: format!(
            "/v1/pictures/{job}/{frame}/{}?expires={expires_seconds}&signature={signature}",
            requested.shows.name()
        ),
        expires_at: rfc3339(expires_seconds.saturating_mul(1000)),
    }))
}

/// Get a picture by a signed link.
///
/// Needs no key: the link's signature authorizes the request.
#[utoipa::path(
    get, path = "", tag = "pictures", operation_id = "follow_link", security(()),
    params(
        ("id" = String, Path, description = "The job"),
        ("frame" = u32, Path, description = "The frame, from 0"),
        ("content" = String, Path, description = "`image` or `preview`"),
        ("expires" = i64, Query, description = "Expiry of the link, in seconds since 1970"),
        ("signature" = String, Query, description = "Signature of the link"),
    ),
    responses(
        (status = 200, description = "The picture: image/png or image/x-exr, depending on the job", body = Vec<u8>, content_type = "image/*"),
        (status = 206, description = "The requested range"),
        (status = 304, description = "The client has the current version"),
        (status = 307, description = "The picture is at this address for five minutes; only with --redirect-pictures"),
    )
)]
pub(in crate::http) async fn follow(
    State(links): State<Arc<LinkSigner>>,
    State(stored): State<StoredPictures>,
    State(previews): State<Previews>,
    Path((id, frame, content)): Path<(String, String, String)>,
    uri: Uri,
    method: Method,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let signed: LinkQuery = body::read_query(&uri)?;
    let content = [LinkContent::Image, LinkContent::Preview].into_iter().find(|known| known.name() == content);
    let (Ok(job), Ok(frame), Some(content)) = (job_id(&id), frame.parse(), content) else {
        return Err(ApiError::WrongSignature);
    };
    let linked = LinkClaims { job, frame, content, expires_seconds: signed.expires };
    if !links.verify(&linked, &signed.signature) {
        return Err(ApiError::WrongSignature);
    }
    if stored.queue.wall_seconds() >= signed.expires {
        return Err(ApiError::LinkExpired(rfc3339(signed.expires.saturating_mul(1000))));
    }
    let mut response = match content {
        LinkContent::Image => stored.answer(job, frame, &method, &headers).await?,
        LinkContent::Preview => {
            let reader = PreviewClient { name: LINK_READER, headers: &headers };
            previews.answer(reader, job, frame, None).await?
        }
    };
    if response.status() != StatusCode::TEMPORARY_REDIRECT {
        // A cached copy must be revalidated, or it would outlive the link.
        response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("private, no-cache"));
    }
    response.headers_mut().insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    Ok(response)
}
