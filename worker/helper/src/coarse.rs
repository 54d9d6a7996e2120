//! The coarse pass: a frame rendered small, with one sample per pixel, as large as a time limit allows.

use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::Context;
use image::Rgba32FImage;
use image::imageops::{self, FilterType};
use scene::Job;
use scene::film::DisplayTransform;
use worker::{CpuRenderer, Simd, TilePixels, blob};

use crate::attempt::{Attempt, Outcome};
use crate::canvas::shown;

/// Width of the first and smallest attempt, in pixels.
const FIRST_PX: u32 = 32;
/// Width of the last attempt, in pixels.
const LAST_PX: u32 = 480;
/// Maximum number of render threads.
const MAX_THREADS: usize = 2;
/// Limits after which a first attempt is given up: a busy machine gives a helper little time, and any picture is better
/// than none.
const FIRST_ATTEMPT_LIMITS: u32 = 20;
/// Assumed cost of doubling the width: about four times, and a little more as a margin.
const GROWTH_ESTIMATE: f64 = 4.5;

/// Path of a coarse pass, and its cost limit.
#[derive(Clone, Copy, Debug)]
pub(super) struct CoarseCache<'a> {
    /// File of the coarse pass; read if it exists, otherwise written.
    pub(super) file: &'a Path,
    /// Time limit for rendering, in milliseconds.
    pub(super) limit_ms: u64,
}

impl CoarseCache<'_> {
    /// Returns the coarse pass of a frame, cached or rendered now; `None` if not even a small one renders in time.
    pub(super) fn pixels(self, job: &Job, frame: u32) -> anyhow::Result<Option<TilePixels>> {
        if let Some(kept) = std::fs::read(self.file).ok().and_then(|bytes| blob::decode(&bytes).ok())
            && kept.planes.len() == 4
        {
            return Ok(Some(kept));
        }
        let made = render(job, frame, Duration::from_millis(self.limit_ms))?;
        if let Some(pixels) = &made {
            // Written under a name of its own until it is complete, because two helpers may write
            // it. If that fails, it is rendered again next time.
            let half = self.file.with_extension(std::process::id().to_string());
            drop(std::fs::write(&half, blob::encode(pixels)).and_then(|()| std::fs::rename(&half, self.file)));
        }
        Ok(made)
    }
}

/// Renders at doubling widths until the next would take too long.
fn render(job: &Job, frame: u32, limit: Duration) -> anyhow::Result<Option<TilePixels>> {
    let start = Instant::now();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let renderer = CpuRenderer::new(Some(cores.min(MAX_THREADS)), Simd::Auto)?;
    let last = job.image.film().width.min(LAST_PX);
    let (mut best, mut width) = (None, last.min(FIRST_PX));
    loop {
        let begun = Instant::now();
        // A further attempt begins in time, so it is not much late.
        let limits = if best.is_none() { FIRST_ATTEMPT_LIMITS } else { 2 };
        let attempt = Attempt { limit: (limit * limits).saturating_sub(start.elapsed()), gives_up_early: false };
        match attempt.render(&renderer, &with_width(job, width), frame).context("could not render a coarse pass")? {
            Outcome::Finished(pixels) => best = Some(pixels),
            Outcome::TooSlow(_) | Outcome::NotPrepared => break,
        }
        let next = begun.elapsed().mul_f64(GROWTH_ESTIMATE);
        if width == last || start.elapsed() + next > limit {
            break;
        }
        width = (width * 2).min(last);
    }
    Ok(best)
}

/// Scales a job to this width.
fn with_width(job: &Job, width: u32) -> Job {
    let mut small = job.clone();
    let height = u64::from(job.image.film().height) * u64::from(width) / u64::from(job.image.film().width);
    small.image.resize(width, u32::try_from(height).unwrap_or(1).clamp(1, 4 * LAST_PX));
    small.image.samples = 1.into();
    small.image.clear_layers();
    small.image.denoise = false;
    small
}

/// Scales a coarse pass up to this size, smoothly, as it is shown.
pub(super) fn scaled(
    coarse: &TilePixels,
    grade: DisplayTransform,
    opaque: bool,
    [width, height]: [u32; 2],
) -> Option<Rgba32FImage> {
    let [r, g, b, a] = coarse.planes.as_slice() else { return None };
    let colors = r.iter().zip(g).zip(b).zip(a);
    let light = colors.flat_map(|(((r, g), b), a)| shown([*r, *g, *b, *a], grade, opaque)).collect();
    let small = Rgba32FImage::from_raw(coarse.rect.width, coarse.rect.height, light)?;
    let mut large = imageops::resize(&small, width, height, FilterType::CatmullRom);
    // The filter overshoots the range of its input slightly.
    for pixel in large.pixels_mut() {
        let alpha = pixel.0[3].clamp(0.0, 1.0);
        pixel.0 = [pixel.0[0].clamp(0.0, alpha), pixel.0[1].clamp(0.0, alpha), pixel.0[2].clamp(0.0, alpha), alpha];
    }
    Some(large)
}
