//! Conditions that need an operator.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use proto::alert::AlertList;

use crate::alerts::Alerts;

/// List what needs an operator.
///
/// The disk, the local workers and the store are as the server sees them that is asked; the rest is the same on all servers.
#[utoipa::path(
    get, path = "", tag = "farm", operation_id = "list_alerts",
    responses((status = 200, description = "The alerts, critical ones first", body = ref("#/components/schemas/AlertList")))
)]
pub(in crate::http) async fn list(State(alerts): State<Arc<Alerts>>) -> Json<AlertList> {
    Json(AlertList { alerts: alerts.current().await })
}
