//! Benchmarks this machine: distances of a scene without marching, complete frames, and compiling scenes.

mod compile;
mod frames;
mod gpu;
mod points;

use scene::JobAtFrame;
use serde::Serialize;
use tape::Tape;

use crate::cells::FastBuilder;
use crate::picture_tape;

pub use crate::picture_tape::DISTANCE;
pub use compile::{BackEndReport, CompileReport, compile};
pub use frames::{RenderReport, frames, render};
pub use gpu::{GpuReport, render_on_gpu};
pub use points::{DistanceBench, POINTS, PointsReport, ROUNDS, points};

/// Records the scene's distance at a point, as the entry [`DISTANCE`].
pub fn record_distance(at_frame: &JobAtFrame<'_>) -> Tape {
    picture_tape::record_distance(at_frame, &FastBuilder::UNLIMITED)
}

/// Median and range of a figure measured several times.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Spread {
    /// The least.
    pub least: f64,
    /// The median.
    pub median: f64,
    /// The greatest.
    pub greatest: f64,
}

impl Spread {
    /// Of at least one figure.
    pub fn new(mut figures: Vec<f64>) -> Self {
        figures.sort_by(f64::total_cmp);
        let middle = figures.len() / 2;
        let median = if figures.len().is_multiple_of(2) {
            f64::midpoint(figures[middle - 1], figures[middle])
        } else {
            figures[middle]
        };
        Self { least: figures[0], median, greatest: figures[figures.len() - 1] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_is_between_the_middle_figures() {
        let Spread { least, median, greatest } = Spread::new(vec![4.0, 1.0, 2.0, 9.0]);
        assert_eq!([least, median, greatest], [1.0, 3.0, 9.0]);
        assert_eq!(Spread::new(vec![5.0, 1.0, 2.0]).median, 2.0);
        assert_eq!(Spread::new(vec![5.0]).median, 5.0);
    }
}
