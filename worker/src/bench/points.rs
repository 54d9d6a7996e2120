//! Distances of a scene at points, without marching, on one thread.

use std::time::{Duration, Instant};

use scene::real::vec3;
use scene::{Integrator, Job, JobAtFrame};
use serde::Serialize;

use super::Spread;
use super::straight::{Straight, StraightError, StraightReport};
use crate::cpu::Evaluator;
use crate::picture_tape::{DISTANCE, record_distance};
use crate::{CancelFlag, RenderError, Simd};

/// Number of points that fit into the L1 cache together, a multiple of all lanes.
pub(super) const POINTS: usize = 1024;
/// Number of times that a rate is measured.
const ROUNDS: u32 = 10;

/// Distances per second on one core.
#[derive(Debug, Serialize)]
pub struct PointsReport {
    /// The job's name.
    pub job: String,
    /// The vector instructions.
    pub simd: &'static str,
    /// Distances of the whole scene a second, on one thread, at the median.
    pub points_per_second: f64,
    /// The same in the slowest round.
    pub least_points_per_second: f64,
    /// The same in the fastest round.
    pub greatest_points_per_second: f64,
    /// Straight C++ of the same distance, if it was measured.
    pub straight: Option<StraightReport>,
    /// Why it was requested and not measured.
    pub straight_error: Option<StraightError>,
}

/// Whether distances are measured alone, or beside straight C++.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Yardstick {
    /// Alone.
    None,
    /// In turns with straight C++ of the same distance, which takes as much time again.
    Straight,
}

/// Evaluates the scene's distance at points around the camera's target, for about `time`, on one thread.
pub fn points(job: &Job, simd: Simd, time: Duration, beside: Yardstick) -> Result<PointsReport, RenderError> {
    let (still, simd) = (job.at(0)?, simd.resolve_auto());
    let mut points = Aligned::new(&points_around(job));
    let points = &*points.slice();
    let mut evaluate = evaluation(&still, points, simd)?;
    let (mut straight, mut straight_error) = (None, None);
    if beside == Yardstick::Straight {
        let mut distances = vec![0.0; POINTS];
        evaluate(&mut distances);
        match Straight::build(&record_distance(&still), simd, points, &distances) {
            Ok(program) => straight = Some(program),
            Err(error) => straight_error = Some(error),
        }
    }
    let (mut rates, mut straight_rates) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        rates.push(points_per_second(time / ROUNDS, &mut evaluate));
        match straight.as_mut().map(|program| program.points_per_second(time / ROUNDS)) {
            None => {}
            Some(Ok(rate)) => straight_rates.push(rate),
            Some(Err(error)) => (straight, straight_error) = (None, Some(error)),
        }
    }
    let straight = straight.map(|program| program.report(&rates, &straight_rates));
    let Spread { least, median, greatest } = Spread::new(rates);
    Ok(PointsReport {
        job: job.name.clone(),
        simd: simd.name(),
        points_per_second: median,
        least_points_per_second: least,
        greatest_points_per_second: greatest,
        straight,
        straight_error,
    })
}

/// Numbers that start at a line of the cache, so that no vector crosses one.
struct Aligned {
    numbers: Vec<f32>,
    first: usize,
}

impl Aligned {
    /// Numbers in a line.
    const LINE: usize = 16;

    fn new(values: &[f32]) -> Self {
        let mut numbers = vec![0.0; values.len() + Self::LINE];
        let first = numbers.as_ptr().align_offset(Self::LINE * size_of::<f32>()).min(Self::LINE);
        numbers[first..first + values.len()].copy_from_slice(values);
        Self { numbers, first }
    }

    fn slice(&mut self) -> &mut [f32] {
        let end = self.numbers.len() - Self::LINE;
        &mut self.numbers[self.first..self.first + end]
    }
}

/// [`POINTS`] points around the camera's target: a row of each coordinate.
fn points_around(job: &Job) -> Vec<f32> {
    let middle = job.scene.camera.target();
    let spread = |index: usize, step: u32| (index as u32).wrapping_mul(step) as f32 / u32::MAX as f32 * 4.0 - 2.0;
    let axis = |middle: f32, step: u32| (0..POINTS).map(move |index| middle + spread(index, step));
    let x = axis(middle.x, 0x9e37_79b9);
    x.chain(axis(middle.y, 0xc13f_a9a9)).chain(axis(middle.z, 0x91e1_0da5)).collect()
}

/// Writes the distances of [`POINTS`] points.
type Evaluation<'a> = Box<dyn FnMut(&mut [f32]) + 'a>;

/// Evaluation of these points.
fn evaluation<'a>(still: &'a JobAtFrame<'_>, points: &'a [f32], simd: Simd) -> Result<Evaluation<'a>, RenderError> {
    if simd == Simd::Scalar {
        let program = Integrator::new(still);
        return Ok(Box::new(move |distances| {
            for (index, distance) in distances.iter_mut().enumerate() {
                *distance = program.distance(vec3(points[index], points[POINTS + index], points[2 * POINTS + index]));
            }
        }));
    }
    let tape = record_distance(still);
    let evaluator = Evaluator::new(&tape, simd)?;
    let (inputs, cancel, mut frame) = (evaluator.inputs(&tape), CancelFlag::new(), evaluator.frame());
    Ok(Box::new(move |distances| {
        evaluator.run(DISTANCE, &mut frame, &inputs, cancel.flag(), points, distances);
    }))
}

/// Calls `evaluate`, which writes [`POINTS`] distances, for about this time.
fn points_per_second(time: Duration, evaluate: &mut dyn FnMut(&mut [f32])) -> f64 {
    const CALLS: usize = 64;
    let mut distances = Aligned::new(&[0.0; POINTS]);
    let distances = distances.slice();
    let (mut done, start) = (0, Instant::now());
    loop {
        for _ in 0..CALLS {
            evaluate(distances);
            std::hint::black_box(&*distances);
        }
        done += CALLS * POINTS;
        let elapsed = start.elapsed();
        if elapsed >= time {
            return done as f64 / elapsed.as_secs_f64();
        }
    }
}
