//! `GET /`: the page for browsers, the farm's state as JSON for programs.
//!
//! If the farm has keys, neither contains anything that requires one.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use proto::farm::StartView;

use crate::api_keys::ApiKeys;
use crate::http::error::ApiError;
use crate::http::page;
use crate::http::state::handle_group;
use crate::telemetry::Telemetry;

handle_group! {
    /// Handles of the page.
    StartPageHandles {
        /// Say whether the farm has keys.
        api_keys: Arc<ApiKeys>,
        /// Has the counts.
        telemetry: Arc<Telemetry>,
    }
}

/// Get a summary of the farm.
///
/// Returns a page if the `Accept` header has `text/html`, otherwise JSON. If the farm has keys, the summary
/// contains nothing that requires one.
#[utoipa::path(
    get, path = "", tag = "farm", operation_id = "get_start_page",
    responses((status = 200, description = "Summary of the farm", body = ref("#/components/schemas/StartView")))
)]
pub(in crate::http) async fn get(
    State(handles): State<StartPageHandles>,
    request: Request,
) -> Result<Response, ApiError> {
    if wants_html(request.headers()) {
        return page::index(&request);
    }
    let needs_key = handles.api_keys.are_required();
    let farm = if needs_key { None } else { Some(handles.telemetry.farm_counts().await?) };
    let view = StartView {
        name: "sdfarm".to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        docs: "/docs/".to_owned(),
        openapi: "/openapi.json".to_owned(),
        job_schema: "/v1/schema/job".to_owned(),
        needs_key,
        farm,
    };
    let mut response = Json(view).into_response();
    for (name, value) in [(header::CACHE_CONTROL, "no-store"), (header::VARY, "accept, accept-encoding")] {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    Ok(response)
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
}
