//! Lists the deliveries of a job's webhooks.

use axum::Json;
use axum::extract::{Path, State};
use proto::webhook::DeliveryList;

use crate::http::error::ApiError;
use crate::http::jobs::job_id;
use crate::queue::Queue;

/// List the deliveries of a job's webhooks, with their states.
#[utoipa::path(
    get, path = "", tag = "jobs", operation_id = "list_deliveries",
    params(("id" = String, Path, description = "The job")),
    responses((status = 200, description = "The deliveries, oldest first", body = ref("#/components/schemas/DeliveryList")))
)]
pub(in crate::http) async fn list(
    State(queue): State<Queue>,
    Path(id): Path<String>,
) -> Result<Json<DeliveryList>, ApiError> {
    let job = job_id(&id)?;
    queue.event_position(job, 0).await?.ok_or(ApiError::UnknownJob(id))?;
    Ok(Json(DeliveryList { deliveries: queue.deliveries(job).await? }))
}
