//! Fireflies: reweighted pictures have less noise, all light with many samples, and the same bits on every path.

use proto::Rect;
use serde_json::{Value, json};
use worker::image::PictureSpec;
use worker::{CpuRenderer, Simd, TilePixels};

use crate::lanes::levels;
use crate::light_groups::parsed;
use crate::motion_blur::{bits, part, render};

const WIDTH: u32 = 24;
const HEIGHT: u32 = 24;

/// A glass ball that focuses the light of a small lamp, which paths meet by chance alone.
fn text(samples: &Value, is_reweighted: bool) -> Value {
    json!({
        "scene": { "camera": { "position": [0, 2.2, 4], "look_at": [0, 0.4, 0] }, "integrator": { "path": { "max_bounces": 5 } },
            "background": { "color": [0.02, 0.02, 0.03] },
            "lights": [{ "sphere": { "position": [-1.4, 2.4, 0.3], "radius": 0.12, "color": [2, 1.8, 1.5], "visible": true } }],
            "objects": [
                { "shape": { "translate": { "by": [0.1, 0.7, 0], "child": { "sphere": { "radius": 0.6 } } } },
                  "material": { "surface": { "transmission": 1, "ior": 1.5, "roughness": 0 } } },
                { "shape": { "plane": { "normal": [0, 1, 0], "offset": 0 } } }
            ] },
        "frames": { "count": 3, "fps": 1 },
        "image": { "width": WIDTH, "height": HEIGHT, "samples": samples, "format": "exr", "precision": "float",
            "reweight_fireflies": is_reweighted }
    })
}

/// The finished planes of a rectangle.
fn finished(renderer: &CpuRenderer, text: &Value, rect: Rect) -> TilePixels {
    let job = parsed(text);
    let picture = PictureSpec::new(&job.at(1).expect("a valid frame"));
    picture.finished_tile(render(renderer, &job, picture.rendered_for(rect)), rect)
}

fn colors(text: &Value) -> Vec<f32> {
    let renderer = CpuRenderer::new(None, Simd::Auto).expect("a renderer");
    finished(&renderer, text, Rect::full(WIDTH, HEIGHT)).planes[..3].concat()
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}

#[test]
fn fireflies_go_and_all_light_counts_with_many_samples() {
    let light = |values: &[f32]| mean(values.iter().map(|&value| value.into()));
    let (want, reweighted) = (colors(&text(&json!(4096), false)), colors(&text(&json!(4096), true)));
    let lost = 1.0 - light(&reweighted) / light(&want);
    assert!((0.0..0.01).contains(&lost), "{lost} of the light is lost");
    let error = |text: &Value| {
        let got = colors(text);
        mean(got.iter().zip(&want).map(|(&got, &want)| {
            let (difference, want) = (f64::from(got) - f64::from(want), f64::from(want));
            difference * difference / (want * want + 0.01)
        }))
    };
    let (raw, reweighted) = (error(&text(&json!(32), false)), error(&text(&json!(32), true)));
    assert!(reweighted < 0.5 * raw, "a relative mean square error of {reweighted}, {raw} without");
}

#[test]
fn reweighted_pictures_have_the_same_bits_on_every_path_and_in_tiles() {
    let adaptive = json!({ "adaptive": { "min": 16, "max": 64, "error": 0.05 } });
    for (samples, is_denoised) in [(json!(16), false), (adaptive.clone(), false), (json!(16), true), (adaptive, true)] {
        let mut text = text(&samples, true);
        text["image"]["denoise"] = json!(is_denoised);
        text["image"]["layers"] = json!(["depth", "noisy"]);
        text["scene"]["lights"][0]["sphere"]["group"] = json!("lamp");
        text["image"]["light_groups"] = json!(["lamp"]);
        let whole = Rect::full(WIDTH, HEIGHT);
        let pixels = finished(&CpuRenderer::new(None, Simd::Scalar).expect("it renders"), &text, whole);
        let want = bits(&pixels.planes);
        for level in levels() {
            let renderer = CpuRenderer::new(None, level).expect("a level of this CPU");
            assert!(bits(&finished(&renderer, &text, whole).planes) == want, "{text}: {level}");
            for rect in [Rect { x: 8, y: 8, width: 16, height: 8 }, Rect { x: 16, y: 0, width: 8, height: 24 }] {
                let tile = finished(&renderer, &text, rect);
                assert!(bits(&tile.planes) == part(&want, [WIDTH, HEIGHT], rect), "{text}: {level}, a tile");
            }
        }
        // Layers and light groups are as sampled, and so is `noisy`.
        let mut without = text.clone();
        without["image"]["reweight_fireflies"] = json!(false);
        without["image"]["denoise"] = json!(false);
        without["image"]["layers"] = json!(["depth"]);
        let sampled = finished(&CpuRenderer::new(None, Simd::Auto).expect("it renders"), &without, whole);
        assert_eq!(sampled.planes.len() + 3, pixels.planes.len());
        assert!(bits(&sampled.planes[3..]) == bits(&pixels.planes[3..sampled.planes.len()]), "{text}: other planes");
        assert!(bits(&sampled.planes[..3]) == bits(&pixels.planes[sampled.planes.len()..]), "{text}: noisy");
        assert!(bits(&sampled.planes[..3]) != bits(&pixels.planes[..3]), "{text}: no firefly");
    }
}

#[test]
fn a_program_shown_in_a_browser_has_no_levels() {
    let program = |is_reweighted| {
        let job = parsed(&text(&json!(16), is_reweighted));
        worker::wgsl::Shader::new(&job.at(0).expect("a valid frame")).expect("a program").text
    };
    assert_eq!(program(true), program(false));
}
