//! Picture of a frame for a client that edits the job: exactly the picture of a job of that size, or a smaller one, scaled
//! up, if that takes too long.

use std::io::Cursor;
use std::time::Duration;

use anyhow::{Context, bail, ensure};
use proto::Rect;
use proto::preview_helper::{AboutPicture, Drawing, HelperPicture, PictureLayer};
use scene::{Film, Format, ImageSpec, Job, Layer};
use worker::image::{Encoders, PictureSpec};
use worker::stitch::TileRows;
use worker::{CancelFlag, CpuRenderer, Simd, TilePixels};

use crate::attempt::{Attempt, Outcome};
use crate::canvas::Canvas;
use crate::coarse;
use crate::layer_picture::{self, LayerPicture};

/// Maximum number of render threads.
const MAX_THREADS: usize = 4;
/// Maximum height, in pixels: pictures may be far higher than wide.
const MAX_HEIGHT_PX: u64 = 4096;
/// From this width on, a picture is not made smaller, but has one sample a pixel, and as much time as the first one and
/// this more.
const LAST_PX: u32 = 16;
const LAST_MORE: Duration = Duration::from_secs(1);
/// Fraction of its time that a smaller picture is planned to take.
const PLANNED_FRACTION: f64 = 0.5;
/// Most that the width is divided by at a time.
const MAX_DIVISOR: u32 = 8;

/// Draws a frame.
pub(super) fn draw(mut job: Job, frame: u32, drawing: &Drawing) -> anyhow::Result<HelperPicture> {
    let written = job.image.clone();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let renderer = CpuRenderer::new(Some(cores.min(MAX_THREADS)), Simd::Auto)?;
    let limit = Duration::from_millis(drawing.limit_ms);
    let whole = resized(&written, drawing, drawing.width_px);
    let whole = whole.film();
    let mut width_px = whole.width;
    loop {
        job.image = resized(&written, drawing, width_px);
        let is_last = width_px <= LAST_PX;
        if is_last && width_px < whole.width {
            job.image.samples = 1.into();
        }
        let attempt = Attempt { limit: if is_last { limit + LAST_MORE } else { limit }, gives_up_early: !is_last };
        match attempt.render(&renderer, &job, frame)? {
            Outcome::Finished(pixels) => {
                let pictured = Pictured { job: &job, frame, pixels };
                return if width_px == whole.width {
                    pictured.exactly(renderer.threads())
                } else {
                    pictured.scaled_up(whole)
                };
            }
            Outcome::TooSlow(fraction) if !is_last => width_px = smaller(width_px, fraction),
            Outcome::TooSlow(_) => bail!("even {width_px} pixels in a row take too long to render"),
            Outcome::NotPrepared => bail!("the scene takes too long to prepare"),
        }
    }
}

/// Width for another attempt, after only a fraction of one was rendered in time.
fn smaller(width_px: u32, fraction: f64) -> u32 {
    let planned = (f64::from(width_px) * (fraction * PLANNED_FRACTION).sqrt()) as u32;
    planned.clamp(width_px / MAX_DIVISOR, width_px / 2).max(1)
}

/// The image of a drawing, in this width.
fn resized(written: &ImageSpec, drawing: &Drawing, width_px: u32) -> ImageSpec {
    let mut image = written.clone();
    let film = written.film();
    let [width, height] = [film.width, film.height].map(u64::from);
    let columns = u64::from(width_px).min((MAX_HEIGHT_PX * width / height).max(1));
    let rows = ((height * columns * 2 + width) / (width * 2)).clamp(1, MAX_HEIGHT_PX);
    image.resize(columns as u32, rows as u32);
    // Where adaptive samples went is seen with these alone.
    if drawing.layer != PictureLayer::Samples {
        image.samples = drawing.samples.into();
    }
    image.denoise &= drawing.layer == PictureLayer::Color;
    image.reweight_fireflies &= drawing.layer == PictureLayer::Color;
    image.light_groups.clear();
    (image.format, image.layers) = match drawing.layer.of_exr().filter(|layer| *layer != Layer::Noisy) {
        None => (Format::Png, Vec::new()),
        Some(layer) => (Format::Exr, vec![layer]),
    };
    image
}

/// Pixels of a frame.
struct Pictured<'a> {
    job: &'a Job,
    frame: u32,
    pixels: TilePixels,
}

impl Pictured<'_> {
    /// The picture that a job of this size has.
    fn exactly(&self, threads: usize) -> anyhow::Result<HelperPicture> {
        if let Some(picture) = self.layer()? {
            return picture.encode(self.pixels.rect.width, self.job.image.samples.max());
        }
        let spec = PictureSpec::new(&self.job.at(self.frame)?);
        let mut png = Cursor::new(Vec::new());
        let tiles = std::slice::from_ref(&self.pixels);
        Encoders::new(threads)?
            .run(|threads| spec.write_on(threads, &mut TileRows(tiles), &mut png, &CancelFlag::new()))?;
        let about = AboutPicture {
            rendered_px: spec.width,
            samples: self.job.image.samples.max(),
            range: [Vec::new(), Vec::new()],
        };
        Ok(HelperPicture { about, png: png.into_inner() })
    }

    /// The picture, scaled up smoothly.
    fn scaled_up(&self, whole: Film<'_>) -> anyhow::Result<HelperPicture> {
        let rendered_px = self.pixels.rect.width;
        if let Some(picture) = self.layer()? {
            return picture.scaled_up(whole.width, whole.height).encode(rendered_px, self.job.image.samples.max());
        }
        let spec = PictureSpec::new(&self.job.at(self.frame)?);
        let finished = spec.finished_tile(self.pixels.clone(), self.pixels.rect);
        let canvas = Canvas::new(whole.width, whole.height, whole.width);
        let scaled = coarse::scaled(&finished, spec.display_transform, spec.opaque, canvas.size());
        ensure!(scaled.is_some(), "the pixels are not those of the frame");
        let about =
            AboutPicture { rendered_px, samples: self.job.image.samples.max(), range: [Vec::new(), Vec::new()] };
        Ok(HelperPicture { about, png: canvas.png(scaled.as_ref())? })
    }

    /// The layer as a picture; `None` for colors.
    fn layer(&self) -> anyhow::Result<Option<LayerPicture>> {
        let Some(&layer) = self.job.image.layers.first() else { return Ok(None) };
        let colors = self.pixels.planes.len().checked_sub(layer.channels().len());
        let planes = colors.map(|colors| &self.pixels.planes[colors..]).context("the frame lacks the layer")?;
        let Rect { width, height, .. } = self.pixels.rect;
        Ok(Some(layer_picture::shown(layer, planes, [width, height])))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(width: u32, height: u32) -> ImageSpec {
        serde_json::from_value(serde_json::json!({ "width": width, "height": height })).expect("an image")
    }

    #[test]
    fn the_height_follows_from_the_aspect_ratio_and_is_limited() {
        let drawing = |width_px| Drawing { width_px, samples: 3, layer: PictureLayer::Color, limit_ms: 500 };
        let size = |[width, height]: [u32; 2], width_px| {
            let image = resized(&image(width, height), &drawing(width_px), width_px);
            assert_eq!((image.samples.max(), image.layers.len()), (3, 0));
            [image.width, image.height]
        };
        assert_eq!(size([1920, 1080], 480), [480, 270]);
        assert_eq!(size([800, 800], 480), [480, 480]);
        assert_eq!(size([10, 3], 5), [5, 2]);
        assert_eq!(size([10_000, 1], 100), [100, 1]);
        assert_eq!(size([1, 10_000], 100), [1, 4096]);
        assert_eq!(size([100, 1000], 2048), [409, 4090]);
    }

    #[test]
    fn a_slow_picture_becomes_smaller_by_the_time_that_it_takes() {
        assert_eq!(smaller(480, 1.0), 240);
        assert_eq!(smaller(480, 0.125), 120);
        assert_eq!(smaller(480, 0.0), 60);
        assert_eq!(smaller(17, 0.0), 2);
    }
}
