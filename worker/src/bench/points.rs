//! Distances of a scene at points, without marching, on one thread.

use std::time::{Duration, Instant};

use scene::real::vec3;
use scene::{Integrator, Job, JobAtFrame};
use serde::Serialize;
use tape::Evaluator;

use super::Spread;
use super::record_distance;
use crate::picture_tape::DISTANCE;
use crate::{CancelFlag, RenderError, Simd};

/// Number of points that fit into the L1 cache together, a multiple of all lanes.
pub const POINTS: usize = 1024;
/// Number of times that a rate is measured.
pub const ROUNDS: u32 = 10;

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
}

/// Evaluates the scene's distance at points around the camera's target, for about `time`, on one thread.
pub fn points(job: &Job, simd: Simd, time: Duration) -> Result<PointsReport, RenderError> {
    let (at_frame, simd) = (job.at(0)?, simd.resolve_auto());
    let mut bench = DistanceBench::new(&at_frame, simd)?;
    let Spread { least, median, greatest } =
        Spread::new((0..ROUNDS).map(|_| bench.points_per_second(time / ROUNDS)).collect());
    Ok(PointsReport {
        job: job.name.clone(),
        simd: simd.name(),
        points_per_second: median,
        least_points_per_second: least,
        greatest_points_per_second: greatest,
    })
}

/// Evaluates a scene's distance at points around the camera's target, on one thread.
pub struct DistanceBench<'a> {
    points: Aligned,
    distances: Aligned,
    evaluate: Evaluation<'a>,
}

impl<'a> DistanceBench<'a> {
    /// Prepares the distance for these instructions.
    pub fn new(at_frame: &'a JobAtFrame<'_>, simd: Simd) -> Result<Self, RenderError> {
        let (points, distances) = (Aligned::new(&points_around(at_frame)), Aligned::new(&[0.0; POINTS]));
        Ok(Self { points, distances, evaluate: evaluation(at_frame, simd)? })
    }

    /// The [`POINTS`] points: a row of each coordinate.
    pub fn points(&self) -> &[f32] {
        self.points.numbers()
    }

    /// Evaluates each point once.
    pub fn distances(&mut self) -> Vec<f32> {
        (self.evaluate)(self.points.numbers(), self.distances.numbers_mut());
        self.distances.numbers().to_vec()
    }

    /// Evaluates the points again and again, for about this time.
    pub fn points_per_second(&mut self, time: Duration) -> f64 {
        const CALLS: usize = 64;
        let (mut done, start) = (0, Instant::now());
        loop {
            for _ in 0..CALLS {
                (self.evaluate)(self.points.numbers(), self.distances.numbers_mut());
                std::hint::black_box(self.distances.numbers());
            }
            done += CALLS * POINTS;
            let elapsed = start.elapsed();
            if elapsed >= time {
                return done as f64 / elapsed.as_secs_f64();
            }
        }
    }
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

    fn numbers(&self) -> &[f32] {
        &self.numbers[self.first..self.first + self.numbers.len() - Self::LINE]
    }

    fn numbers_mut(&mut self) -> &mut [f32] {
        let end = self.first + self.numbers.len() - Self::LINE;
        &mut self.numbers[self.first..end]
    }
}

/// [`POINTS`] points around the camera's target: a row of each coordinate.
fn points_around(at_frame: &JobAtFrame<'_>) -> Vec<f32> {
    let middle = at_frame.scene().camera.target();
    let spread = |index: usize, step: u32| (index as u32).wrapping_mul(step) as f32 / u32::MAX as f32 * 4.0 - 2.0;
    let axis = |middle: f32, step: u32| (0..POINTS).map(move |index| middle + spread(index, step));
    let x = axis(middle.x, 0x9e37_79b9);
    x.chain(axis(middle.y, 0xc13f_a9a9)).chain(axis(middle.z, 0x91e1_0da5)).collect()
}

/// Writes the distances of [`POINTS`] points.
type Evaluation<'a> = Box<dyn FnMut(&[f32], &mut [f32]) + 'a>;

fn evaluation<'a>(at_frame: &'a JobAtFrame<'_>, simd: Simd) -> Result<Evaluation<'a>, RenderError> {
    if simd == Simd::Scalar {
        let program = Integrator::new(at_frame);
        return Ok(Box::new(move |points, distances| {
            for (index, distance) in distances.iter_mut().enumerate() {
                *distance = program.distance(vec3(points[index], points[POINTS + index], points[2 * POINTS + index]));
            }
        }));
    }
    let tape = record_distance(at_frame);
    let evaluator = Evaluator::new(&tape, simd)?;
    let (inputs, cancel, mut frame) = (evaluator.inputs(&tape), CancelFlag::new(), evaluator.frame());
    Ok(Box::new(move |points, distances| {
        evaluator.run(DISTANCE, &mut frame, &inputs, cancel.flag(), points, distances);
    }))
}
