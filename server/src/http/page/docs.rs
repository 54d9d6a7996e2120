//! The pages of the API's documentation: Swagger UI, whose files are part of this program.

use std::sync::{Arc, LazyLock};

use axum::extract::Path;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Redirect, Response};
use utoipa_swagger_ui::Config;

use crate::http::error::ApiError;

/// Content security policy: only files of this server. Swagger UI writes styles and small pictures into its page.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; \
                      connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
/// Settings of the pages.
static CONFIG: LazyLock<Arc<Config<'static>>> =
    LazyLock::new(|| Arc::new(Config::from("/openapi.json").validator_url("none")));

/// Leads to the page.
pub(in crate::http) async fn redirect() -> Redirect {
    Redirect::to("/docs/")
}

/// Returns the page.
pub(in crate::http) async fn page() -> Result<Response, ApiError> {
    serve("")
}

/// Returns a file of the page.
pub(in crate::http) async fn file(Path(name): Path<String>) -> Result<Response, ApiError> {
    serve(&name)
}

fn serve(name: &str) -> Result<Response, ApiError> {
    let file = utoipa_swagger_ui::serve(name, Arc::clone(&CONFIG))
        .map_err(|error| ApiError::Internal(error.to_string().into()))?;
    Ok(match file {
        Some(file) => {
            let headers =
                [(header::CONTENT_TYPE, file.content_type), (header::CONTENT_SECURITY_POLICY, POLICY.to_owned())];
            (headers, file.bytes).into_response()
        }
        None => StatusCode::NOT_FOUND.into_response(),
    })
}
