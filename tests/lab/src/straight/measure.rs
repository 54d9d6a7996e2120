//! Measures distances beside straight C++, job by job and level by level.

use std::time::Duration;

use anyhow::Context;
use clap::Args;
use scene::Job;
use serde::Serialize;
use worker::bench::{DistanceBench, ROUNDS, Spread, record_distance};
use worker::{RenderError, Simd};

use super::{Straight, StraightError, StraightReport};
use crate::program::job_text;

/// Arguments of `straight`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Job files, or names of shipped scenes.
    #[arg(value_name = "JOB", default_values = ["csg", "five-spheres"])]
    jobs: Vec<String>,
    /// Vector instructions to measure; those that this CPU lacks are skipped.
    #[arg(long, value_name = "LEVEL", value_delimiter = ',', default_value = "avx512,avx2")]
    simd: Vec<Simd>,
    /// Seconds to measure each distance at each level.
    #[arg(long, value_name = "SECONDS", default_value_t = 2, value_parser = clap::value_parser!(u64).range(1..=60))]
    seconds: u64,
    /// Print the results as JSON.
    #[arg(long)]
    json: bool,
}

/// Rates of a job's distance at a level.
#[derive(Debug, Serialize)]
pub(super) struct Row {
    job: String,
    simd: &'static str,
    /// Distances of the whole scene a second, on one thread.
    pub(super) points_per_second: Spread,
    /// Straight C++ of the same distance, if it was measured.
    pub(super) straight: Option<StraightReport>,
    /// Why it was not.
    pub(super) straight_error: Option<StraightError>,
}

/// Runs the measurements, and returns them as text.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<String> {
    let mut rows = Vec::new();
    for name in &arguments.jobs {
        let job = scene::parse(&job_text(name)?).with_context(|| format!("could not read {name}"))?;
        for &simd in &arguments.simd {
            match measure(&job, simd, Duration::from_secs(arguments.seconds)) {
                Ok(row) => rows.push(row),
                Err(error @ RenderError::Unavailable { .. }) => eprintln!("skipped: {error}"),
                Err(error) => return Err(error.into()),
            }
        }
    }
    if arguments.json { Ok(serde_json::to_string_pretty(&rows)?) } else { Ok(table(&rows)) }
}

/// Evaluates a job's distance at points for about `time`, in turns with straight C++ of it, which takes as much again.
pub(super) fn measure(job: &Job, simd: Simd, time: Duration) -> Result<Row, RenderError> {
    let (at_frame, simd) = (job.at(0)?, simd.resolve_auto());
    let mut evaluator = DistanceBench::new(&at_frame, simd)?;
    let distances = evaluator.distances();
    let built = Straight::build(&record_distance(&at_frame), simd, evaluator.points(), &distances);
    let (mut straight, mut straight_error) = match built {
        Ok(program) => (Some(program), None),
        Err(error) => (None, Some(error)),
    };
    let (mut rates, mut straight_rates) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        rates.push(evaluator.points_per_second(time / ROUNDS));
        match straight.as_mut().map(|program| program.points_per_second(time / ROUNDS)) {
            None => {}
            Some(Ok(rate)) => straight_rates.push(rate),
            Some(Err(error)) => (straight, straight_error) = (None, Some(error)),
        }
    }
    let straight = straight.map(|program| program.report(&rates, &straight_rates));
    let points_per_second = Spread::new(rates);
    Ok(Row { job: job.name.clone(), simd: simd.name(), points_per_second, straight, straight_error })
}

fn table(rows: &[Row]) -> String {
    let mut lines = vec![
        "distances without marching, one thread".to_owned(),
        format!(
            "{:<20} {:<8} {:>10} {:>13} {:>12} {:>7} {:>11}",
            "job", "simd", "M points/s", "range", "straight C++", "ratio", "range"
        ),
    ];
    for Row { job, simd, points_per_second, straight, straight_error } in rows {
        let Spread { least, median, greatest } = *points_per_second;
        let range = format!("{:.0}–{:.0}", least / 1e6, greatest / 1e6);
        let beside = straight.as_ref().map_or_else(String::new, |straight| {
            let Spread { least, median, greatest } = straight.ratio;
            let range = format!("{least:.2}–{greatest:.2}");
            format!(" {:>12.1} {median:>7.2} {range:>11}", straight.points_per_second / 1e6)
        });
        lines.push(format!("{job:<20} {simd:<8} {:>10.1} {range:>13}{beside}", median / 1e6));
        if let Some(error) = straight_error {
            eprintln!("{job} with {simd}: {error}");
        }
    }
    lines.join("\n")
}
