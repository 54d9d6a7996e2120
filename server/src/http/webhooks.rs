//! Lists the deliveries of a job's webhooks.

use axum::Json;
use axum::extract::{Path, State};
use proto::webhook::DeliveryList;

use super::error::ApiError;
use super::jobs::job_id;
use crate::queue::Queue;

/// List the deliveries of a job's webhooks, with their states.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/webhooks", tag = "jobs", operation_id = "list_deliveries",
    params(("id" = String, Path, description = "The job")),
    responses(
        (status = 200, description = "The deliveries, oldest first", body = ref("#/components/schemas/DeliveryList")),
        (status = 404, description = "No such job", body = ref("#/components/schemas/Problem"), content_type = "application/problem+json"),
    )
)]
pub(super) async fn list(State(queue): State<Queue>, Path(id): Path<String>) -> Result<Json<DeliveryList>, ApiError> {
    let job = job_id(&id)?;
    queue.event_position(job, 0).await?.ok_or(ApiError::UnknownJob(id))?;
    Ok(Json(DeliveryList { deliveries: queue.deliveries(job).await? }))
}
