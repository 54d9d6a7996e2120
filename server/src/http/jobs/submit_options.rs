//! Options of a submission, read from headers and query: `Idempotency-Key`, webhooks.

use axum::http::{HeaderMap, Uri, header};
use reqwest::Url;

use crate::http::auth::Caller;
use crate::http::error::ApiError;
use crate::queue::{BacklogLimits, IdempotencyKey, NewWebhook, Queue, SubmitOptions};
use crate::webhooks::{AddressPolicy, EVENTS, FINAL_EVENTS};

/// Header with the idempotency key.
const IDEMPOTENCY_KEY: &str = "idempotency-key";
/// Maximum length of an idempotency key.
const MAX_KEY_BYTES: usize = 255;
/// Other query parameters of a submission.
const OTHER_PARAMETERS: [&str; 6] = ["based_on", "dry_run", "keep", "record", "set", "tile_seconds"];
/// Maximum number of values that a query sets: the text of the job is scanned for each.
const MAX_VALUES: usize = 32;
/// Maximum number of webhooks of a job.
const MAX_WEBHOOKS: usize = 4;
/// Maximum length of a webhook's address.
const MAX_URL_BYTES: usize = 2048;

/// Whether the request bypasses the picture cache.
pub(in crate::http) fn has_no_cache(headers: &HeaderMap) -> bool {
    headers
        .get_all(header::CACHE_CONTROL)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .any(|value| value.split(',').any(|directive| directive.trim().eq_ignore_ascii_case("no-cache")))
}

/// Parses the options of a job with this text.
pub(in crate::http) fn read(
    uri: &Uri,
    headers: &HeaderMap,
    text: &[u8],
    guard: &AddressPolicy,
    limits: BacklogLimits,
) -> Result<SubmitOptions, ApiError> {
    let (mut urls, mut events) = (Vec::new(), Vec::new());
    for (name, value) in query(uri)?.query_pairs() {
        match name.as_ref() {
            "webhook" => urls.push(webhook_url(&value, guard)?),
            "webhook_event" => events.push(event(&value)?),
            name if OTHER_PARAMETERS.contains(&name) => {}
            unknown => {
                return Err(ApiError::WrongQuery(format!(
                    "unknown query parameter {unknown:?}: this route has webhook, webhook_event, {}",
                    OTHER_PARAMETERS.join(", ")
                )));
            }
        }
    }
    if urls.len() > MAX_WEBHOOKS {
        return Err(ApiError::WrongQuery(format!("there are {} webhooks: send at most {MAX_WEBHOOKS}", urls.len())));
    }
    if urls.is_empty() && !events.is_empty() {
        return Err(ApiError::WrongQuery("webhook_event requires a webhook: add the parameter webhook".into()));
    }
    if events.is_empty() {
        events = FINAL_EVENTS.to_vec();
    }
    let webhooks = urls.into_iter().map(|url| NewWebhook {
        target: format!("{}:{}", url.host_str().unwrap_or_default(), url.port_or_known_default().unwrap_or_default()),
        url: url.to_string(),
        events: events.clone(),
    });
    let webhooks = webhooks.collect();
    let once = key(headers)?.map(|key| IdempotencyKey { key, fingerprint: fingerprint(uri, headers, text) });
    Ok(SubmitOptions { idempotency: once, webhooks, limits })
}

/// An address with the query of a request.
fn query(uri: &Uri) -> Result<Url, ApiError> {
    let address = format!("http://query/?{}", uri.query().unwrap_or_default());
    Url::parse(&address).map_err(|error| ApiError::WrongQuery(error.to_string()))
}

/// Paths and values that the query sets in the job: `set=numbers.r=0.3`.
pub(in crate::http) fn values(uri: &Uri) -> Result<Vec<(String, String)>, ApiError> {
    let mut values = Vec::new();
    for (_, assignment) in query(uri)?.query_pairs().filter(|(name, _)| name == "set") {
        let Some((path, value)) = assignment.split_once('=') else {
            return Err(ApiError::WrongQuery(format!(
                "set is {assignment:?}: write set=PATH=VALUE, as in numbers.r=0.3"
            )));
        };
        values.push((path.trim().to_owned(), value.trim().to_owned()));
    }
    if values.len() > MAX_VALUES {
        return Err(ApiError::WrongQuery(format!(
            "there are {} values to set: send at most {MAX_VALUES}",
            values.len()
        )));
    }
    Ok(values)
}

/// Whether the request is a replay, which adds no job to the queue.
pub(in crate::http) async fn is_replay(queue: &Queue, caller: &Caller, headers: &HeaderMap) -> Result<bool, ApiError> {
    match key(headers)? {
        Some(key) => Ok(queue.has_idempotency_key(caller.name(), &key).await?),
        None => Ok(false),
    }
}

fn webhook_url(text: &str, guard: &AddressPolicy) -> Result<Url, ApiError> {
    if text.len() > MAX_URL_BYTES {
        return Err(ApiError::WrongWebhook(format!(
            "the webhook's address has more than {MAX_URL_BYTES} bytes: use a shorter one"
        )));
    }
    guard.check(text).map_err(|error| ApiError::WrongWebhook(error.to_string()))
}

fn event(name: &str) -> Result<&'static str, ApiError> {
    EVENTS.into_iter().find(|event| *event == name).ok_or_else(|| {
        ApiError::WrongQuery(format!("webhook_event {name:?} is unknown: use one of {}", EVENTS.join(", ")))
    })
}

fn key(headers: &HeaderMap) -> Result<Option<String>, ApiError> {
    let mut keys = headers.get_all(IDEMPOTENCY_KEY).iter();
    let Some(key) = keys.next() else { return Ok(None) };
    let is_plain = |key: &&str| {
        !key.is_empty() && key.len() <= MAX_KEY_BYTES && key.bytes().all(|byte| (0x20..0x7f).contains(&byte))
    };
    match key.to_str().ok().map(str::trim).filter(is_plain) {
        Some(key) if keys.next().is_none() => Ok(Some(key.to_owned())),
        Some(_) | None => Err(ApiError::WrongHeader(format!(
            "send Idempotency-Key once, with 1 to {MAX_KEY_BYTES} printable ASCII characters"
        ))),
    }
}

/// Hash of the request: the job's text and every option that changes the outcome.
fn fingerprint(uri: &Uri, headers: &HeaderMap, text: &[u8]) -> String {
    let mut hasher = blake3::Hasher::new();
    for part in [uri.query().unwrap_or_default().as_bytes(), &[u8::from(has_no_cache(headers))], text] {
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update(part);
    }
    hasher.finalize().to_hex().to_string()
}
