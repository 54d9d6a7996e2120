//! Job files for the tests: the shipped ones, and small ones derived from them.

use std::path::Path;
use std::{fs, io};

use serde_json::{Value, json};

use crate::support::root;

/// All layers of an EXR.
pub(crate) const LAYERS: [&str; 6] = ["depth", "normal", "position", "albedo", "object", "steps"];

/// All job files in scenes/, by their paths without `.json`.
pub(crate) fn shipped() -> Vec<(String, Value)> {
    let mut jobs = Vec::new();
    collect(&root().join("scenes"), "", &mut jobs).expect("scenes/ is readable");
    jobs.sort_by(|(left, _), (right, _)| left.cmp(right));
    assert!(jobs.len() >= 3, "scenes/ holds job files");
    jobs
}

fn collect(folder: &Path, prefix: &str, jobs: &mut Vec<(String, Value)>) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let (path, name) = {
            let entry = entry?;
            (entry.path(), entry.file_name().to_string_lossy().into_owned())
        };
        if path.is_dir() {
            collect(&path, &format!("{prefix}{name}/"), jobs)?;
        } else if let Some(stem) = name.strip_suffix(".json") {
            let job = serde_json::from_slice(&fs::read(&path)?).unwrap_or_else(|error| panic!("{name}: {error}"));
            jobs.push((format!("{prefix}{stem}"), job));
        }
    }
    Ok(())
}

/// Reads a shipped job.
pub(crate) fn named(name: &str) -> Value {
    let text = fs::read(root().join(format!("scenes/{name}.json"))).expect("a shipped job");
    serde_json::from_slice(&text).expect("a shipped job is JSON")
}

/// Scales the job to another width with the same aspect ratio.
pub(crate) fn sized(job: &Value, width: u64, samples: u64) -> Value {
    let mut job = job.clone();
    let image = &mut job["image"];
    let (old_width, old_height) = (number(&image["width"]), number(&image["height"]));
    image["height"] = json!((old_height * width / old_width).max(1));
    image["width"] = json!(width);
    image["samples"] = json!(samples);
    if samples < 16 {
        // Among few samples, fireflies are not rare.
        image.as_object_mut().expect("a job has an image").remove("reweight_fireflies");
    }
    job
}

/// Sets the job's format to PNG.
pub(crate) fn as_png(job: &Value) -> Value {
    let mut job = job.clone();
    let image = job["image"].as_object_mut().expect("a job has an image");
    image.insert("format".to_owned(), json!("png"));
    for key in ["layers", "light_groups", "precision"] {
        image.remove(key);
    }
    job
}

/// Sets the job's format to float EXR with all layers.
pub(crate) fn as_exr(job: &Value) -> Value {
    let mut job = job.clone();
    let image = job["image"].as_object_mut().expect("a job has an image");
    for key in ["bits", "exposure", "tone_map"] {
        image.remove(key);
    }
    image.insert("format".to_owned(), json!("exr"));
    image.insert("precision".to_owned(), json!("float"));
    image.insert("layers".to_owned(), json!(LAYERS));
    job
}

/// Sets another seed: the pictures differ, the work is the same.
pub(crate) fn seeded(job: &Value, seed: u64) -> Value {
    let mut job = job.clone();
    job["image"]["seed"] = json!(seed);
    job
}

/// Job that renders quickly.
pub(crate) fn quick() -> Value {
    as_png(&sized(&named("csg"), 96, 2))
}

/// A square of this many pixels and rays a pixel through 400 rough glass balls.
pub(crate) fn of_long_tiles(edge: u64, samples: u64) -> Value {
    let balls: Vec<Value> = (0..400)
        .map(|number| {
            let by = [f64::from(number % 20) / 10.0 - 1.0, f64::from(number / 20) / 10.0 - 1.0, 0.0];
            json!({ "translate": { "by": by, "child": { "sphere": { "radius": 0.06 } } } })
        })
        .collect();
    json!({
        "scene": {
            "camera": { "position": [0, 0, 3], "look_at": [0, 0, 0] },
            "background": { "color": [0.5, 0.6, 0.8] },
            "integrator": { "path": { "max_bounces": 12 } },
            "objects": [{
                "shape": { "union": { "of": balls } },
                "material": { "surface": { "transmission": 1, "ior": 1.5, "roughness": 0.3 } }
            }]
        },
        "image": { "width": edge, "height": edge, "samples": samples }
    })
}

/// Job with more than 4 Mi rays, the most in one batch of a worker of unknown speed: its frames are stitched. Its rays
/// are as cheap as rays can be.
pub(crate) fn many_rays() -> Value {
    json!({
        "scene": {
            "camera": { "position": [0, 0, 5], "look_at": [0, 0, 0] },
            "objects": [{ "shape": { "sphere": { "radius": 1 } }, "material": "flat" }],
            "materials": { "flat": { "flat": { "color": [0.9, 0.3, 0.1] } } },
            "background": { "gradient": { "bottom": [1, 1, 1], "top": [0.2, 0.5, 1] } },
        },
        "image": { "width": 288, "height": 162, "samples": 100 },
    })
}

/// Job that no machine finishes during a test.
pub(crate) fn endless() -> Value {
    as_png(&sized(&named("mandelbulb"), 3840, 1024))
}

fn number(value: &Value) -> u64 {
    value.as_u64().expect("a whole number")
}

/// A job of copies whose placements are formulas of noise: a small text that takes long to read.
pub(crate) fn of_noisy_copies(count: u32) -> Value {
    let noise = |seed: u32| json!({ "expr": format!("noise(i, {seed}) + noise(2 * i) + noise(3 * i) + noise(5 * i)") });
    let at = json!({ "count": count, "by": [noise(1), noise(2), noise(3)], "scale": { "expr": "1 + noise(i) / 2" } });
    of_shape(&json!({ "copies": { "child": { "sphere": { "radius": 0.1 } }, "at": at } }))
}

/// A job whose shapes each use the one before twice: a small text of 2 to the power of `doublings` nodes.
pub(crate) fn of_doublings(doublings: u32) -> Value {
    let twice = |name: &str| json!({ "union": { "of": [{ "use": name }, { "use": name }] } });
    let mut job = of_shape(&twice(&format!("s{}", doublings - 1)));
    job["scene"]["shapes"]["s0"] = json!({ "sphere": { "radius": 1 } });
    for level in 1..doublings {
        job["scene"]["shapes"][format!("s{level}")] = twice(&format!("s{}", level - 1));
    }
    job
}

/// A job of one ball with about this many textures in its color, as ramps of ramps of checkers.
pub(crate) fn of_nested_textures(count: usize) -> Value {
    let ramp = |colors: Vec<Value>| {
        let last = (colors.len() - 1).max(1) as f64;
        let stops = colors.into_iter().enumerate().map(|(stop, color)| json!([stop as f64 / last, color]));
        json!({ "marble": { "ramp": stops.collect::<Vec<_>>() } })
    };
    let checkers = (0..32).map(|number| json!({ "checker": { "cell": 0.1 + f64::from(number) / 100.0 } }));
    let inner = ramp(vec![ramp(checkers.collect()); 32]);
    let mut job = of_shape(&json!({ "sphere": { "radius": 1 } }));
    job["scene"]["objects"][0]["material"] =
        json!({ "diffuse": { "kd": ramp(vec![inner; count.div_ceil(32 * 33).max(2)]) } });
    job
}

fn of_shape(shape: &Value) -> Value {
    json!({
        "scene": { "camera": { "position": [0, 0, 9], "look_at": [0, 0, 0] }, "objects": [{ "shape": shape }] },
        "image": { "width": 8, "height": 8, "samples": 1 },
    })
}
