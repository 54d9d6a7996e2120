//! The helper process: reads a request in one line from standard input, and exits when that closes.

use std::io::{BufRead, BufReader, Read};
use std::time::Duration;

use anyhow::Context;
use proto::preview_helper::{HelperRequest, PickView, PictureLayer, StoredLayer};
use rustix::process::{Resource, Rlimit, nice, setrlimit};
use worker::image::stored::StoredPicture;
use worker::{CancelFlag, CpuRenderer, Simd};

use crate::verify::{Extent, Original, unreadable};
use crate::{coarse, cost_sample, drawing, preview, price, shader, stored_picture, thumbnail};

/// Maximum bytes of the request line; a job file in it is written as a JSON string.
const MAX_LINE_BYTES: u64 = 64 << 20;
/// Stack size of the working thread, because it parses deeply nested job files.
const STACK_BYTES: usize = 32 << 20;
/// Limit of the address space for drawing.
const MAX_HELPER_BYTES: u64 = 4 << 30;
/// A sample yields to everything except the pool's own workers.
const SAMPLE_NICENESS: i32 = 10;
/// A picture for a client that waits for it yields to everything except the pool's workers and samples.
const LIVE_NICENESS: i32 = 5;
/// A thumbnail yields to everything, also to the pool's workers: a page asks for hundreds of them.
const THUMBNAIL_NICENESS: i32 = 19;
/// A program is made in milliseconds, while a scene is dragged.
const PROGRAM_NICENESS: i32 = 0;

/// Reads the request; returns the bytes of the response.
pub fn run() -> anyhow::Result<Vec<u8>> {
    let mut input = BufReader::new(std::io::stdin());
    let mut line = Vec::new();
    input.by_ref().take(MAX_LINE_BYTES).read_until(b'\n', &mut line).context("could not read the request")?;
    let request: HelperRequest = serde_json::from_slice(&line).context("could not parse the request")?;
    set_limits(&request)?;
    std::thread::spawn(move || {
        // A killed server leaves no helper behind: its end of the pipe closes.
        drop(std::io::copy(&mut input, &mut std::io::sink()));
        std::process::exit(1);
    });
    let work = std::thread::Builder::new().name("preview-helper".to_owned()).stack_size(STACK_BYTES);
    let work = work.spawn(move || answer(&request)).context("could not start a thread")?;
    work.join().map_err(|_| anyhow::anyhow!("drawing panicked"))?
}

/// Lowers this helper's priority, and limits its memory.
fn set_limits(request: &HelperRequest) -> anyhow::Result<()> {
    let (niceness, most_bytes) = match request {
        HelperRequest::Thumbnail { .. } => (THUMBNAIL_NICENESS, Some(MAX_HELPER_BYTES)),
        HelperRequest::Preview { .. }
        | HelperRequest::Draw { .. }
        | HelperRequest::Pick { .. }
        | HelperRequest::ReadLayers { .. }
        | HelperRequest::DrawLayer { .. }
        | HelperRequest::ReadPixel { .. } => (LIVE_NICENESS, Some(MAX_HELPER_BYTES)),
        HelperRequest::Shader { .. } => (PROGRAM_NICENESS, Some(MAX_HELPER_BYTES)),
        HelperRequest::MeasureCost { .. } | HelperRequest::Price { .. } | HelperRequest::Verify { .. } => {
            (SAMPLE_NICENESS, None)
        }
    };
    nice(niceness).context("could not lower this process's priority")?;
    match most_bytes {
        Some(bytes) => {
            let limit = Rlimit { current: Some(bytes), maximum: Some(bytes) };
            setrlimit(Resource::As, limit).context("could not limit memory")
        }
        None => Ok(()),
    }
}

/// Bytes of the response.
fn answer(request: &HelperRequest) -> anyhow::Result<Vec<u8>> {
    match request {
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
            Ok(serde_json::to_vec(&cost_sample::sample(&job, *threads, *render_ms)?)?)
        }
    }
}
