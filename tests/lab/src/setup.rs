//! Measures how long a job takes to read, and an animated one to evaluate at a frame.

use std::fmt::Write as _;
use std::hint::black_box;
use std::time::Instant;

use anyhow::Context;
use clap::Args;
use scene::{Integrator, Job};
use serde::Serialize;

use crate::program::job_text;

/// Number of frames of the job.
const FRAMES: u32 = 240;
/// One in this many shapes is animated.
const ANIMATED_ONE_IN: usize = 8;
/// Number of shapes per object.
const SHAPES_PER_OBJECT: usize = 16;

/// Arguments of `setup`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Job file, or name of a shipped scene [default: a generated animated job].
    #[arg(value_name = "JOB", conflicts_with = "kib")]
    job: Option<String>,
    /// Size of the generated job, in KiB.
    #[arg(long, value_name = "KIB", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=1024))]
    kib: u32,
    /// Number of times to set up each frame.
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=1000))]
    runs: u32,
    /// Print the results as JSON.
    #[arg(long)]
    json: bool,
}

/// Measured times.
#[derive(Debug, Serialize)]
struct SetupReport {
    size_bytes: usize,
    nodes: u32,
    frames: u32,
    /// Parsing the job file and checking its frames.
    parse_us: Spread,
    /// Evaluating the job at a frame: `Job::at`.
    at_us: Spread,
    /// Preparing the renderer for the evaluated job.
    program_us: Spread,
    /// Computing the picture's cache key, including `Job::at`.
    key_us: Spread,
}

/// Distribution of the times of many runs, in microseconds.
#[derive(Debug, Serialize)]
struct Spread {
    least: f64,
    median: f64,
    percentile_95: f64,
    greatest: f64,
}

impl Spread {
    fn new(mut us: Vec<f64>) -> Self {
        us.sort_by(f64::total_cmp);
        let at = |share: f64| us[((us.len() - 1) as f64 * share) as usize];
        Self { least: at(0.0), median: at(0.5), percentile_95: at(0.95), greatest: at(1.0) }
    }

    fn line(&self, what: &str) -> String {
        let Self { least, median, percentile_95, greatest } = self;
        format!(
            "  {what:<22} median {median:.1} µs (least {least:.1}, 95 % {percentile_95:.1}, greatest {greatest:.1})"
        )
    }
}

/// Runs the measurements, and returns them as text.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<String> {
    let text = match &arguments.job {
        Some(name) => job_text(name)?,
        None => job_file(arguments.kib as usize * 1024).into_bytes(),
    };
    let parse = || scene::parse(&text).context("the measured job is invalid");
    let job = parse()?;
    let report = SetupReport {
        size_bytes: text.len(),
        nodes: job.nodes(),
        frames: job.frames.count,
        parse_us: Spread::new((0..arguments.runs).map(|_| timed(|| drop(black_box(parse())))).collect()),
        at_us: each_frame(&job, arguments.runs, |frame| drop(black_box(job.at(frame)))),
        program_us: each_frame(&job, arguments.runs, |frame| {
            if let Ok(at_frame) = job.at(frame) {
                black_box(Integrator::new(&at_frame));
            }
        }),
        key_us: each_frame(&job, arguments.runs, |frame| {
            black_box(job.cache_key(frame));
        }),
    };
    if arguments.json {
        return Ok(serde_json::to_string_pretty(&report)?);
    }
    let lines = [
        format!("a job of {} bytes and {} nodes, {} frames", report.size_bytes, report.nodes, report.frames),
        report.parse_us.line("read and checked"),
        report.at_us.line("a frame"),
        report.program_us.line("a frame, prepared"),
        report.key_us.line("a frame's cache key"),
    ];
    Ok(lines.join("\n"))
}

fn each_frame(job: &Job, runs: u32, mut set_up: impl FnMut(u32)) -> Spread {
    let frames = (0..runs).flat_map(|_| 0..job.frames.count);
    Spread::new(frames.map(|frame| timed(|| set_up(frame))).collect())
}

fn timed(work: impl FnOnce()) -> f64 {
    let start = Instant::now();
    work();
    start.elapsed().as_secs_f64() * 1e6
}

/// Generates an animated job of about this size: smooth unions of translated, rotated, and plain shapes, and an
/// animated camera.
fn job_file(size_bytes: usize) -> String {
    let mut text = format!(
        r#"{{ "name": "setup", "image": {{ "width": 1920, "height": 1080 }}, "frames": {{ "count": {FRAMES} }},
  "scene": {{
    "camera": {{ "position": [{{ "keys": [[0, -6], [5, 0], [10, 6]], "ease": "smooth" }}, 4, 12], "look_at": [0, 0, 0] }},
    "materials": {{ "clay": {{ "surface": {{ "base_color": [0.6, 0.4, 0.3] }} }}, "steel": {{ "surface": {{ "metallic": 1 }} }} }},
    "objects": ["#
    );
    let mut shapes = 0;
    while text.len() < size_bytes {
        let material = if (shapes / SHAPES_PER_OBJECT).is_multiple_of(2) { "clay" } else { "steel" };
        let separator = if shapes == 0 { "" } else { "," };
        write!(
            text,
            r#"{separator}
      {{ "material": "{material}", "shape": {{ "union": {{ "smooth": 0.05, "of": ["#
        )
        .expect("a String takes all that is written");
        for index in 0..SHAPES_PER_OBJECT {
            let separator = if index == 0 { "" } else { "," };
            write!(text, "{separator}\n        {}", shape(shapes)).expect("a String takes all that is written");
            shapes += 1;
        }
        text.push_str("] } } }");
    }
    text.push_str("] } }\n");
    text
}

fn shape(number: usize) -> String {
    let (x, z) = ((number % 23) as f32 * 0.5 - 5.5, (number / 23) as f32 * 0.5 - 5.5);
    let y = if number.is_multiple_of(ANIMATED_ONE_IN) {
        format!(r#"{{ "keys": [[0, 0], [2.5, {}], [10, 0.5]] }}"#, (number % 5) as f32 * 0.25)
    } else {
        format!("{}", (number % 7) as f32 * 0.125)
    };
    let child = match number % 3 {
        0 => r#"{ "sphere": { "radius": 0.2 } }"#,
        1 => {
            r#"{ "rotate": { "degrees": [15, 30, 0], "child": { "box": { "size": [0.3, 0.2, 0.3], "round": 0.02 } } } }"#
        }
        _ => r#"{ "cylinder": { "radius": 0.15, "height": 0.4 } }"#,
    };
    format!(r#"{{ "translate": {{ "by": [{x}, {y}, {z}], "child": {child} }} }}"#)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn measured_job_has_the_requested_size_and_is_animated() {
        for kib in [1, 30] {
            let text = job_file(kib * 1024);
            assert!(text.len() >= kib * 1024 && text.len() < (kib + 2) * 1024, "{}", text.len());
            let job = scene::parse(text.as_bytes()).expect("a valid job");
            assert!(job.is_animated() && job.at(FRAMES - 1).is_ok());
        }
    }
}
