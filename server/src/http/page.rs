//! The page: the files of `web/`, which are part of this program, as browsers get them under `/` and `/ui/`.
//!
//! It has no data of the farm: the page requests those as any client does, with a key if the farm needs one.

pub(super) mod docs;
pub(super) mod read_only;
pub(super) mod start_page;

use std::collections::HashMap;
use std::io::Write as _;
use std::sync::{LazyLock, PoisonError, RwLock};

use axum::body::Body;
use axum::extract::{Path, Request};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use flate2::Compression;
use flate2::write::GzEncoder;
use rust_embed::{EmbeddedFile, RustEmbed};

use crate::http::error::ApiError;
use crate::http::frames::{images, range};

/// Digits of a file's hash in its entity tag.
const TAG_DIGITS: usize = 32;
/// Name of the page itself.
const INDEX: &str = "index.html";
/// Content security policy: only files of this server, no inline script or style, and no other site around the page.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; \
                      connect-src 'self'; worker-src 'self'; base-uri 'none'; form-action 'none'; \
                      frame-ancestors 'none'";
/// Headers of every file.
const HEADERS: [(HeaderName, &str); 4] = [
    (header::CONTENT_SECURITY_POLICY, POLICY),
    (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    (header::CACHE_CONTROL, "no-cache"),
];
/// Media types by the end of a file's name, and whether such files are compressed. Others are not served.
const KINDS: [(&str, &str, bool); 7] = [
    (".html", "text/html; charset=utf-8", true),
    (".js", "text/javascript; charset=utf-8", true),
    (".css", "text/css; charset=utf-8", true),
    (".svg", "image/svg+xml", true),
    (".txt", "text/plain; charset=utf-8", true),
    (".webp", "image/webp", false),
    (".json", "application/json", true),
];

/// Files of the page.
#[derive(RustEmbed)]
#[folder = "../web"]
#[exclude = "*.md"]
#[exclude = "tsconfig.json"]
#[exclude = "vendor/build/*"]
struct WebFiles;

/// Compressed files by the hash of the original.
static COMPRESSED: LazyLock<RwLock<HashMap<[u8; 32], Bytes>>> = LazyLock::new(RwLock::default);

/// Returns the page.
pub(super) fn index(request: &Request) -> Result<Response, ApiError> {
    let mut response = serve(INDEX, request)?;
    response.headers_mut().insert(header::VARY, HeaderValue::from_static("accept, accept-encoding"));
    Ok(response)
}

/// Returns a file of the page.
pub(super) async fn file(Path(name): Path<String>, request: Request) -> Result<Response, ApiError> {
    serve(&name, &request)
}

fn serve(name: &str, request: &Request) -> Result<Response, ApiError> {
    let unknown =
        || ApiError::UnknownRoute { method: request.method().to_string(), path: request.uri().path().to_owned() };
    let (_, media_type, is_text) = KINDS.iter().find(|(end, _, _)| name.ends_with(end)).ok_or_else(unknown)?;
    let file = Some(name).filter(|name| is_plain(name)).and_then(content).ok_or_else(unknown)?;
    let is_compressed = *is_text && accepts_gzip(request.headers());
    let hash = file.metadata.sha256_hash();
    let tag = entity_tag(&hash, is_compressed);
    let known = request.headers().get(header::IF_NONE_MATCH).and_then(|value| value.to_str().ok());
    let mut response = if known.is_some_and(|named| range::matches_etag(named, &tag)) {
        StatusCode::NOT_MODIFIED.into_response()
    } else if is_compressed {
        let mut response = Body::from(compressed(hash, &file)?).into_response();
        images::set(&mut response, header::CONTENT_ENCODING, "gzip");
        response
    } else {
        Body::from(file.data.into_owned()).into_response()
    };
    for (name, value) in HEADERS {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    images::set(&mut response, header::CONTENT_TYPE, media_type);
    images::set(&mut response, header::ETAG, &tag);
    images::set(&mut response, header::VARY, "accept-encoding");
    Ok(response)
}

/// A file of the page. A debug build reads it from the folder if that is there, so that an edit is seen without a build.
fn content(name: &str) -> Option<EmbeddedFile> {
    let is_served = name != "tsconfig.json" && !name.starts_with("vendor/build/");
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../web");
    let edited = || rust_embed::utils::read_file_from_fs(&folder.join(name)).ok();
    let on_disk = if cfg!(debug_assertions) && is_served { edited() } else { None };
    on_disk.or_else(|| WebFiles::get(name))
}

/// Whether a name is folders and a file of plain letters, so that it means the same on every system.
fn is_plain(name: &str) -> bool {
    let is_letter = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
    name.split('/').all(|part| !part.is_empty() && !part.starts_with('.') && part.chars().all(is_letter))
}

/// Strong entity tag: another encoding has another one.
fn entity_tag(hash: &[u8; 32], is_compressed: bool) -> String {
    let digits = blake3::Hash::from_bytes(*hash).to_hex();
    let encoding = if is_compressed { "-gzip" } else { "" };
    format!("\"{}{encoding}\"", &digits[..TAG_DIGITS])
}

/// The file in gzip, compressed at its first request.
fn compressed(hash: [u8; 32], file: &EmbeddedFile) -> Result<Bytes, ApiError> {
    // A panic while the map is locked leaves it as it was.
    if let Some(known) = COMPRESSED.read().unwrap_or_else(PoisonError::into_inner).get(&hash) {
        return Ok(known.clone());
    }
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    let bytes = encoder.write_all(&file.data).and_then(|()| encoder.finish());
    let bytes = Bytes::from(bytes.map_err(|error| ApiError::Internal(error.to_string().into()))?);
    COMPRESSED.write().unwrap_or_else(PoisonError::into_inner).insert(hash, bytes.clone());
    Ok(bytes)
}

/// Whether the client accepts gzip.
fn accepts_gzip(headers: &HeaderMap) -> bool {
    let values = headers.get_all(header::ACCEPT_ENCODING).iter().filter_map(|value| value.to_str().ok());
    values.flat_map(|value| value.split(',')).any(|coding| {
        let (name, weight) = coding.split_once(';').unwrap_or((coding, ""));
        let weight = weight.trim().strip_prefix("q=").and_then(|number| number.parse::<f32>().ok());
        name.trim().eq_ignore_ascii_case("gzip") && weight != Some(0.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gzip_is_sent_only_to_clients_that_name_it() {
        for (accepted, is_gzip) in [
            ("gzip, deflate, br, zstd", true),
            ("br;q=1.0, GZIP;q=0.8", true),
            ("gzip;q=0", false),
            ("gzip; q=0.000", false),
            ("identity", false),
            ("*", false),
        ] {
            let headers = [(header::ACCEPT_ENCODING, HeaderValue::from_static(accepted))].into_iter().collect();
            assert_eq!(accepts_gzip(&headers), is_gzip, "{accepted}");
        }
        assert!(!accepts_gzip(&HeaderMap::new()));
    }

    #[test]
    fn every_file_has_a_media_type_and_a_plain_name() {
        let files: Vec<_> = WebFiles::iter().collect();
        assert!(files.iter().any(|name| name == INDEX), "{files:?}");
        for name in files {
            let has_type = KINDS.iter().any(|(end, _, _)| name.ends_with(end));
            assert!(has_type && is_plain(&name), "{name} would not be served");
        }
    }
}
