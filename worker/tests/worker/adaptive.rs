//! Adaptive samples and the denoiser: a block of pixels has as many samples as its noise needs, and a picture is denoised,
//! with the same bits on every path and in every tile.

use std::io::Cursor;

use proto::Rect;
use scene::integrator::Radiance;
use scene::sample_count::BLOCK_PX;
use scene::{Integrator, Job, Layer};
use serde_json::{Value, json};
use worker::image::PictureSpec;
use worker::stitch::TileRows;
use worker::{CancelFlag, CpuRenderer, Renderer, Simd, TilePixels, TileRequest};

use crate::lanes::levels;
use crate::motion_blur::{bits, part, render};

const WIDTH: u32 = 44;
const HEIGHT: u32 = 36;
const MIN: u32 = 8;
const MAX: u32 = 32;

/// A scene with even parts and noisy ones; its ball moves.
pub(crate) fn job(integrator: &Value, shutter: f64) -> Job {
    let x = json!({ "keys": [[0, -0.4], [2, 0.4]] });
    let text = json!({
        "scene": { "camera": { "position": [0, 1.2, 4], "look_at": [0, 0, 0] }, "integrator": integrator,
            "background": { "color": [0.5, 0.6, 0.7] },
            "lights": [{ "sphere": { "position": [1, 2, 2], "radius": 0.6, "color": [5, 5, 5] } }],
            "objects": [
                { "shape": { "translate": { "by": [x, 0, 0], "child": { "sphere": { "radius": 0.6 } } } },
                  "material": { "surface": { "roughness": 0.3 } } },
                { "shape": { "box": { "size": [3, 0.2, 3] } } }] },
        "frames": { "count": 3, "fps": 1, "shutter": shutter },
        "image": { "width": WIDTH, "height": HEIGHT, "format": "exr", "layers": ["depth", "samples"],
            "samples": { "adaptive": { "min": MIN, "max": MAX, "error": 0.01 } } },
    });
    scene::parse(text.to_string().as_bytes()).unwrap_or_else(|refusal| panic!("{refusal}: {text}"))
}

/// Pixels of frame 1, by the definition.
fn defined(job: &Job) -> Vec<Vec<f32>> {
    let exposure = job.exposure(1).expect("a valid frame");
    let adaptive = job.image.samples.adaptive().expect("it is adaptive");
    let integrators: Vec<Integrator<'_>> = exposure.instants.iter().map(Integrator::new).collect();
    let mut planes = vec![vec![0.0; (WIDTH * HEIGHT) as usize]; 6];
    for (left, top) in (0..HEIGHT).step_by(8).flat_map(|top| (0..WIDTH).step_by(8).map(move |left| (left, top))) {
        let block = (top..HEIGHT.min(top + BLOCK_PX))
            .flat_map(|y| (left..WIDTH.min(left + BLOCK_PX)).map(move |x| (x, y)))
            .collect::<Vec<_>>();
        let mut sums = vec![[0.0; 4]; block.len()];
        for (round, samples) in exposure.samples().into_iter().enumerate() {
            let before = sums.clone();
            for (sum, &(x, y)) in sums.iter_mut().zip(&block) {
                let start = integrators[0].sum_of_channels(sum);
                let sum_of = |sum, (integrator, part): (&Integrator<'_>, &std::ops::Range<u32>)| {
                    integrator.accumulate(x as f32, y as f32, part.start as f32, part.end as f32, sum)
                };
                let end: Radiance<f32> = integrators.iter().zip(&samples).fold(start, sum_of);
                *sum = [end.color.x, end.color.y, end.color.z, end.alpha];
            }
            let count = samples.last().expect("there is an instant").end;
            if count == MAX || (round > 0 && adaptive.is_done(count, before.into_iter().zip(sums.iter().copied()))) {
                for (sum, &(x, y)) in sums.iter().zip(&block) {
                    let layers = integrators.last().expect("there is an instant").layer_values(x as f32, y as f32);
                    let colors = sum.map(|sum| sum * (1.0 / count as f32));
                    let values = colors.into_iter().chain([layers.depth, count as f32]);
                    let place = (y * WIDTH + x) as usize;
                    planes.iter_mut().zip(values).for_each(|(plane, value)| plane[place] = value + 0.0);
                }
                break;
            }
        }
    }
    planes
}

/// The jobs of the tests.
fn jobs() -> [Job; 3] {
    let path = json!({ "path": { "max_bounces": 2 } });
    [job(&json!("direct"), 0.0), job(&path, 0.0), job(&path, 0.7)]
}

#[test]
fn every_path_and_tile_has_the_bits_of_the_definition() {
    for (index, job) in jobs().iter().enumerate() {
        let want = bits(&defined(job));
        let counts = &want[5 * (WIDTH * HEIGHT) as usize..];
        let has = |count: u32| counts.contains(&(count as f32).to_bits());
        assert!(has(MIN) && has(2 * MIN) && has(MAX), "blocks of job {index} differ");
        for level in [Simd::Scalar].into_iter().chain(levels()) {
            let renderer = CpuRenderer::new(Some(2), level).expect("a level of this CPU");
            let whole = render(&renderer, job, Rect::full(WIDTH, HEIGHT));
            assert_eq!(bits(&whole.planes), want, "job {index}, {level}");
            let rect = Rect { x: 8, y: 16, width: 32, height: HEIGHT - 16 };
            let tile = render(&renderer, job, rect);
            assert_eq!(bits(&tile.planes), part(&want, [WIDTH, HEIGHT], rect), "job {index}, {level}");
        }
    }
}

#[test]
fn a_denoised_picture_has_the_same_bytes_on_every_path_and_in_all_tiles() {
    let path = json!({ "path": { "max_bounces": 2 } });
    let adaptive = json!({ "adaptive": { "min": MIN, "max": MAX, "error": 0.01 } });
    let sharp = job(&path, 0.0);
    for samples in [json!(9), adaptive] {
        let mut job = job(&path, 0.7);
        job.image.samples = serde_json::from_value(samples).expect("a valid number");
        job.image.denoise = true;
        job.image.layers.push(Layer::Noisy);
        let picture = PictureSpec::new(&job.at(1).expect("a valid frame"));
        let written = |renderer: &CpuRenderer, rects: &[Rect]| {
            let tiles: Vec<TilePixels> = rects.iter().map(|&rect| render(renderer, &job, rect)).collect();
            let mut file = Cursor::new(Vec::new());
            picture.write(&mut TileRows(&tiles), &mut file, &CancelFlag::new()).expect("it can be written");
            file.into_inner()
        };
        let whole = [Rect::full(WIDTH, HEIGHT)];
        let tiles = [
            Rect { x: 0, y: 0, width: 32, height: 32 },
            Rect { x: 32, y: 0, width: WIDTH - 32, height: 32 },
            Rect { x: 0, y: 32, width: WIDTH, height: HEIGHT - 32 },
        ];
        let renderer = CpuRenderer::new(Some(1), Simd::Scalar).expect("it renders");
        let want = written(&renderer, &whole);
        for level in levels() {
            let renderer = CpuRenderer::new(Some(2), level).expect("a level of this CPU");
            assert!(written(&renderer, &whole) == want && written(&renderer, &tiles) == want, "{level}");
        }
        // Without blur, because the instants of a blurred frame are as many as the samples of a round.
        job.frames.shutter = sharp.frames.shutter.clone();
        let mut noisy = job.clone();
        noisy.image.denoise = false;
        noisy.image.layers.pop();
        let noisy = render(&renderer, &noisy, whole[0]);
        let rendered = render(&renderer, &job, whole[0]);
        assert_eq!(bits(&noisy.planes), bits(&rendered.planes[..noisy.planes.len()]), "the samples are the same");
    }
}

#[test]
fn progress_reaches_the_rays_of_the_job() {
    let [job, ..] = jobs();
    let rays = std::sync::atomic::AtomicU64::new(0);
    let count = |more| {
        rays.fetch_add(more, std::sync::atomic::Ordering::Relaxed);
    };
    let run = TileRequest { job: &job, frame: 1, rect: Rect::full(WIDTH, HEIGHT) };
    let renderer = CpuRenderer::new(Some(2), Simd::Auto).expect("it renders");
    renderer.render(&run, &CancelFlag::new(), &count).expect("it is not cancelled");
    assert_eq!(rays.into_inner(), job.rays_per_frame());
}

#[test]
fn a_pixel_that_always_has_the_most_samples_is_that_of_a_fixed_number() {
    let mut job = job(&json!({ "path": { "max_bounces": 2 } }), 0.0);
    let renderer = CpuRenderer::new(Some(2), Simd::Auto).expect("it renders");
    job.image.layers.clear();
    let adaptive = json!({ "adaptive": { "min": MAX, "max": MAX, "error": 0.01 } });
    job.image.samples = serde_json::from_value(adaptive).expect("a valid number");
    let whole = Rect::full(WIDTH, HEIGHT);
    let planes = render(&renderer, &job, whole).planes;
    job.image.samples = MAX.into();
    assert_eq!(bits(&planes), bits(&render(&renderer, &job, whole).planes));
}
