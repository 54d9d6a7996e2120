//! Finds the numbers of a job that would save most if they were lower, by trying: the same blocks are rendered with the number
//! as it is and lowered, and their times and pixels compared.

use std::time::{Duration, Instant};

use proto::Rect;
use proto::price::Saving;
use scene::color::srgb_from_linear;
use scene::film::DisplayTransform;
use scene::{Job, SampleCount};
use serde_json::Value;
use worker::{CpuRenderer, TilePixels};

use crate::cost_sample::{Pass, blocks};

/// Maximum number of savings.
const MAX_SAVINGS: usize = 3;
/// Least share of the time that is worth mentioning: less is within the error of a short measurement.
const MIN_SHARE: f64 = 0.05;
/// Time of all threads for one pass over the blocks, in seconds.
const PASS_SECONDS: f64 = 0.06;
/// Maximum number of blocks, and the least.
const MAX_BLOCKS: usize = 96;
const MIN_BLOCKS: usize = 4;
/// Maximum number of numbers that are tried.
const MAX_CANDIDATES: usize = 24;
/// Maximum rays a pixel in a try.
const MAX_SAMPLES: u32 = 8;
/// Materials whose `steps` are steps of a ray through them.
const MEDIA: [&str; 2] = ["clouds", "volume"];
/// Factor of a smaller picture's edges.
const SMALLER: f64 = 0.75;

/// A number that may be lowered.
#[derive(Clone, Debug, PartialEq)]
struct Candidate {
    /// Path as `scene::set_value` takes it.
    path: String,
    /// Its value, and the lower one; `None` where a member is removed.
    from: Option<f64>,
    to: Option<f64>,
    /// Meaning of the number, in words.
    noun: &'static str,
}

/// Finds what saves most of `core_seconds`, where a ray takes `ray_seconds`.
pub(super) fn find(
    text: &str,
    job: &Job,
    renderers: &[CpuRenderer],
    limit: Duration,
    ray_seconds: f64,
    core_seconds: f64,
) -> anyhow::Result<Vec<Saving>> {
    let start = Instant::now();
    let samples = job.image.samples.max().min(MAX_SAMPLES);
    let rects = chosen_blocks(job, ray_seconds * f64::from(samples), renderers.len());
    let frame = job.frames.count / 2;
    // A pass is cancelled after twice its limit, and a try has three.
    let pass_limit = limit / 10;
    let sampled = |job: &Job, samples: u32| {
        let mut job = job.clone();
        job.image.samples = samples.into();
        job
    };
    let base = Trial::run(&sampled(job, samples), frame, renderers, pass_limit, &rects)?;
    let mut savings = Vec::new();
    let plain: Value = serde_json::from_str(&scene::plain_json(text)).unwrap_or(Value::Null);
    for candidate in candidates(&plain, job).into_iter().take(MAX_CANDIDATES) {
        if start.elapsed() > limit {
            break;
        }
        let is_samples = candidate.path == "image.samples";
        let tried = if is_samples {
            Some(sampled(job, (samples / 2).max(1)))
        } else {
            lowered(text, &candidate).map(|job| sampled(&job, samples))
        };
        // A number that another one depends on may not be lowered alone.
        let Some(tried) = tried else { continue };
        let Ok(trial) = Trial::run(&tried, frame, renderers, pass_limit, &rects) else { continue };
        let share = 1.0 - trial.seconds / base.seconds.max(f64::MIN_POSITIVE);
        if share < MIN_SHARE {
            continue;
        }
        let mut change = trial.change_from(&base, &job.image, job.is_transparent());
        if is_samples {
            // Noise falls with the root of the number of rays; fewer than the job's were tried.
            change *= (f64::from(samples) / f64::from(job.image.samples.max())).sqrt();
        }
        savings.push(saving(&candidate, share, core_seconds, Some(change)));
    }
    if job.image.region.is_none() {
        savings.push(smaller(job, core_seconds));
    }
    savings.sort_by(|left, right| right.saves_share.total_cmp(&left.saves_share));
    savings.truncate(MAX_SAVINGS);
    Ok(savings)
}

/// Blocks all over the picture that one pass renders in its time.
fn chosen_blocks(job: &Job, pixel_seconds: f64, threads: usize) -> Vec<Rect> {
    let mut rects = blocks(job.image.film().width, job.image.film().height);
    let block_seconds = pixel_seconds * rects.first().map_or(1.0, |rect| rect.pixels() as f64);
    let fitting = PASS_SECONDS * threads as f64 / block_seconds.max(1e-9);
    rects.truncate((fitting as usize).clamp(MIN_BLOCKS, MAX_BLOCKS));
    rects
}

/// The job with a lower number.
fn lowered(text: &str, candidate: &Candidate) -> Option<Job> {
    let value = candidate.to.map_or_else(|| "null".to_owned(), |to| to.to_string());
    let path = candidate.path.as_str();
    let changed = scene::set_value(text, path, &value).or_else(|error| match path.strip_prefix("scene.march.") {
        // A job without limits has the default ones.
        Some(key) => scene::set_value(text, "scene.march", &format!("{{ \"{key}\": {value} }}")),
        None => Err(error),
    });
    let changed = changed.ok()?;
    scene::parse(changed.as_bytes()).ok()
}

/// The numbers that may be lowered, those that often save most first.
fn candidates(document: &Value, job: &Job) -> Vec<Candidate> {
    let mut found = Vec::new();
    if let SampleCount::Fixed(samples) = job.image.samples
        && samples >= 2
    {
        let samples = f64::from(samples);
        found.push(Candidate {
            path: "image.samples".to_owned(),
            from: Some(samples),
            to: Some((samples / 2.0).floor()),
            noun: "rays a pixel",
        });
    }
    let scene = &document["scene"];
    if scene["ambient_occlusion"].is_object() {
        let path = "scene.ambient_occlusion".to_owned();
        found.push(Candidate { path, from: None, to: None, noun: "ambient occlusion" });
    }
    let march = &job.scene.march;
    let limits = [
        ("max_bounces", march.max_bounces, "reflections and refractions of a ray"),
        ("max_steps", march.max_steps, "steps of a ray"),
    ];
    for (key, from, noun) in limits.into_iter().filter(|(_, from, _)| *from >= 2) {
        let (from, to) = (Some(f64::from(from)), Some(f64::from(from / 2)));
        found.push(Candidate { path: format!("scene.march.{key}"), from, to, noun });
    }
    walk(scene, "", "scene", &mut found);
    found
}

/// Collects numbers that cost time wherever they are in a scene; `kind` is the key that a value is under.
fn walk(value: &Value, kind: &str, path: &str, found: &mut Vec<Candidate>) {
    match value {
        Value::Object(members) => {
            for (key, inside) in members.iter().filter(|(key, _)| !key.contains('.')) {
                let path = format!("{path}.{key}");
                let Some(from) = inside.as_f64() else {
                    walk(inside, key, &path, found);
                    continue;
                };
                let lower = match key.as_str() {
                    "iterations" => Some((from - (from / 4.0).ceil(), "iterations")),
                    "octaves" => Some((from - (from / 3.0).ceil(), "octaves of noise")),
                    "steps" if MEDIA.contains(&kind) => Some(((from / 2.0).floor(), "steps of a ray inside")),
                    _ => None,
                };
                if let Some((to, noun)) = lower.filter(|(to, _)| *to < from) {
                    found.push(Candidate { path, from: Some(from), to: Some(to), noun });
                }
            }
        }
        Value::Array(entries) => {
            for (index, inside) in entries.iter().enumerate() {
                walk(inside, kind, &format!("{path}.{index}"), found);
            }
        }
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => {}
    }
}

/// A saving in words.
fn saving(candidate: &Candidate, share: f64, core_seconds: f64, change: Option<f64>) -> Saving {
    let Candidate { path, from, to, noun } = candidate;
    let rounded = |number: f64| format!("{number:.2e}").parse().unwrap_or(number);
    let step = match (from, to) {
        (Some(from), Some(to)) => format!("{path}: {to} {noun} instead of {from}"),
        _ => format!("{path}: no {noun}"),
    };
    let change = change.map(rounded);
    let seen = change.map_or_else(String::new, |change| match change {
        change if change < 0.05 => "; the picture stays the same".to_owned(),
        change => format!("; the picture changes by {change:.1} of 255 levels"),
    });
    Saving {
        pointer: format!("/{}", path.replace('.', "/")),
        from: *from,
        to: *to,
        saves_seconds: rounded(share * core_seconds),
        saves_share: rounded(share),
        change_levels: change,
        message: format!("{step} saves {:.0} %{seen}", share * 100.0),
    }
}

/// A smaller picture: its rays are counted.
fn smaller(job: &Job, core_seconds: f64) -> Saving {
    let [width, height] = [job.image.film().width, job.image.film().height].map(f64::from);
    let [to_width, to_height] = [width, height].map(|edge| (edge * SMALLER).round().max(1.0));
    let candidate =
        Candidate { path: "image.width".to_owned(), from: Some(width), to: Some(to_width), noun: "pixels of width" };
    let share = 1.0 - to_width * to_height / (width * height);
    let saving = saving(&candidate, share, core_seconds, None);
    Saving { message: format!("{} (with image.height {to_height})", saving.message), ..saving }
}

/// Blocks of a job, rendered.
struct Trial {
    /// CPU time for them, in seconds.
    seconds: f64,
    tiles: Vec<TilePixels>,
}

impl Trial {
    /// Renders the blocks: once to compile and to make what they share, and twice for the time: the shorter counts.
    fn run(job: &Job, frame: u32, renderers: &[CpuRenderer], limit: Duration, rects: &[Rect]) -> anyhow::Result<Self> {
        let frame = frame.min(job.frames.count - 1);
        Pass::render(job, frame, renderers, limit, rects)?;
        let [first, second] =
            [Pass::render(job, frame, renderers, limit, rects)?, Pass::render(job, frame, renderers, limit, rects)?];
        let per_ray = |pass: &Pass| pass.seconds / pass.rays.max(1) as f64;
        let pixels: f64 = rects.iter().map(|rect| rect.pixels() as f64).sum();
        let seconds = per_ray(&first).min(per_ray(&second)) * pixels * f64::from(job.image.samples.max());
        let mut tiles: Vec<TilePixels> = second.blocks.into_iter().map(|block| block.pixels).collect();
        tiles.sort_by_key(|tile| (tile.rect.y, tile.rect.x));
        Ok(Self { seconds, tiles })
    }

    /// Root of the mean square of the difference of two renders as they are displayed, in levels of 255.
    fn change_from(&self, other: &Self, image: &scene::ImageSpec, is_transparent: bool) -> f64 {
        let grade = DisplayTransform::new(image);
        let shown = |tile: &TilePixels, plane: usize, index: usize| {
            let alpha = if is_transparent { tile.planes[3][index].max(1e-6) } else { 1.0 };
            let light = grade.apply(tile.planes[plane][index] / alpha).clamp(0.0, 1.0);
            f64::from(srgb_from_linear(light)) * 255.0
        };
        let (mut squares, mut count) = (0.0, 0.0_f64);
        for tile in &self.tiles {
            let Some(same) = other.tiles.iter().find(|same| same.rect == tile.rect) else { continue };
            for index in 0..tile.planes[0].len() {
                for plane in 0..3 {
                    squares += (shown(tile, plane, index) - shown(same, plane, index)).powi(2);
                    count += 1.0;
                }
            }
        }
        (squares / count.max(1.0)).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BULB: &str = r#"{ "scene": { "camera": { "position": [0, 0, 3], "look_at": [0, 0, 0] },
        "ambient_occlusion": { "distance": 0.5 }, "march": { "max_steps": 300 },
        "objects": [{ "shape": { "mandelbulb": { "power": 8, "iterations": 16 } } }] },
        "image": { "width": 192, "height": 192, "samples": 6 } }"#;

    #[test]
    fn numbers_that_cost_time_are_found_where_they_are() {
        let job = scene::parse(BULB.as_bytes()).expect("a valid job");
        let document = serde_json::from_str(BULB).expect("JSON");
        let found = candidates(&document, &job);
        let paths: Vec<_> = found.iter().map(|found| (found.path.as_str(), found.to)).collect();
        assert_eq!(
            paths,
            [
                ("image.samples", Some(3.0)),
                ("scene.ambient_occlusion", None),
                ("scene.march.max_bounces", Some(2.0)),
                ("scene.march.max_steps", Some(150.0)),
                ("scene.objects.0.shape.mandelbulb.iterations", Some(12.0)),
            ]
        );
        for candidate in &found {
            assert!(lowered(BULB, candidate).is_some(), "{candidate:?}");
        }
    }

    #[test]
    fn half_the_rays_save_about_half_the_time() {
        let job = scene::parse(BULB.as_bytes()).expect("a valid job");
        let first = CpuRenderer::new(Some(1), worker::Simd::Auto).expect("threads");
        let savings = find(BULB, &job, &[first], Duration::from_mins(1), 1e-6, 100.0).expect("measured");
        assert_eq!(savings.len(), MAX_SAVINGS);
        let samples = savings.iter().find(|saving| saving.pointer == "/image/samples").expect("it saves most");
        assert!((0.3..0.7).contains(&samples.saves_share), "{samples:?}");
        assert!(samples.change_levels.is_some_and(|change| change > 0.1), "{samples:?}");
        assert!(savings.iter().any(|saving| saving.pointer == "/image/width"), "{savings:?}");
        assert!((samples.saves_seconds - 100.0 * samples.saves_share).abs() < 1.0, "{samples:?}");
    }
}
