//! `GET /`: the farm's state and links to the rest, as a page for browsers and as JSON for programs.
//!
//! The page loads nothing: no script, no font, no picture. If the farm has keys, it shows nothing that requires
//! one.

use std::fmt::Write as _;
use std::sync::Arc;

use axum::Json;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{Html, IntoResponse, Response};
use proto::farm::{FarmCounts, StartView};
use proto::job::{JobState, JobView};

use super::error::ApiError;
use super::state::handle_group;
use crate::api_keys::ApiKeys;
use crate::config::Config;
use crate::queue::Queue;
use crate::telemetry::Telemetry;

/// Number of newest jobs on the page.
const JOBS: u32 = 8;
const START_PAGE_HTML: &str = include_str!("start_page.html");
/// Content security policy: inline styles only, and nothing from other addresses.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; \
                      form-action 'none'; frame-ancestors 'none'";

handle_group! {
    /// Handles of the page.
    StartPageHandles {
        /// Say whether the farm has keys.
        api_keys: Arc<ApiKeys>,
        /// Has the server's address.
        config: Arc<Config>,
        /// Has the newest jobs.
        queue: Queue,
        /// Has the counts.
        telemetry: Arc<Telemetry>,
    }
}

/// Get a summary of the farm.
///
/// Returns a page if the `Accept` header has `text/html`, otherwise JSON. If the farm has keys, the summary
/// contains nothing that requires one.
#[utoipa::path(
    get, path = "/", tag = "farm", operation_id = "get_start_page",
    responses((status = 200, description = "Summary of the farm", body = ref("#/components/schemas/StartView")))
)]
pub(super) async fn get(State(handles): State<StartPageHandles>, request: Request) -> Result<Response, ApiError> {
    let wants_page = wants_html(request.headers());
    let needs_key = handles.api_keys.are_required();
    let mut view = StartView {
        name: "sdfarm".to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        docs: "/docs/".to_owned(),
        openapi: "/openapi.json".to_owned(),
        job_schema: "/v1/schema/job".to_owned(),
        needs_key,
        farm: None,
    };
    let mut jobs = Vec::new();
    if !needs_key {
        view.farm = Some(counts(&handles.queue, &handles.telemetry).await?);
        if wants_page {
            jobs = handles.queue.jobs(None, None, JOBS, None).await?.jobs;
        }
    }
    let mut response = if wants_page {
        Html(page(&view, &jobs, &address(&handles.config, &request))).into_response()
    } else {
        Json(view).into_response()
    };
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CACHE_CONTROL, "no-store"),
        (header::VARY, "accept"),
    ] {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    Ok(response)
}

/// Numbers of the farm, at most 1 s old.
async fn counts(queue: &Queue, telemetry: &Telemetry) -> Result<FarmCounts, ApiError> {
    let counts = telemetry.counts().await?;
    let jobs = |state: JobState| counts.jobs_in(state.name()).unsigned_abs();
    let ready = counts.workers.iter().filter(|group| group.state == "ready").map(|group| group.number).sum::<i64>();
    Ok(FarmCounts {
        paused: queue.is_paused().await?,
        queued: jobs(JobState::Queued),
        running: jobs(JobState::Running),
        succeeded: jobs(JobState::Succeeded),
        failed: jobs(JobState::Failed),
        cancelled: jobs(JobState::Cancelled),
        workers_ready: ready.unsigned_abs(),
    })
}

/// Whether the client accepts HTML explicitly; `*/*` alone, as curl sends it, counts as a program.
fn wants_html(headers: &HeaderMap) -> bool {
    headers
        .get_all(header::ACCEPT)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(','))
        .any(|range| {
            let mut parts = range.split(';').map(str::trim);
            let is_html = parts.next().is_some_and(|kind| {
                kind.eq_ignore_ascii_case("text/html") || kind.eq_ignore_ascii_case("application/xhtml+xml")
            });
            let is_refused = parts
                .filter_map(|part| part.strip_prefix("q="))
                .any(|quality| quality.parse::<f32>().is_ok_and(|quality| quality == 0.0));
            is_html && !is_refused
        })
}

/// Address that the client used, for the examples; the host has been checked already.
fn address(config: &Config, request: &Request) -> String {
    let scheme = if config.tls.is_some() { "https" } else { "http" };
    let named = request.uri().authority().map(|authority| authority.as_str().to_owned());
    let host =
        named.or_else(|| request.headers().get(header::HOST).and_then(|value| value.to_str().ok()).map(str::to_owned));
    format!("{scheme}://{}", host.unwrap_or_else(|| config.listen.to_string()))
}

fn page(view: &StartView, jobs: &[JobView], address: &str) -> String {
    let key = if view.needs_key { " -H \"Authorization: Bearer $SDFARM_KEY\"" } else { "" };
    let examples = format!(
        "sdfarm submit job.json --wait -o picture.png --server {address}\n\n\
         curl{key} --json @job.json {address}/v1/jobs\n\
         curl{key} {address}/v1/jobs/ID\n\
         curl{key} -o picture.png {address}/v1/jobs/ID/image"
    );
    let state = match &view.farm {
        None => {
            "<p class=\"warning\">This farm needs a key: send it as <code>Authorization: Bearer KEY</code>, or give \
                 it to sdfarm in <code>SDFARM_KEY</code>. Its administrator has keys.</p>"
                .to_owned()
        }
        Some(farm) => glance(farm, jobs),
    };
    START_PAGE_HTML
        .replace("{version}", &escaped(&view.version))
        .replace("{examples}", &escaped(&examples))
        // Replaced last, because a job's name may look like one of the placeholders above.
        .replace("{state}", &state)
}

fn glance(farm: &FarmCounts, jobs: &[JobView]) -> String {
    let FarmCounts { paused, queued, running, succeeded, failed, cancelled, workers_ready } = farm;
    let mut text = String::new();
    if *paused {
        text += "<p class=\"warning\">The farm is paused: run <code>sdfarm resume</code> to continue.</p>\n";
    } else if *workers_ready == 0 {
        text += "<p class=\"warning\">No worker is ready: <code>sdfarm pool 1</code> starts one on the server's \
                 machine.</p>\n";
    }
    let workers = if *workers_ready == 1 { "worker is" } else { "workers are" };
    writeln!(
        text,
        "<p>{running} running, {queued} queued, {succeeded} succeeded, {failed} failed, {cancelled} cancelled; \
         {workers_ready} {workers} ready.</p>"
    )
    .expect("a String takes all");
    if jobs.is_empty() {
        return text + "<p>No jobs yet.</p>";
    }
    text += "<table>\n<tr><th>Newest jobs</th><th>State</th><th>Done</th><th>Picture</th></tr>\n";
    for job in jobs {
        let state = if job.paused { "paused" } else { job.state.name() };
        let picture = match (job.frames.done, job.frames.total) {
            (0, _) => String::new(),
            (_, 1) => format!("<a href=\"/v1/jobs/{}/image\">picture</a>", job.id),
            (done, total) => format!("<a href=\"/v1/jobs/{}/frames\">{done} of {total} frames</a>", job.id),
        };
        let percent = (job.progress * 100.0).floor();
        let (id, name) = (job.id, escaped(&job.name));
        writeln!(
            text,
            "<tr><td><a href=\"/v1/jobs/{id}\">{name}</a></td><td>{state}</td><td>{percent} %</td><td>{picture}</td></tr>"
        )
        .expect("a String takes all");
    }
    text + "</table>"
}

/// Escapes text for HTML.
fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            '\'' => safe.push_str("&#39;"),
            other => safe.push(other),
        }
    }
    safe
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn browsers_get_html_and_programs_get_json() {
        for (accept, html) in [
            ("text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8", true),
            ("application/json, TEXT/HTML; q=0.5", true),
            ("*/*", false),
            ("application/json", false),
            ("text/html;q=0", false),
            ("text/htmlx", false),
        ] {
            let headers = [(header::ACCEPT, HeaderValue::from_static(accept))].into_iter().collect();
            assert_eq!(wants_html(&headers), html, "{accept}");
        }
        assert!(!wants_html(&HeaderMap::new()));
    }

    #[test]
    fn text_is_escaped_in_html() {
        assert_eq!(escaped("<a href=\"x\">'&"), "&lt;a href=&quot;x&quot;&gt;&#39;&amp;");
    }
}
