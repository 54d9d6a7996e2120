//! The HTTP layer: the whole API on one screen. Handlers read the request, call a service, and respond;
//! they decide nothing about jobs.

mod audit;
mod auth;
mod body;
mod content_encoding;
mod error;
mod events;
mod files;
mod frames;
mod health;
mod host_check;
mod images;
mod job_changes;
mod jobs;
mod keys;
mod links;
mod merge_patch;
mod openapi;
mod pause;
mod permissions;
mod pool;
mod prefer;
mod previews;
mod quota;
mod range;
mod request_id;
mod retention;
mod start_page;
mod state;
mod submission;
mod submit_options;
mod trace_context;
mod webhooks;
mod worker_protocol;

use std::any::Any;

use axum::extract::Request;
use axum::middleware;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post, put};
use tower_http::catch_panic::CatchPanicLayer;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;
use utoipa_swagger_ui::{Config, SwaggerUi};

pub(crate) use state::{ApiState, Handles};

use error::ApiError;
use openapi::Document;

/// Users' routes; each is documented at its handler.
fn user_routes() -> OpenApiRouter<ApiState> {
    OpenApiRouter::new()
        .routes(routes!(start_page::get))
        .routes(routes!(jobs::submit, jobs::list))
        .routes(routes!(jobs::get, job_changes::patch, job_changes::delete))
        .routes(routes!(jobs::cancel))
        .routes(routes!(job_changes::retry))
        .routes(routes!(files::file))
        .routes(routes!(files::resubmit))
        .routes(routes!(events::follow))
        .routes(routes!(pause::pause_job))
        .routes(routes!(pause::resume_job))
        .routes(routes!(pause::get))
        .routes(routes!(pause::pause))
        .routes(routes!(pause::resume))
        .routes(routes!(webhooks::list))
        .routes(routes!(frames::list))
        .routes(routes!(frames::archive))
        .routes(routes!(images::first_frame))
        .routes(routes!(images::frame))
        .routes(routes!(previews::preview))
        .routes(routes!(previews::thumbnail))
        .routes(routes!(links::sign))
        // Needs no key: the link's signature authorizes the request.
        .routes(routes!(links::follow))
        .routes(routes!(images::forget))
        .routes(routes!(retention::collect))
        .routes(routes!(pool::workers))
        .routes(routes!(pool::get, pool::put))
        .routes(routes!(keys::list, keys::make))
        .routes(routes!(keys::revoke))
        .routes(routes!(audit::list))
        .routes(routes!(openapi::job_schema))
        .routes(routes!(health::livez))
        .routes(routes!(health::readyz))
        .routes(routes!(health::metrics))
}

/// Workers' routes: see `proto::worker_protocol`.
fn worker_routes() -> axum::Router<ApiState> {
    axum::Router::new()
        .route(proto::worker_protocol::REGISTER_PATH, post(worker_protocol::register))
        .route(proto::worker_protocol::SYNC_PATH, post(worker_protocol::sync))
        .route("/v1/worker/jobs/{id}", get(worker_protocol::job))
        .route("/v1/worker/blobs/{hash}", put(worker_protocol::put_blob).get(worker_protocol::get_blob))
        .route("/v1/worker/pictures/{hash}", put(worker_protocol::put_picture))
}

/// Router of the whole API.
pub(crate) fn router(state: ApiState) -> axum::Router {
    let (users, described) = user_routes().split_for_parts();
    let document = Document::new(&described);
    let pages = SwaggerUi::new("/docs").config(Config::from("/openapi.json").validator_url("none"));
    users
        .merge(worker_routes())
        .with_state(state.clone())
        .route("/openapi.json", get(openapi::openapi).with_state(document))
        .merge(pages)
        .fallback(unknown_route)
        .method_not_allowed_fallback(method_not_allowed)
        .layer(CatchPanicLayer::custom(panic_response))
        .layer(middleware::from_fn_with_state(state.clone(), auth::authenticate_and_authorize))
        .layer(middleware::from_fn_with_state(state.clone(), host_check::host_and_origin))
        .layer(middleware::from_fn_with_state(state.clone(), audit::record_request))
        .layer(middleware::from_fn_with_state(state, request_id::trace))
}

/// `OpenAPI` document of the router.
#[cfg(test)]
fn document() -> Document {
    Document::new(&user_routes().split_for_parts().1)
}

async fn unknown_route(request: Request) -> ApiError {
    ApiError::UnknownRoute { method: request.method().to_string(), path: request.uri().path().to_owned() }
}

async fn method_not_allowed(request: Request) -> ApiError {
    ApiError::WrongMethod { method: request.method().to_string(), path: request.uri().path().to_owned() }
}

#[expect(clippy::needless_pass_by_value, reason = "the panic layer requires this signature")]
fn panic_response(panic: Box<dyn Any + Send>) -> Response {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    ApiError::Internal(text.unwrap_or("a handler panicked").into()).into_response()
}
