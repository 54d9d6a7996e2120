//! Measures the price of a job: time and cost, a map of the time, and the numbers that would save most.

mod map;
mod savings;

use std::time::Duration;

use proto::preview_helper::PricePlan;
use proto::price::PriceSample;
use proto::tile::Tiling;
use scene::Job;
use worker::{CpuRenderer, Simd};

use crate::cost_sample::sample;

/// Measures a job that was parsed from this text, on `threads` threads.
pub fn price(text: &str, job: &Job, threads: usize, plan: PricePlan) -> anyhow::Result<PriceSample> {
    let cost = sample(job, threads, plan.sample_ms)?;
    let (image, film) = (&job.image, job.image.film());
    let (width, height, samples) = (film.width, film.height, image.samples.max());
    let tiling = Tiling { width, height, samples, pixel_bytes: film.pixel_bytes(), tile_edge: None };
    let frames = u64::from(job.frames.count);
    let (rays, tiles) = (job.rays_per_frame() * frames, tiling.tiles().len() as u64 * frames);
    let core_seconds = cost.core_seconds(rays, tiles, frames, film.pixels() * frames);
    let renderers = renderers(threads)?;
    let map = match plan.map_ms {
        0 => None,
        limit_ms => {
            let frame_seconds = core_seconds / frames as f64;
            Some(map::measure(job, &renderers, Duration::from_millis(limit_ms), frame_seconds)?)
        }
    };
    let savings = match plan.savings_ms {
        0 => Vec::new(),
        limit_ms => {
            let ray_seconds = cost.thread_seconds_per_ray;
            savings::find(text, job, &renderers, Duration::from_millis(limit_ms), ray_seconds, core_seconds)?
        }
    };
    Ok(PriceSample { cost, core_seconds, map, savings })
}

/// A renderer for each thread, which share compiled scenes.
fn renderers(threads: usize) -> anyhow::Result<Vec<CpuRenderer>> {
    let first = CpuRenderer::new(Some(1), Simd::Auto)?;
    Ok((0..threads.max(1)).map(|_| first.sharing(1)).collect::<Result<_, _>>()?)
}
