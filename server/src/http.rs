//! The HTTP layer: the whole API on one screen. Handlers read the request, call the farm, and respond; they
//! decide nothing about jobs.

mod audit;
mod body;
mod caller;
mod change;
mod door;
mod error;
mod events;
mod farm;
mod frames;
mod health;
mod images;
mod jobs;
mod keys;
mod links;
mod openapi;
mod pool;
mod prefer;
mod previews;
mod protocol;
mod quota;
mod range;
mod retention;
mod rules;
mod trace;
mod traces;
mod webhooks;
mod wish;

pub(crate) use caller::Peer;

use std::any::Any;
use std::sync::Arc;

use axum::extract::Request;
use axum::middleware;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post, put};
use tower_http::catch_panic::CatchPanicLayer;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;
use utoipa_swagger_ui::{Config, SwaggerUi};

use crate::farm::Farm;
use error::ApiError;
use openapi::Document;

/// The users' routes; each is described where it is handled.
fn users() -> OpenApiRouter<Arc<Farm>> {
    OpenApiRouter::new()
        .routes(routes!(jobs::submit, jobs::list))
        .routes(routes!(jobs::get, change::patch, change::delete))
        .routes(routes!(jobs::cancel))
        .routes(routes!(change::retry))
        .routes(routes!(events::follow))
        .routes(routes!(farm::pause_job))
        .routes(routes!(farm::resume_job))
        .routes(routes!(farm::get))
        .routes(routes!(farm::pause))
        .routes(routes!(farm::resume))
        .routes(routes!(webhooks::list))
        .routes(routes!(frames::list))
        .routes(routes!(frames::archive))
        .routes(routes!(images::first))
        .routes(routes!(images::frame))
        .routes(routes!(previews::preview))
        .routes(routes!(previews::thumbnail))
        .routes(routes!(links::sign))
        // Needs no key: the link's signature is the permission.
        .routes(routes!(links::follow))
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

/// The workers' routes: see `proto::work`.
fn workers() -> axum::Router<Arc<Farm>> {
    axum::Router::new()
        .route(proto::work::REGISTER, post(protocol::register))
        .route(proto::work::SYNC, post(protocol::sync))
        .route("/v1/worker/jobs/{id}", get(protocol::job))
        .route("/v1/worker/blobs/{hash}", put(protocol::put_blob).get(protocol::get_blob))
        .route("/v1/worker/pictures/{hash}", put(protocol::put_picture))
}

/// The whole API.
pub(crate) fn router(farm: Arc<Farm>) -> axum::Router {
    let (users, described) = users().split_for_parts();
    let document = Document::new(&described);
    let pages = SwaggerUi::new("/docs").config(Config::from("/openapi.json").validator_url("none"));
    users
        .merge(workers())
        .with_state(Arc::clone(&farm))
        .route("/openapi.json", get(openapi::openapi).with_state(document))
        .merge(pages)
        .fallback(unknown_route)
        .method_not_allowed_fallback(wrong_method)
        .layer(CatchPanicLayer::custom(panicked))
        .layer(middleware::from_fn_with_state(Arc::clone(&farm), caller::identify))
        .layer(middleware::from_fn_with_state(Arc::clone(&farm), door::host_and_origin))
        .layer(middleware::from_fn_with_state(Arc::clone(&farm), audit::tell))
        .layer(middleware::from_fn_with_state(farm, trace::trace))
}

/// The document that the router serves.
#[cfg(test)]
fn document() -> Document {
    Document::new(&users().split_for_parts().1)
}

async fn unknown_route(request: Request) -> ApiError {
    ApiError::UnknownRoute { method: request.method().to_string(), path: request.uri().path().to_owned() }
}

async fn wrong_method(request: Request) -> ApiError {
    ApiError::WrongMethod { method: request.method().to_string(), path: request.uri().path().to_owned() }
}

#[expect(clippy::needless_pass_by_value, reason = "this is how the layer calls it")]
fn panicked(panic: Box<dyn Any + Send>) -> Response {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    ApiError::Internal(text.unwrap_or("a handler panicked").into()).into_response()
}
