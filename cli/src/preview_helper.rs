//! Work of the server's helper processes: previews, thumbnails, samples of jobs.
//! It never calls a server: it receives one request and returns a picture or a sample.

mod canvas;
mod coarse;
mod cost_sample;
mod drawing;
mod layer_picture;
mod preview;
mod price;
mod shader;
mod stored_picture;
mod thumbnail;

use std::time::Duration;

use anyhow::Context;
use proto::preview_helper::{HelperRequest, PickView, PictureLayer, StoredLayer};
use worker::image::stored::StoredPicture;
use worker::{CancelFlag, CpuRenderer, Simd};

use crate::verify::{Extent, Original, unreadable};

pub(crate) use cost_sample::sample;
pub(crate) use price::price;

/// Handles a request; returns the bytes of the response.
pub(crate) fn handle(sketch: &HelperRequest) -> anyhow::Result<Vec<u8>> {
    match sketch {
        HelperRequest::Preview { job, frame, width_px, tiles, coarse, coarse_ms } => {
            let job = scene::parse(job.as_bytes())?;
            preview::draw(&job, *frame, *width_px, tiles, &coarse::CoarseCache { file: coarse, limit_ms: *coarse_ms })
        }
        HelperRequest::Thumbnail { file, width_px } => {
            thumbnail::draw(file, &StoredLayer::Listed(PictureLayer::Color), *width_px, 0.0)
        }
        HelperRequest::Verify { job, frame, file, tiles, render_ms } => {
            let job = scene::parse(job.as_bytes())?;
            let file = std::fs::read(file).context("could not read the stored picture")?;
            let original = Original::new(&job, *frame)?;
            let checked = match StoredPicture::read(&file) {
                Ok(stored) => {
                    let renderer = CpuRenderer::new(None, Simd::Auto)?;
                    let limit = Some(Duration::from_millis(*render_ms));
                    original.check(&file, stored, Extent::Sample(*tiles), &renderer, limit, &CancelFlag::new())?
                }
                Err(error) => unreadable(&original, &error),
            };
            Ok(serde_json::to_vec(&checked.comparison)?)
        }
        HelperRequest::Price { job: text, threads, plan } => {
            let job = scene::parse(text.as_bytes())?;
            Ok(serde_json::to_vec(&price(text, &job, *threads, *plan)?)?)
        }
        HelperRequest::Draw { job, frame, drawing } => {
            Ok(drawing::draw(scene::parse(job.as_bytes())?, *frame, drawing)?.encode()?)
        }
        HelperRequest::ReadLayers { file } => stored_picture::layers(file),
        HelperRequest::DrawLayer { file, layer, width_px, exposure } => {
            stored_picture::draw(file, layer, *width_px, *exposure)
        }
        HelperRequest::ReadPixel { file, x, y } => stored_picture::pixel(file, *x, *y),
        HelperRequest::Pick { job: text, frame, at } => {
            let job = scene::parse(text.as_bytes())?;
            let pick = scene::pick(text, &job, *frame, *at)?.map_or_else(PickView::default, PickView::from);
            Ok(serde_json::to_vec(&pick)?)
        }
        HelperRequest::Shader { job, frame, width_px, samples, program } => {
            let job = scene::parse(job.as_bytes())?;
            Ok(serde_json::to_vec(&shader::of(job, *frame, *width_px, *samples, program.as_deref())?)?)
        }
        HelperRequest::MeasureCost { job, threads, render_ms } => {
            let job = scene::parse(job.as_bytes())?;
            Ok(serde_json::to_vec(&sample(&job, *threads, *render_ms)?)?)
        }
    }
}
