//! Every option of an image and of an integrator, alone and in pairs, has a cost, a price and a picture.

use proto::preview_helper::{Drawing, HelperPicture, PictureLayer, PricePlan};
use scene::Job;
use serde_json::{Value, json};

use crate::{cost_sample, drawing, price};

/// Limit of times that so small pictures never take, even on a busy machine.
const ENOUGH_MS: u64 = 60_000;

/// Values of each option: its path, and one that changes what is rendered, stored or finished.
const OPTIONS: [(&str, &str); 17] = [
    ("/image/width", "24"),
    ("/image/height", "17"),
    ("/image/samples", "1"),
    ("/image/samples", "16"),
    ("/image/samples", r#"{ "adaptive": { "min": 16, "max": 64 } }"#),
    ("/image/seed", "7"),
    ("/image/region", "[3, 2, 20, 18]"),
    ("/image/format", r#""exr""#),
    ("/image/bits", "16"),
    ("/image/precision", r#""float""#),
    ("/image/exposure", "1"),
    ("/image/tone_map", r#""filmic""#),
    ("/image/denoise", "true"),
    ("/image/reweight_fireflies", "true"),
    ("/image/layers", r#"["depth", "object", "samples", "noisy"]"#),
    ("/image/light_groups", r#"["key"]"#),
    ("/scene/integrator", r#"{ "path": { "max_bounces": 2, "straight_shadows": true } }"#),
];

/// A job with these options, and with what they need; `None` if they exclude each other.
fn job_with(options: &[(&str, &str)]) -> Option<(String, Job)> {
    let mut file = json!({
        "scene": {
            "camera": { "position": [0, 1, 4], "look_at": [0, 0, 0] },
            "lights": [{ "point": { "position": [2, 3, 2], "group": "key" } }],
            "objects": [{ "shape": { "sphere": { "radius": 1 } } }],
        },
        "image": { "width": 40, "height": 32, "samples": 4 },
    });
    let mut set = |path: &str, value: &str| {
        let (parent, key) = path.rsplit_once('/').expect("a path");
        let value: Value = serde_json::from_str(value).expect("JSON");
        file.pointer_mut(parent).expect("an object")[key] = value;
    };
    for (path, value) in options {
        match *path {
            "/image/precision" | "/image/layers" => set("/image/format", r#""exr""#),
            "/image/light_groups" => {
                set("/scene/integrator", r#"{ "path": {} }"#);
                set("/image/format", r#""exr""#);
            }
            "/image/reweight_fireflies" => {
                set("/scene/integrator", r#"{ "path": {} }"#);
                set("/image/samples", "16");
            }
            _ => {}
        }
        if value.contains("noisy") {
            set("/image/denoise", "true");
        }
    }
    for (path, value) in options {
        set(path, value);
    }
    let text = file.to_string();
    let job = scene::parse(text.as_bytes()).ok()?;
    Some((text, job))
}

/// Everything that is drawn and measured of a job for those who ask what it looks like and what it costs.
fn check(options: &[(&str, &str)]) -> bool {
    let Some((text, job)) = job_with(options) else { return false };
    let cost = cost_sample::sample(&job, 1, ENOUGH_MS).unwrap_or_else(|error| panic!("{options:?}: {error:#}"));
    assert!(cost.rays > 0 && cost.encode_seconds_per_pixel > 0.0, "{options:?}: {cost:?}");
    let plan = PricePlan { sample_ms: ENOUGH_MS, map_ms: ENOUGH_MS, savings_ms: 0 };
    price(&text, &job, 1, plan).unwrap_or_else(|error| panic!("{options:?}: {error:#}"));
    // Without time, a picture is drawn smaller and scaled up.
    for (samples, limit_ms) in [(1, 0), (16, 0), (1, ENOUGH_MS), (16, ENOUGH_MS)] {
        let request = Drawing { width_px: 80, samples, layer: PictureLayer::Color, limit_ms };
        let HelperPicture { about, png } = drawing::draw(job.clone(), 0, &request)
            .unwrap_or_else(|error| panic!("{options:?} {samples} {limit_ms}: {error:#}"));
        assert!(png.starts_with(b"\x89PNG") && about.rendered_px > 0, "{options:?}");
    }
    true
}

#[test]
fn each_option_and_each_pair_has_a_cost_a_price_and_a_picture() {
    let mut valid = 0;
    for (index, option) in OPTIONS.iter().enumerate() {
        assert!(check(&[*option]), "{option:?} alone is not valid");
        for other in &OPTIONS[..index] {
            valid += u32::from(other.0 != option.0 && check(&[*other, *option]));
        }
    }
    assert!(valid > 100, "only {valid} pairs are valid");
}

#[test]
fn every_option_of_the_schema_is_among_them() {
    let schema = scene::schema();
    for (definition, at) in [("Image", "/image"), ("PathSettings", "")] {
        let properties = schema["$defs"][definition]["properties"].as_object().expect("properties");
        for name in properties.keys() {
            let is_known = OPTIONS.iter().any(|(path, value)| {
                (!at.is_empty() && *path == format!("{at}/{name}")) || (at.is_empty() && value.contains(name.as_str()))
            });
            assert!(is_known, "{definition} has {name}, for which no value is in the table");
        }
    }
}
