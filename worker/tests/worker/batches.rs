//! Sums of many samples: sums of batches are added to each other, on every path.

use proto::Rect;
use scene::integrator::Radiance;
use scene::sample_count::BATCH;
use scene::{ImageSpec, Integrator, Job};
use serde_json::{Value, json};
use worker::{CpuRenderer, Simd};

use crate::adaptive;
use crate::lanes::levels;
use crate::motion_blur::{bits, render};

const WIDTH: u32 = 9;
const HEIGHT: u32 = 5;

/// A job of noisy light, with these samples.
pub(crate) fn job(integrator: &Value, shutter: f64, samples: Value) -> Job {
    let mut job = adaptive::job(integrator, shutter);
    let samples = serde_json::from_value(samples).expect("a valid number");
    job.image = ImageSpec { width: WIDTH, height: HEIGHT, samples, layers: Vec::new(), ..job.image };
    job
}

/// Pixels of frame 1, by the definition: one sample after another.
fn defined(job: &Job) -> Vec<u32> {
    let exposure = job.exposure(1).expect("a valid frame");
    let integrators: Vec<Integrator<'_>> = exposure.instants.iter().map(Integrator::new).collect();
    let [samples] = &exposure.samples()[..] else { panic!("it has no rounds") };
    let mean = |x: u32, y: u32| {
        let no_light = integrators[0].no_light(0.0);
        let (mut batches, mut batch): (Radiance<f32>, _) = (no_light, no_light);
        for (integrator, range) in integrators.iter().zip(samples) {
            for sample in range.clone() {
                if sample % BATCH == 0 {
                    (batches, batch) = (batches + batch, no_light);
                }
                batch = integrator.accumulate(x as f32, y as f32, sample as f32, (sample + 1) as f32, batch);
            }
        }
        integrators[0].mean(batches + batch)
    };
    let places = (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y)));
    let means: Vec<Radiance<f32>> = places.map(|(x, y)| mean(x, y)).collect();
    let planes: [fn(&Radiance<f32>) -> f32; 4] =
        [|mean| mean.color.x, |mean| mean.color.y, |mean| mean.color.z, |mean| mean.alpha];
    planes.iter().flat_map(|of| means.iter().map(|mean| (of(mean) + 0.0).to_bits())).collect()
}

#[test]
fn sums_are_those_of_batches_on_every_path() {
    let many = 2 * BATCH + 88;
    for integrator in [json!("direct"), json!({ "path": { "max_bounces": 2 } })] {
        let (sharp, blurred) = (job(&integrator, 0.0, json!(many)), job(&integrator, 0.7, json!(many)));
        assert!(blurred.exposure(1).expect("a valid frame").instants.len() > 1, "batches have several instants");
        let (of_sharp, of_blurred) = (defined(&sharp), defined(&blurred));
        // Rounds that end within batches, and at their ends: no block is done before the last.
        let mut denoised = sharp.clone();
        denoised.image.denoise = true;
        let adaptive = json!({ "adaptive": { "min": 8, "max": 512, "error": 0.0001 } });
        let (adaptive, fixed) = (job(&integrator, 0.0, adaptive), job(&integrator, 0.0, json!(512)));
        for level in [Simd::Scalar].into_iter().chain(levels()) {
            let renderer = CpuRenderer::new(Some(2), level).expect("a level of this CPU");
            let planes = |job: &Job| bits(&render(&renderer, job, Rect::full(WIDTH, HEIGHT)).planes[..4]);
            assert!(planes(&sharp) == of_sharp, "{integrator}, {level}");
            assert!(planes(&blurred) == of_blurred, "{integrator}, {level}");
            assert!(planes(&denoised) == of_sharp, "{integrator}, {level}");
            assert!(planes(&adaptive) == planes(&fixed), "{integrator}, {level}");
        }
    }
}

#[test]
fn even_light_is_exact_after_the_most_samples() {
    let light = 0.55_f32;
    let text = json!({
        "scene": { "camera": { "position": [0, 0, 4], "look_at": [0, 0, 0] }, "background": { "color": [light, light, light] },
            "objects": [{ "shape": { "translate": { "by": [0, 0, 9], "child": { "sphere": { "radius": 1 } } } } }] },
        "image": { "width": 2, "height": 1, "format": "exr", "samples": 65_536 },
    });
    let job = scene::parse(text.to_string().as_bytes()).expect("a valid job");
    let renderer = CpuRenderer::new(Some(1), Simd::Auto).expect("it renders");
    let [red, ..] = &render(&renderer, &job, Rect::full(2, 1)).planes[..] else { panic!("it has planes") };
    // A sum of all in a row is wrong by 6.6e-4 of it.
    assert!((red[0] - light).abs() < 1e-5 * light, "{}", red[0]);
}
