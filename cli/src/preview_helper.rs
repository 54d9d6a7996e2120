//! Work of the server's helper processes: previews, thumbnails, samples of jobs.
//! It never calls a server: it receives one request and returns a picture or a sample.

mod canvas;
mod coarse;
mod cost_sample;
mod preview;
mod thumbnail;

use proto::preview_helper::HelperRequest;

pub(crate) use cost_sample::sample;

/// Handles a request; returns the bytes of the response.
pub(crate) fn handle(sketch: &HelperRequest) -> anyhow::Result<Vec<u8>> {
    match sketch {
        HelperRequest::Preview { job, frame, width_px, tiles, coarse, coarse_ms } => {
            let job = scene::parse(job.as_bytes())?;
            preview::draw(&job, *frame, *width_px, tiles, &coarse::CoarseCache { file: coarse, limit_ms: *coarse_ms })
        }
        HelperRequest::Thumbnail { file, width_px } => thumbnail::draw(file, *width_px),
        HelperRequest::MeasureCost { job, threads, render_ms } => {
            let job = scene::parse(job.as_bytes())?;
            Ok(serde_json::to_vec(&sample(&job, *threads, *render_ms)?)?)
        }
    }
}
