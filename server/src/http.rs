//! The HTTP layer: the whole API on one screen. Handlers read the request, call a service, and respond;
//! they decide nothing about jobs.

mod audit;
mod auth;
mod body;
mod caller;
mod content_encoding;
mod drawings;
mod editing;
mod error;
mod events;
mod farm;
mod frames;
mod health;
mod host_check;
mod jobs;
mod keys;
mod openapi;
mod page;
mod request_id;
mod routes;
mod state;
mod workers;

use std::any::Any;

use axum::extract::Request;
use axum::http::{HeaderName, HeaderValue, header};
use axum::middleware;
use axum::response::{IntoResponse, Response};
use tower_http::catch_panic::CatchPanicLayer;

use error::ApiError;
pub(crate) use state::{ApiState, Handles};

// A column each: method, path, permission, time limit, what the audit log records, handler. `polled` are the routes
// that monitors and workers request again and again. In brackets: the errors of the route, besides the ones of every
// route with its permission, body and query (`openapi/problems.rs`). A link's signature authorizes the request that
// follows it.
routes::table! {
    described {
        GET    "/"                                          PUBLIC     MINUTE Nothing page::start_page::get;
        POST   "/v1/jobs"                                   SUBMIT     NONE   NewJob  jobs::submit
               [PriorityTooHigh UnknownJob WrongHeader WrongJob WrongWebhook IdempotencyKeyReused QueueFull Quota DiskFull];
        POST   "/v1/price"                                  SUBMIT     MINUTE Nothing drawings::price::price
               [WrongJob TooManyPreviews PreviewFailed];
        GET    "/v1/jobs"                                   READ_OWN   MINUTE Nothing jobs::list
               [WrongHash];
        GET    "/v1/jobs/{id}"                              READ_OWN   MINUTE Nothing jobs::get
               [UnknownJob];
        PATCH  "/v1/jobs/{id}"                              CHANGE_OWN MINUTE Work    jobs::changes::patch
               [UnknownJob Finished PriorityTooHigh];
        POST   "/v1/jobs/{id}/move"                         CHANGE_OWN MINUTE Work    jobs::changes::reorder_job
               [UnknownJob Finished PriorityTooHigh];
        DELETE "/v1/jobs/{id}"                              CHANGE_OWN MINUTE Work    jobs::changes::delete
               [UnknownJob Running];
        POST   "/v1/jobs/{id}/cancel"                       CHANGE_OWN MINUTE Work    jobs::cancel
               [UnknownJob Finished];
        POST   "/v1/jobs/{id}/retry"                        CHANGE_OWN MINUTE Work    jobs::changes::retry
               [UnknownJob NoDeadTiles QueueFull Quota];
        GET    "/v1/jobs/{id}/file"                         READ_OWN   MINUTE Nothing jobs::files::file
               [UnknownJob];
        POST   "/v1/jobs/{id}/resubmit"                     CHANGE_OWN MINUTE NewJob  jobs::files::resubmit
               [PriorityTooHigh UnknownJob WrongHeader WrongJob WrongBody WrongWebhook IdempotencyKeyReused QueueFull Quota DiskFull];
        GET    "/v1/jobs/{id}/events"                       READ_OWN   NONE   Nothing events::follow
               [UnknownJob];
        GET    "/v1/events"                                 READ_OWN   NONE   Nothing events::follow_farm;
        POST   "/v1/jobs/{id}/pause"                        CHANGE_OWN MINUTE Work    farm::pause_job
               [UnknownJob Finished Quota];
        POST   "/v1/jobs/{id}/resume"                       CHANGE_OWN MINUTE Work    farm::resume_job
               [UnknownJob Finished];
        GET    "/v1/farm"                                   READ       MINUTE Nothing farm::get;
        GET    "/v1/alerts"                                 READ       MINUTE Nothing farm::alerts::list;
        POST   "/v1/farm/pause"                             ADMIN      MINUTE Admin   farm::pause;
        POST   "/v1/farm/resume"                            ADMIN      MINUTE Admin   farm::resume;
        GET    "/v1/jobs/{id}/webhooks"                     READ_OWN   MINUTE Nothing jobs::webhooks::list
               [UnknownJob];
        GET    "/v1/jobs/{id}/tiles"                        READ_OWN   MINUTE Nothing jobs::tiles::list
               [UnknownJob];
        GET    "/v1/jobs/{id}/frames"                       READ_OWN   MINUTE Nothing frames::list
               [UnknownJob];
        GET    "/v1/jobs/{id}/frames.zip"                   READ_OWN   MINUTE Nothing frames::archive
               [UnknownJob FramesMissing];
        GET    "/v1/jobs/{id}/image"                        READ_OWN   MINUTE Nothing frames::images::first_frame
               [UnknownJob NotStored WrongRange LostPicture DamagedPicture];
        GET    "/v1/jobs/{id}/frames/{frame}/image"         READ_OWN   MINUTE Nothing frames::images::frame
               [UnknownJob UnknownFrame NotStored WrongRange LostPicture DamagedPicture];
        GET    "/v1/jobs/{id}/frames/{frame}/preview"       READ_OWN   MINUTE Nothing frames::previews::preview
               [UnknownJob UnknownFrame TooManyPreviews PreviewFailed LostPicture DamagedPicture];
        GET    "/v1/jobs/{id}/frames/{frame}/thumbnail"     READ_OWN   MINUTE Nothing frames::previews::thumbnail
               [UnknownJob UnknownFrame NotStored TooManyPreviews PreviewFailed LostPicture DamagedPicture];
        POST   "/v1/jobs/{id}/frames/{frame}/verify"        READ_OWN   MINUTE Nothing frames::verify::verify
               [UnknownJob UnknownFrame NotStored TooManyPreviews PreviewFailed LostPicture DamagedPicture];
        GET    "/v1/jobs/{id}/frames/{frame}/layers"        READ_OWN   MINUTE Nothing frames::layers::list
               [UnknownJob UnknownFrame NotStored TooManyPreviews PreviewFailed LostPicture DamagedPicture];
        GET    "/v1/jobs/{id}/frames/{frame}/layers/{layer}" READ_OWN  MINUTE Nothing frames::layers::layer
               [UnknownJob UnknownFrame NotStored UnknownLayer TooManyPreviews PreviewFailed LostPicture DamagedPicture];
        GET    "/v1/jobs/{id}/frames/{frame}/pixel"         READ_OWN   MINUTE Nothing frames::layers::pixel
               [UnknownJob UnknownFrame NotStored TooManyPreviews PreviewFailed LostPicture DamagedPicture];
        POST   "/v1/shader"                                 SUBMIT     MINUTE Nothing drawings::shaders::shader
               [WrongJob TooManyPreviews PreviewFailed];
        POST   "/v1/jobs/{id}/frames/{frame}/link"          READ_OWN   MINUTE Work    frames::links::sign
               [UnknownJob UnknownFrame];
        POST   "/v1/preview"                                SUBMIT     MINUTE Nothing drawings::preview
               [WrongJob TooManyPreviews PreviewFailed];
        POST   "/v1/pick"                                   SUBMIT     MINUTE Nothing drawings::pick::pick
               [WrongJob TooManyPreviews PreviewFailed];
        GET    "/v1/pictures/{id}/{frame}/{content}"        PUBLIC     MINUTE Nothing frames::links::follow
               [WrongSignature UnknownJob UnknownFrame NotStored LinkExpired WrongRange TooManyPreviews PreviewFailed LostPicture DamagedPicture];
        DELETE "/v1/pictures/{hash}"                        ADMIN      MINUTE Admin   frames::images::forget
               [UnknownPicture WrongHash];
        POST   "/v1/gc"                                     ADMIN      MINUTE Admin   farm::retention::collect;
        GET    "/v1/workers"                                READ       MINUTE Nothing workers::workers;
        POST   "/v1/workers/{id}/drain"                     ADMIN      MINUTE Admin   workers::drain_worker
               [NoWorker];
        POST   "/v1/workers/{id}/quarantine"                ADMIN      MINUTE Admin   workers::quarantine_worker
               [NoWorker WorkerDraining];
        POST   "/v1/workers/{id}/release"                   ADMIN      MINUTE Admin   workers::release_worker
               [NoWorker WorkerDraining];
        GET    "/v1/pool"                                   READ       MINUTE Nothing workers::get;
        PUT    "/v1/pool"                                   ADMIN      MINUTE Admin   workers::put;
        GET    "/v1/history"                                READ       MINUTE Nothing farm::history::get, polled;
        GET    "/v1/scaling"                                READ       MINUTE Nothing farm::scaling::get, polled;
        GET    "/v1/keys"                                   ADMIN      MINUTE Nothing keys::list;
        POST   "/v1/keys"                                   ADMIN      MINUTE NewKey  keys::make
               [InvalidNewKey TooManyKeys];
        DELETE "/v1/keys/{id}"                              ADMIN      MINUTE Admin   keys::revoke
               [KeyNotFound];
        GET    "/v1/caller"                                 ANY_OR_NONE MINUTE Nothing caller::get;
        GET    "/v1/audit"                                  ADMIN      MINUTE Nothing audit::list;
        GET    "/v1/schema/job"                             PUBLIC     MINUTE Nothing openapi::job_schema;
        GET    "/v1/schema/nodes"                           PUBLIC     MINUTE Nothing editing::node_table;
        POST   "/v1/format"                                 SUBMIT     MINUTE Nothing editing::format
               [WrongJob];
        GET    "/v1/scenes"                                 PUBLIC     MINUTE Nothing editing::scenes;
        GET    "/v1/scenes/{name}"                          PUBLIC     MINUTE Nothing editing::scene
               [UnknownScene];
        GET    "/livez"                                     PUBLIC     MINUTE Nothing health::livez, polled;
        GET    "/readyz"                                    PUBLIC     MINUTE Nothing health::readyz, polled
               [DatabaseUnreachable StoreUnreachable DamagedDatabase DiskFull];
        GET    "/metrics"                                   READ       MINUTE Nothing health::metrics, polled
               [DatabaseUnreachable DamagedDatabase];
    }
    hidden {
        POST   "/v1/worker/register"                        WORKER     NONE   Work    workers::protocol::register;
        POST   "/v1/worker/sync"                            WORKER     NONE   Nothing workers::protocol::sync, polled;
        GET    "/v1/worker/jobs/{id}"                       WORKER     NONE   Nothing workers::protocol::job;
        PUT    "/v1/worker/blobs/{hash}"                    WORKER     NONE   Nothing workers::protocol::put_blob;
        GET    "/v1/worker/blobs/{hash}"                    WORKER     NONE   Nothing workers::protocol::get_blob;
        PUT    "/v1/worker/pictures/{hash}"                 WORKER     NONE   Nothing workers::protocol::put_picture;
        GET    "/ui/{*path}"                                PUBLIC     MINUTE Nothing page::file;
        GET    "/openapi.json"                              PUBLIC     MINUTE Nothing openapi::openapi;
        GET    "/docs"                                      PUBLIC     MINUTE Nothing page::docs::redirect;
        GET    "/docs/"                                     PUBLIC     MINUTE Nothing page::docs::page;
        GET    "/docs/{*rest}"                              PUBLIC     MINUTE Nothing page::docs::file;
    }
}

/// Router of the whole API.
pub(crate) fn router(state: ApiState) -> axum::Router {
    routes::router()
        .with_state(state.clone())
        .fallback(unknown_route)
        .method_not_allowed_fallback(method_not_allowed)
        .layer(CatchPanicLayer::custom(panic_response))
        .layer(middleware::from_fn_with_state(state.clone(), auth::authenticate_and_authorize))
        .layer(middleware::from_fn_with_state(state.clone(), host_check::host_and_origin))
        .layer(middleware::from_fn_with_state(state.clone(), audit::record_request))
        .layer(middleware::from_fn_with_state(state, request_id::trace))
        .layer(middleware::map_response(protect))
}

/// Adds what keeps a browser from running a response, or showing it inside another site, unless a route has its own.
async fn protect(mut response: Response) -> Response {
    /// A browser shows a picture, or a text, in a page of its own with a style.
    const POLICY: &str =
        "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
    const HEADERS: [(HeaderName, &str); 3] = [
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
    ];
    for (name, value) in HEADERS {
        response.headers_mut().entry(name).or_insert(HeaderValue::from_static(value));
    }
    response
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
