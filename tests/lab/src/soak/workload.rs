//! Jobs that a soak submits, and their expected pictures, which are rendered in this process before the farm starts.

use std::io::Cursor;
use std::path::Path;

use anyhow::Context;
use serde_json::{Value, json};
use worker::frame::render_frame;
use worker::{CancelFlag, CpuRenderer, Simd};

use crate::program::job_text;

/// Shipped scenes that render quickly, and the samples of their jobs. With more than 4 Mi rays, a worker
/// without a measured speed gets one tile, so frames of many samples are stitched.
const SCENES: [(&str, [u32; 4]); 3] =
    [("csg", [1, 160, 4, 16]), ("five-spheres", [4, 16, 1, 160]), ("mandelbulb", [1, 4, 2, 8])];
/// Size of the pictures: eight tiles of 64 pixels.
const SIZE_PX: (u32, u32) = (256, 128);

/// Job with its expected pictures.
#[derive(Debug)]
pub(super) struct ReferenceJob {
    /// The job file.
    pub(super) text: Vec<u8>,
    /// BLAKE3 of each frame's expected picture.
    pub(super) pictures: Vec<blake3::Hash>,
}

/// Creates the jobs; their seeds follow from the soak's.
pub(super) fn reference_jobs(seed: u64, threads: Option<usize>) -> anyhow::Result<Vec<ReferenceJob>> {
    let renderer = CpuRenderer::new(threads, Simd::Auto)?;
    let mut tasks = Vec::new();
    for (scene, samples) in SCENES {
        for (number, samples) in (0..).zip(samples) {
            let text = job(scene, seed, number, samples)?;
            let parsed = scene::parse(&text).with_context(|| format!("the shipped scene {scene} is damaged"))?;
            let mut pictures = Vec::new();
            for frame in 0..parsed.frames.count {
                let mut picture = Cursor::new(Vec::new());
                let scratch = std::env::temp_dir();
                render(&renderer, &parsed, frame, &scratch, &mut picture)?;
                pictures.push(blake3::hash(picture.get_ref()));
            }
            tasks.push(ReferenceJob { text, pictures });
        }
    }
    Ok(tasks)
}

fn render(
    renderer: &CpuRenderer,
    job: &scene::Job,
    frame: u32,
    scratch: &Path,
    out: &mut Cursor<Vec<u8>>,
) -> anyhow::Result<()> {
    render_frame(renderer, job, frame, None, scratch, out, &CancelFlag::new(), &|_| {})
        .context("could not render an expected picture")?;
    Ok(())
}

/// Makes a shipped scene a small job of two to four frames, PNG and EXR in turn.
fn job(scene: &str, seed: u64, number: u64, samples: u32) -> anyhow::Result<Vec<u8>> {
    let mut job: Value = serde_json::from_slice(&job_text(scene)?).context("a shipped scene is not JSON")?;
    let image = if number.is_multiple_of(2) {
        json!({ "format": "png" })
    } else {
        json!({ "format": "exr", "layers": ["depth", "normal"] })
    };
    job["image"] = image;
    job["image"]["width"] = SIZE_PX.0.into();
    job["image"]["height"] = SIZE_PX.1.into();
    job["image"]["samples"] = samples.into();
    job["image"]["seed"] = (seed % 1_000_000 * 100 + number).into();
    job["frames"] = json!({ "count": 2 + number % 3 });
    job["name"] = format!("soak {scene} {number}").into();
    Ok(job.to_string().into_bytes())
}
