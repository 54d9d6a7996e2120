//! `GET /v1/caller`: the name and rights of the caller, so that a page shows only the actions that its reader may take.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use proto::api_key::Scope;
use proto::caller::CallerView;

use crate::api_keys::ApiKeys;
use crate::config::Config;
use crate::http::auth::Caller;

/// Scopes by how much each allows, most first.
const BY_POWER: [Scope; 4] = [Scope::Admin, Scope::Submit, Scope::Read, Scope::Worker];

/// Get the caller: the name and scopes of the key that was sent.
///
/// Needs no key; one that is sent must be valid.
#[utoipa::path(
    get, path = "", tag = "keys", operation_id = "get_caller",
    responses((status = 200, description = "The caller", body = ref("#/components/schemas/CallerView")))
)]
pub(in crate::http) async fn get(
    State(api_keys): State<Arc<ApiKeys>>,
    State(config): State<Arc<Config>>,
    caller: Caller,
) -> Json<CallerView> {
    let key = caller.key();
    Json(CallerView {
        needs_key: api_keys.are_required(),
        name: caller.identity().map(str::to_owned),
        scope: key.and_then(|key| BY_POWER.into_iter().find(|scope| key.scopes().has(*scope))),
        scopes: key.map(|key| key.scopes().names()),
        read_only: config.read_only_page,
        version: env!("CARGO_PKG_VERSION").to_owned(),
    })
}
