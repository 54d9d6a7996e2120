//! The HTTP layer: the whole API on one screen. Handlers read the request, call a service, and respond;
//! they decide nothing about jobs.

mod alerts;
mod audit;
mod auth;
mod body;
mod caller;
mod content_encoding;
mod docs;
mod drawings;
mod editing;
mod error;
mod events;
mod files;
mod frames;
mod health;
mod history;
mod host_check;
mod images;
mod job_body;
mod job_changes;
mod jobs;
mod keys;
mod layers;
mod links;
mod merge_patch;
mod openapi;
mod page;
mod pause;
mod pick;
mod pool;
mod prefer;
mod previews;
mod price;
mod quota;
mod range;
mod read_only;
mod request_id;
mod retention;
mod routes;
mod scaling;
mod shaders;
mod start_page;
mod state;
mod submission;
mod submit_options;
mod tiles;
mod trace_context;
mod verify;
mod webhooks;
mod worker_protocol;

use std::any::Any;

use axum::extract::Request;
use axum::middleware;
use axum::response::{IntoResponse, Response};
use tower_http::catch_panic::CatchPanicLayer;

use error::ApiError;
pub(crate) use state::{ApiState, Handles};

// A column each: method, path, permission, time limit, what the audit log records, handler. `polled` are the routes
// that monitors and workers request again and again. A link's signature authorizes the request that follows it.
routes::table! {
    described {
        GET    "/"                                          PUBLIC     MINUTE Nothing start_page::get;
        POST   "/v1/jobs"                                   SUBMIT     NONE   NewJob  jobs::submit;
        POST   "/v1/price"                                  SUBMIT     MINUTE Nothing price::price;
        GET    "/v1/jobs"                                   READ_OWN   MINUTE Nothing jobs::list;
        GET    "/v1/jobs/{id}"                              READ_OWN   MINUTE Nothing jobs::get;
        PATCH  "/v1/jobs/{id}"                              CHANGE_OWN MINUTE Work    job_changes::patch;
        POST   "/v1/jobs/{id}/move"                         CHANGE_OWN MINUTE Work    job_changes::move_job;
        DELETE "/v1/jobs/{id}"                              CHANGE_OWN MINUTE Work    job_changes::delete;
        POST   "/v1/jobs/{id}/cancel"                       CHANGE_OWN MINUTE Work    jobs::cancel;
        POST   "/v1/jobs/{id}/retry"                        CHANGE_OWN MINUTE Work    job_changes::retry;
        GET    "/v1/jobs/{id}/file"                         READ_OWN   MINUTE Nothing files::file;
        POST   "/v1/jobs/{id}/resubmit"                     CHANGE_OWN MINUTE NewJob  files::resubmit;
        GET    "/v1/jobs/{id}/events"                       READ_OWN   NONE   Nothing events::follow;
        GET    "/v1/events"                                 READ_OWN   NONE   Nothing events::follow_farm;
        POST   "/v1/jobs/{id}/pause"                        CHANGE_OWN MINUTE Work    pause::pause_job;
        POST   "/v1/jobs/{id}/resume"                       CHANGE_OWN MINUTE Work    pause::resume_job;
        GET    "/v1/farm"                                   READ       MINUTE Nothing pause::get;
        GET    "/v1/alerts"                                 READ       MINUTE Nothing alerts::list;
        POST   "/v1/farm/pause"                             ADMIN      MINUTE Admin   pause::pause;
        POST   "/v1/farm/resume"                            ADMIN      MINUTE Admin   pause::resume;
        GET    "/v1/jobs/{id}/webhooks"                     READ_OWN   MINUTE Nothing webhooks::list;
        GET    "/v1/jobs/{id}/tiles"                        READ_OWN   MINUTE Nothing tiles::list;
        GET    "/v1/jobs/{id}/frames"                       READ_OWN   MINUTE Nothing frames::list;
        GET    "/v1/jobs/{id}/frames.zip"                   READ_OWN   MINUTE Nothing frames::archive;
        GET    "/v1/jobs/{id}/image"                        READ_OWN   MINUTE Nothing images::first_frame;
        GET    "/v1/jobs/{id}/frames/{frame}/image"         READ_OWN   MINUTE Nothing images::frame;
        GET    "/v1/jobs/{id}/frames/{frame}/preview"       READ_OWN   MINUTE Nothing previews::preview;
        GET    "/v1/jobs/{id}/frames/{frame}/thumbnail"     READ_OWN   MINUTE Nothing previews::thumbnail;
        POST   "/v1/jobs/{id}/frames/{frame}/verify"        READ_OWN   MINUTE Nothing verify::verify;
        GET    "/v1/jobs/{id}/frames/{frame}/layers"        READ_OWN   MINUTE Nothing layers::list;
        GET    "/v1/jobs/{id}/frames/{frame}/layers/{layer}" READ_OWN  MINUTE Nothing layers::layer;
        GET    "/v1/jobs/{id}/frames/{frame}/pixel"         READ_OWN   MINUTE Nothing layers::pixel;
        POST   "/v1/shader"                                 SUBMIT     MINUTE Nothing shaders::shader;
        POST   "/v1/jobs/{id}/frames/{frame}/link"          READ_OWN   MINUTE Work    links::sign;
        POST   "/v1/preview"                                SUBMIT     MINUTE Nothing drawings::preview;
        POST   "/v1/pick"                                   SUBMIT     MINUTE Nothing pick::pick;
        GET    "/v1/pictures/{id}/{frame}/{content}"        PUBLIC     MINUTE Nothing links::follow;
        DELETE "/v1/pictures/{hash}"                        ADMIN      MINUTE Admin   images::forget;
        POST   "/v1/gc"                                     ADMIN      MINUTE Admin   retention::collect;
        GET    "/v1/workers"                                READ       MINUTE Nothing pool::workers;
        POST   "/v1/workers/{id}/drain"                     ADMIN      MINUTE Admin   pool::drain_worker;
        POST   "/v1/workers/{id}/quarantine"                ADMIN      MINUTE Admin   pool::quarantine_worker;
        POST   "/v1/workers/{id}/release"                   ADMIN      MINUTE Admin   pool::release_worker;
        GET    "/v1/pool"                                   READ       MINUTE Nothing pool::get;
        PUT    "/v1/pool"                                   ADMIN      MINUTE Admin   pool::put;
        GET    "/v1/history"                                READ       MINUTE Nothing history::get, polled;
        GET    "/v1/scaling"                                READ       MINUTE Nothing scaling::get, polled;
        GET    "/v1/keys"                                   ADMIN      MINUTE Nothing keys::list;
        POST   "/v1/keys"                                   ADMIN      MINUTE NewKey  keys::make;
        DELETE "/v1/keys/{id}"                              ADMIN      MINUTE Admin   keys::revoke;
        GET    "/v1/caller"                                 ANY_OR_NONE MINUTE Nothing caller::get;
        GET    "/v1/audit"                                  ADMIN      MINUTE Nothing audit::list;
        GET    "/v1/schema/job"                             PUBLIC     MINUTE Nothing openapi::job_schema;
        GET    "/v1/schema/nodes"                           PUBLIC     MINUTE Nothing editing::node_table;
        GET    "/v1/scenes"                                 PUBLIC     MINUTE Nothing editing::scenes;
        GET    "/v1/scenes/{name}"                          PUBLIC     MINUTE Nothing editing::scene;
        GET    "/livez"                                     PUBLIC     MINUTE Nothing health::livez, polled;
        GET    "/readyz"                                    PUBLIC     MINUTE Nothing health::readyz, polled;
        GET    "/metrics"                                   READ       MINUTE Nothing health::metrics, polled;
    }
    hidden {
        POST   "/v1/worker/register"                        WORKER     NONE   Work    worker_protocol::register;
        POST   "/v1/worker/sync"                            WORKER     NONE   Nothing worker_protocol::sync, polled;
        GET    "/v1/worker/jobs/{id}"                       WORKER     NONE   Nothing worker_protocol::job;
        PUT    "/v1/worker/blobs/{hash}"                    WORKER     NONE   Nothing worker_protocol::put_blob;
        GET    "/v1/worker/blobs/{hash}"                    WORKER     NONE   Nothing worker_protocol::get_blob;
        PUT    "/v1/worker/pictures/{hash}"                 WORKER     NONE   Nothing worker_protocol::put_picture;
        GET    "/ui/{*path}"                                PUBLIC     MINUTE Nothing page::file;
        GET    "/openapi.json"                              PUBLIC     MINUTE Nothing openapi::openapi;
        GET    "/docs"                                      PUBLIC     MINUTE Nothing docs::redirect;
        GET    "/docs/"                                     PUBLIC     MINUTE Nothing docs::page;
        GET    "/docs/{*rest}"                              PUBLIC     MINUTE Nothing docs::file;
    }
}

/// Router of the whole API.
pub(crate) fn router(state: ApiState) -> axum::Router {
    let (routes, _) = routes::router();
    routes
        .with_state(state.clone())
        .fallback(unknown_route)
        .method_not_allowed_fallback(method_not_allowed)
        .layer(CatchPanicLayer::custom(panic_response))
        .layer(middleware::from_fn_with_state(state.clone(), auth::authenticate_and_authorize))
        .layer(middleware::from_fn_with_state(state.clone(), host_check::host_and_origin))
        .layer(middleware::from_fn_with_state(state.clone(), audit::record_request))
        .layer(middleware::from_fn_with_state(state, request_id::trace))
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
