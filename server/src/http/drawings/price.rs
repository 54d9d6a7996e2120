//! Price of a job before it is submitted.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, Uri};
use proto::price::Price;
use serde::Deserialize;

use crate::config::Config;
use crate::estimate::{Estimator, PriceParts};
use crate::http::body::{self, RequestBody};
use crate::http::error::ApiError;
use crate::http::jobs::job_body;
use crate::http::state::handle_group;
use crate::job_reader::JobReader;

handle_group! {
    /// Handles of prices.
    Prices {
        /// Has the prices of the operator.
        config: Arc<Config>,
        /// Parses job files.
        jobs: Arc<JobReader>,
        /// Measures jobs.
        estimator: Arc<Estimator>,
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct PriceQuery {
    #[serde(default)]
    map: bool,
    savings: Option<bool>,
}

/// Price a job.
///
/// Its time and cost on this farm, estimated from a sample of its pixels as in a dry run, with the estimate's own error; a map
/// of where the time goes; and the numbers of the job that would save most if they were lower, found by trying. It takes about
/// 5 s, without `savings` 2 s.
#[utoipa::path(
    post, path = "", tag = "jobs", operation_id = "price_job",
    params(
        ("map" = Option<bool>, Query, description = "Measure where the time of frame 0 goes; false by default"),
        ("savings" = Option<bool>, Query, description = "Find the numbers that would save most; true by default"),
        ("Content-Encoding" = Option<String>, Header, description = "`gzip` or `zstd` if the body is compressed; unpacked it has at most 32 MiB"),
    ),
    request_body(content = ref("#/components/schemas/Job"), content_type = "application/json"),
    responses((status = 200, description = "The price", body = ref("#/components/schemas/Price")))
)]
pub(in crate::http) async fn price(
    State(prices): State<Prices>,
    uri: Uri,
    headers: HeaderMap,
    request: RequestBody,
) -> Result<Json<Price>, ApiError> {
    let PriceQuery { map, savings } = body::read_query(&uri)?;
    let submitter = request.holder().name.clone();
    let (text, room) = job_body::text(&headers, request).await?;
    let edge_px = prices.config.tile_edge_px;
    let plan = prices.jobs.job(&submitter, text.clone(), false, edge_px).await?.plan;
    let text = String::from_utf8(text.into()).map_err(|error| ApiError::Internal(Box::new(error)))?;
    let parts = PriceParts { map, savings: savings.unwrap_or(true) };
    let price = prices.estimator.price(&submitter, text, plan, parts, &prices.config.rates).await?;
    drop(room);
    Ok(Json(price))
}
