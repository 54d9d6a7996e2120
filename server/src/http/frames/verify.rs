//! Verifies a stored picture: a helper process renders some of its tiles again.

use axum::Json;
use axum::extract::{Path, State};
use axum::http::Uri;
use proto::preview_helper::HelperRequest;
use proto::rounding;
use proto::verify::{Comparison, Verification, probability_to_find, tiles, tiles_found_surely};
use serde::Deserialize;

use crate::blobs::ContentKind;
use crate::http::auth::Caller;
use crate::http::body;
use crate::http::error::ApiError;
use crate::http::frames::images;
use crate::http::frames::layers::StoredFrame;
use crate::http::frames::previews::Previews;
use crate::preview_helper::HelperError;

/// Default number of tiles.
const DEFAULT_TILES: u32 = 8;
/// Maximum number of tiles.
const MAX_TILES: u32 = 64;
/// Maximum time for rendering them, in milliseconds; a helper has 20 s in all.
const RENDER_MS: u64 = 10_000;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct VerifyQuery {
    tiles: Option<u32>,
}

/// Verify a stored picture.
///
/// Renders tiles of 64×64 pixels again, chosen at random, for at most 10 s, and compares every value with that in the stored
/// file. With `tiles=0` it only says who made the picture. `sdfarm verify` does the same on another machine.
#[utoipa::path(
    post, path = "", tag = "pictures", operation_id = "verify_picture",
    params(
        ("id" = String, Path, description = "The job"),
        ("frame" = u32, Path, description = "The frame, from 0"),
        ("tiles" = Option<u32>, Query, description = "Number of tiles; 8 by default", minimum = 0, maximum = 64),
    ),
    responses((status = 200, description = "The result", body = ref("#/components/schemas/Verification")))
)]
pub(in crate::http) async fn verify(
    State(previews): State<Previews>,
    caller: Caller,
    Path((id, frame)): Path<(String, String)>,
    uri: Uri,
) -> Result<Json<Verification>, ApiError> {
    let VerifyQuery { tiles } = body::read_query(&uri)?;
    let tiles = tiles.unwrap_or(DEFAULT_TILES);
    if tiles > MAX_TILES {
        return Err(ApiError::WrongQuery(format!("tiles is {tiles}, but must be from 0 to {MAX_TILES}")));
    }
    let StoredFrame { job, frame, hash, size_bytes } = StoredFrame::find(&previews, &id, &frame).await?;
    let made_by = previews.queue.makers(job, frame).await?;
    let compared = if tiles == 0 {
        not_compared(&previews, job, frame).await?
    } else {
        images::intact(&previews.pictures, &hash, size_bytes).await?;
        let text = previews.queue.file(job).await?.ok_or(ApiError::UnknownJob(id))?;
        let request = async {
            let copies = previews.copies(ContentKind::Picture, &[hash]).await?;
            let file = copies.files()[0].clone();
            Ok((HelperRequest::Verify { job: text, frame, file, tiles, render_ms: RENDER_MS }, copies))
        };
        let answer = previews.preview_helper.answer(caller.name(), request).await?;
        serde_json::from_slice(&answer).map_err(|error| HelperError::Failed(error.to_string()))?
    };
    let same = tiles == 0 || compared.is_same();
    let Comparison { tiles_checked, tiles_total, pixels_different, differs, findings, scene, .. } = compared;
    Ok(Json(Verification {
        same,
        tiles_checked,
        tiles_total,
        finds_one_tile: rounding::fraction(probability_to_find(tiles_checked, tiles_total, 1)),
        finds_tiles: tiles_found_surely(tiles_checked, tiles_total),
        pixels_different,
        differs,
        findings,
        made_by,
        picture_version: scene::PICTURE_VERSION,
        scene,
        version: env!("CARGO_PKG_VERSION").to_owned(),
    }))
}

/// A comparison of no tile.
async fn not_compared(previews: &Previews, job: proto::JobId, frame: u32) -> Result<Comparison, ApiError> {
    let [width, height] =
        previews.queue.picture_size(job).await?.ok_or_else(|| ApiError::UnknownJob(job.to_string()))?;
    let tiles_total = u32::try_from(tiles(width, height).len()).unwrap_or(u32::MAX);
    Ok(Comparison { tiles_total, scene: previews.queue.scene_of(job, frame).await?, ..Comparison::default() })
}
