//! Whether the server lives, is ready, and what it counts.

use std::fmt::Write;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde_json::{Value, json};

use super::error::ApiError;
use crate::farm::Farm;

/// Is the process up?
#[utoipa::path(
    get, path = "/livez", tag = "health", operation_id = "livez",
    responses((status = 200, description = "It is", body = String))
)]
pub(super) async fn livez() -> &'static str {
    "ok\n"
}

/// Are database and store usable?
#[utoipa::path(
    get, path = "/readyz", tag = "health", operation_id = "readyz",
    responses(
        (status = 200, description = "They are; without a worker the status is `degraded`"),
        (status = 503, description = "The database is damaged", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
        (status = 507, description = "The disk is full", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
    )
)]
pub(super) async fn readyz(State(farm): State<Arc<Farm>>) -> Result<Json<Value>, ApiError> {
    farm.queue.check().await?;
    farm.pictures.check().await?;
    let workers = farm.queue.workers().await?.workers;
    let status = if workers.is_empty() { "degraded" } else { "ready" };
    let names: Vec<String> = workers.into_iter().map(|worker| worker.name).collect();
    Ok(Json(json!({ "status": status, "database": "ok", "store": "ok", "workers": names })))
}

/// Counts, in the Prometheus text format.
#[utoipa::path(
    get, path = "/metrics", tag = "health", operation_id = "metrics",
    responses((status = 200, description = "Counts", body = String))
)]
pub(super) async fn metrics(State(farm): State<Arc<Farm>>) -> Result<Response, ApiError> {
    let counts = farm.queue.metrics().await?;
    let mut text = String::new();
    for (name, help, states) in [
        ("sdfarm_jobs", "Jobs by state.", counts.jobs),
        ("sdfarm_tiles", "Tiles and stitches by state.", counts.tiles),
        ("sdfarm_workers", "Workers by state.", counts.workers),
    ] {
        push(&mut text, name, help, "gauge");
        for (state, number) in states {
            line(&mut text, &format!("{name}{{state=\"{state}\"}} {number}"));
        }
    }
    push(&mut text, "sdfarm_pool_workers", "Local workers asked for.", "gauge");
    line(&mut text, &format!("sdfarm_pool_workers {}", farm.pool.wanted()));
    for (name, help, total) in [
        ("sdfarm_leases_expired_total", "Leases that ran out since the start.", &farm.totals.expired),
        ("sdfarm_results_fenced_total", "Results without effect, for their lease had ended.", &farm.totals.fenced),
    ] {
        push(&mut text, name, help, "counter");
        line(&mut text, &format!("{name} {}", total.load(Ordering::Relaxed)));
    }
    Ok(([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text).into_response())
}

fn push(text: &mut String, name: &str, help: &str, kind: &str) {
    line(text, &format!("# HELP {name} {help}\n# TYPE {name} {kind}"));
}

fn line(text: &mut String, line: &str) {
    writeln!(text, "{line}").expect("writing to a string");
}
