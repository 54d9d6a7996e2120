//! Light groups: they sum to the picture, each is the light of its lights, and the bits are the same on every path.

use std::io::Cursor;

use exr::image::FlatSamples;
use half::f16;
use proto::Rect;
use scene::Job;
use serde_json::{Value, json};
use worker::image::PictureSpec;
use worker::stitch::TileRows;
use worker::{CancelFlag, CpuRenderer, Renderer, Simd, TilePixels, TileRequest};

use crate::lanes::levels;
use crate::motion_blur::{bits, part, render};
use crate::read_back::decode_exr;

const WIDTH: u32 = 40;
const HEIGHT: u32 = 24;
/// Pixels of a picture.
const PIXELS: usize = (WIDTH * HEIGHT) as usize;
/// Value above which a pixel counts as this bright.
const BRIGHTEST: f32 = 4.0;
/// The groups of the scene, and the rest.
const GROUPS: [&str; 5] = ["key", "fill", "lamp", "sky", "rest"];

/// A glass ball and a lamp on a floor, under a key light, a fill light that is seen, and the sky. A light without a group
/// is behind the ball.
fn text() -> Value {
    let at = |by: [f64; 3], shape: Value| json!({ "translate": { "by": by, "child": shape } });
    let ball = |radius: f64| json!({ "sphere": { "radius": radius } });
    json!({
        "scene": { "camera": { "position": [0, 1.2, 4], "look_at": [0, 0.3, 0] }, "integrator": { "path": { "max_bounces": 4 } },
            "background": { "gradient": { "bottom": "#302820", "top": "#506090" } },
            "lights": [
                { "rectangle": { "position": [-2, 3, 2], "direction": [2, -3, -2], "width": 1, "height": 1, "color": [8, 7, 6], "group": "key" } },
                { "sphere": { "position": [1.2, 1.2, 0.4], "radius": 0.2, "color": [1, 1.5, 2.5], "visible": true, "group": "fill" } },
                { "sky": { "group": "sky" } },
                { "point": { "position": [-1, 1.5, -1.5], "color": [1, 0.3, 0.3] } }
            ],
            "objects": [
                { "shape": at([-0.3, 0.6, 0.5], ball(0.6)), "material": { "surface": { "transmission": 1, "ior": 1.5, "roughness": 0 } } },
                { "shape": at([1.0, 0.25, 1.0], ball(0.25)), "light_group": "lamp", "material": { "flat": { "color": [1.5, 1.2, 0.3] } } },
                { "shape": { "plane": { "normal": [0, 1, 0], "offset": 0 } } }
            ] },
        "frames": { "count": 3, "fps": 1 },
        "image": { "width": WIDTH, "height": HEIGHT, "samples": 8, "format": "exr", "precision": "float",
            "light_groups": ["key", "fill", "lamp", "sky"], "layers": ["depth"] }
    })
}

pub(crate) fn parsed(text: &Value) -> Job {
    scene::parse(text.to_string().as_bytes()).unwrap_or_else(|refusal| panic!("{refusal}\n{text}"))
}

fn rendered(text: &Value) -> TilePixels {
    let renderer = CpuRenderer::new(None, Simd::Auto).expect("a renderer");
    render(&renderer, &parsed(text), Rect::full(WIDTH, HEIGHT))
}

/// The planes of a group, by its place.
fn planes_of(pixels: &TilePixels, group: usize) -> &[Vec<f32>] {
    &pixels.planes[4 + 3 * group..][..3]
}

/// Fails unless the groups sum to the colors but for rounding.
fn assert_sums(pixels: &TilePixels, groups: usize, what: &str) {
    for channel in 0..3 {
        for pixel in 0..PIXELS {
            let sum: f64 = (0..groups).map(|group| f64::from(planes_of(pixels, group)[channel][pixel])).sum();
            let color = f64::from(pixels.planes[channel][pixel]);
            let difference = (sum - color).abs();
            assert!(
                difference <= 2e-6 * color.abs().max(1e-3),
                "{what}, channel {channel}, pixel {pixel}: {sum}, not {color}"
            );
        }
    }
}

/// Mean of the values of some planes, which rare bright ones do not decide.
fn mean(planes: &[Vec<f32>]) -> f64 {
    let count: usize = planes.iter().map(Vec::len).sum();
    planes.iter().flatten().map(|value| f64::from(value.min(BRIGHTEST))).sum::<f64>() / count as f64
}

/// Scenes with each way in which light is found.
pub(crate) fn scenes() -> Vec<(&'static str, Value)> {
    let mut media = text();
    let glow = json!({ "volume": { "density": 1.5, "albedo": [0.7, 0.8, 0.9], "emission": [0.4, 0.1, 0.05] } });
    media["scene"]["objects"][1]["material"] = glow;
    let mut hidden = text();
    hidden["scene"]["objects"][1]["visible"] = json!({ "camera": false });
    let mut foggy = text();
    foggy["scene"]["fog"] = json!({ "density": 0.15, "color": [0.5, 0.5, 0.6] });
    let mut caught = text();
    caught["scene"]["objects"][2]["material"] = json!({ "shadow_catcher": {} });
    caught["scene"]["background"] = json!({ "day": { "sun": [0.5, 0.4, 0.3] } });
    caught["scene"]["lights"][3] = json!({ "sun": {} });
    let mut many = text();
    for index in 0..120 {
        let (x, z) = (f64::from(index % 12) * 0.4 - 2.2, f64::from(index / 12) * 0.4 - 3.0);
        let emission = json!({ "surface": { "emission": { "checker": { "cell": 0.1, "colors": [[0.2, 0, 0], [0, 0.2, 0.3]] } } } });
        many["scene"]["objects"].as_array_mut().expect("objects").push(json!({
            "shape": { "translate": { "by": [x, 0.1, z], "child": { "sphere": { "radius": 0.1 } } } },
            "material": emission, "light_group": (if index < 60 { "lamp" } else { "key" })
        }));
    }
    let mut moving = text();
    moving["scene"]["objects"][0]["shape"]["translate"]["by"][0] = json!({ "keys": [[0, -1], [2, 1]] });
    moving["frames"]["shutter"] = json!(0.6);
    let mut lens = text();
    lens["scene"]["camera"]["lens"] = json!({ "aperture": 0.3, "focus": 3.5 });
    lens["image"]["samples"] = json!({ "adaptive": { "min": 16, "max": 64, "error": 0.1 } });
    lens["image"]["layers"] = json!(["depth", "samples", "normal"]);
    lens["image"]["reweight_fireflies"] = json!(true);
    let mut denoised = moving.clone();
    denoised["image"]["denoise"] = json!(true);
    denoised["image"]["layers"] = json!(["noisy", "albedo"]);
    denoised["image"]["samples"] = json!(16);
    denoised["image"]["reweight_fireflies"] = json!(true);
    vec![
        ("plain", text()),
        ("media", media),
        ("visible to some rays", hidden),
        ("fog", foggy),
        ("shadow catcher", caught),
        ("cells", many),
        ("motion blur", moving),
        ("lens and adaptive samples", lens),
        ("denoised", denoised),
    ]
}

#[test]
fn groups_sum_to_the_picture_and_have_the_same_bits_on_every_path_and_in_tiles() {
    for (name, text) in scenes() {
        let job = parsed(&text);
        let whole = Rect::full(WIDTH, HEIGHT);
        let pixels = render(&CpuRenderer::new(None, Simd::Scalar).expect("it renders"), &job, whole);
        assert_sums(&pixels, GROUPS.len(), name);
        let want = bits(&pixels.planes);
        for level in levels() {
            let renderer = CpuRenderer::new(None, level).expect("a level of this CPU");
            assert!(bits(&render(&renderer, &job, whole).planes) == want, "{name}: {level}");
            let rect = Rect { x: 8, y: 8, width: 24, height: 16 };
            let tile = render(&renderer, &job, rect);
            assert!(bits(&tile.planes) == part(&want, [WIDTH, HEIGHT], rect), "{name}: {level}, a tile");
        }
        // The other planes are the same as without groups.
        let mut without = text.clone();
        without["image"]["light_groups"] = json!([]);
        let without = rendered(&without);
        let others = [&pixels.planes[..4], &pixels.planes[4 + 3 * GROUPS.len()..]].concat();
        assert!(bits(&without.planes) == bits(&others), "{name}: the picture differs from that without groups");
    }
}

#[test]
fn each_group_is_the_picture_of_its_lights_alone() {
    let mut text = text();
    text["image"]["samples"] = json!(256);
    let pixels = rendered(&text);
    let black = json!([0, 0, 0]);
    for (group, name) in GROUPS.into_iter().enumerate() {
        let mut alone = text.clone();
        alone["image"]["light_groups"] = json!([]);
        let scene = &mut alone["scene"];
        let of_group = |light: &Value| {
            let own = light.as_object().and_then(|light| light.values().next()).and_then(|light| light.get("group"));
            own.and_then(Value::as_str).unwrap_or("rest") == name
        };
        // The ball of the fill light stays where it is, nearly black.
        for light in scene["lights"].as_array_mut().expect("lights") {
            let is_dark = !of_group(light);
            for light in light.as_object_mut().into_iter().flat_map(|light| light.values_mut()).filter(|_| is_dark) {
                let (key, value) = if light.get("color").is_some() {
                    ("color", json!([1e-6, 1e-6, 1e-6]))
                } else {
                    ("strength", json!(0))
                };
                light[key] = value;
            }
        }
        if name != "sky" {
            scene["background"] = json!({ "color": black });
        }
        if name != "lamp" {
            scene["objects"][1]["material"]["flat"]["color"] = black.clone();
        }
        let alone = rendered(&alone);
        let (got, want) = (mean(planes_of(&pixels, group)), mean(&alone.planes[..3]));
        assert!(want > 0.004 && (got / want - 1.0).abs() < 0.03, "{name}: {got}, not {want}");
        // Blocks of pixels agree, too.
        for (top, left) in (0..HEIGHT).step_by(12).flat_map(|top| (0..WIDTH).step_by(20).map(move |left| (top, left))) {
            let block = |planes: &[Vec<f32>]| {
                let rows = (top..top + 12).flat_map(|y| (left..left + 20).map(move |x| (y * WIDTH + x) as usize));
                mean(&[rows.flat_map(|pixel| planes.iter().map(move |plane| plane[pixel])).collect()])
            };
            let (got, want) = (block(planes_of(&pixels, group)), block(&alone.planes[..3]));
            assert!((got - want).abs() < 0.1 * want + 0.003, "{name}, block {left}, {top}: {got}, not {want}");
        }
    }
}

#[test]
fn light_of_a_group_without_light_is_exactly_0_and_alone_it_is_the_picture() {
    let mut only = text();
    let scene = &mut only["scene"];
    let lights = scene["lights"].as_array_mut().expect("lights");
    lights.truncate(1);
    scene["background"] = json!({ "color": [0, 0, 0] });
    scene["objects"][1]["material"]["flat"]["color"] = json!([0, 0, 0]);
    only["image"]["light_groups"] = json!(["lamp", "key"]);
    let pixels = rendered(&only);
    assert_eq!(bits(planes_of(&pixels, 1)), bits(&pixels.planes[..3]));
    for group in [0, 2] {
        assert!(planes_of(&pixels, group).iter().flatten().all(|value| value.to_bits() == 0));
    }
}

#[test]
fn a_file_has_the_channels_of_each_group_with_the_precision_of_color() {
    for (precision, is_half) in [("half", true), ("float", false)] {
        let mut text = text();
        text["image"]["precision"] = json!(precision);
        let (job, pixels) = (parsed(&text), rendered(&text));
        let mut file = Cursor::new(Vec::new());
        let picture = PictureSpec::new(&job.at(1).expect("a valid frame"));
        picture.write(&mut TileRows(std::slice::from_ref(&pixels)), &mut file, &CancelFlag::new()).expect("a picture");
        let image = decode_exr(&file.into_inner());
        let channels = &image.layer_data[0].channel_data.list;
        for (group, name) in GROUPS.into_iter().enumerate() {
            for (plane, letter) in planes_of(&pixels, group).iter().zip(["R", "G", "B"]) {
                let channel =
                    channels.iter().find(|channel| channel.name.to_string() == format!("light.{name}.{letter}"));
                let channel = channel.unwrap_or_else(|| panic!("no channel of {name}"));
                assert_eq!(matches!(channel.sample_data, FlatSamples::F16(_)), is_half);
                for (read, value) in channel.sample_data.values_as_f32().zip(plane) {
                    let rounded = if is_half { f16::from_f32(*value).to_f32() } else { *value };
                    assert_eq!(read, rounded + 0.0, "{name}");
                }
            }
        }
        assert_eq!(channels.len(), 4 + 3 * GROUPS.len() + 1);
    }
}

#[test]
fn groups_change_the_key_of_a_picture_that_lists_them_alone() {
    let keys = |group: &str, listed: Value| {
        let mut text = text();
        text["scene"]["lights"][3]["point"]["group"] = json!(group);
        text["image"]["light_groups"] = listed;
        let job = parsed(&text);
        let at_frame = job.at(0).expect("a valid frame");
        (at_frame.pixels_cache_key(), at_frame.cache_key(), at_frame.scene_hash())
    };
    assert_eq!(keys("key", json!([])), keys("fill", json!([])));
    assert_eq!(keys("key", json!(["sky"])), keys("fill", json!(["sky"])), "the rest has both");
    let (one, other) = (keys("key", json!(["key", "sky"])), keys("fill", json!(["key", "sky"])));
    assert!(one.0 != other.0 && one.1 != other.1 && one.2 != other.2);
    assert_ne!(keys("key", json!(["key", "sky"])).0, keys("key", json!(["sky", "key"])).0);
}

#[test]
fn a_program_shown_in_a_browser_has_no_groups() {
    let job = parsed(&text());
    let shader = worker::wgsl::Shader::new(&job.at(0).expect("a valid frame")).expect("a program");
    let mut without = text();
    without["image"]["light_groups"] = json!([]);
    let without = parsed(&without);
    let other = worker::wgsl::Shader::new(&without.at(0).expect("a valid frame")).expect("a program");
    assert_eq!(shader.text, other.text);
}

#[test]
fn recorded_rays_give_the_same_bits() {
    let job = parsed(&text());
    let renderer = CpuRenderer::new(Some(1), Simd::Auto).expect("a renderer");
    let run = TileRequest { job: &job, frame: 1, rect: Rect::full(WIDTH, HEIGHT) };
    let (pixels, _) = renderer.render_recorded(&run, &CancelFlag::new(), &|_| ()).expect("pixels");
    assert_eq!(bits(&pixels.planes), bits(&rendered(&text()).planes));
}
