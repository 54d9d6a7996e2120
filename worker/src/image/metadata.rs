//! Standard attributes of an EXR: its camera's matrices, and its frame rate.
//!
//! A picture's cache key covers all of them: the camera as a part of the scene, the frame rate separately.

use scene::camera::Matrix;
use scene::{ImageSpec, JobAtFrame};

/// OpenEXR's standard attributes about the camera and the time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Metadata {
    /// Matrix from the scene to the camera's axes.
    pub world_to_camera: Matrix,
    /// Matrix from the scene to the picture, from (0, 0) at its top left to (1, 1); `None` for a panorama.
    pub world_to_ndc: Option<Matrix>,
    /// Frames a second, as a fraction.
    pub frames_per_second: (i32, u32),
}

impl Metadata {
    /// Attributes of a job at a frame.
    pub fn new(at_frame: &JobAtFrame<'_>) -> Self {
        let image = at_frame.image();
        let view = at_frame.scene().camera.view(image.width, image.height);
        Self {
            world_to_camera: view.world_to_camera(),
            world_to_ndc: view.world_to_ndc().map(|matrix| in_region(&matrix, image)),
            frames_per_second: fraction(at_frame.frames().fps.get()),
        }
    }
}

/// A matrix to the whole picture as one to its region: the first two columns are scaled and moved.
fn in_region(matrix: &Matrix, image: &ImageSpec) -> Matrix {
    let Some(region) = image.region else { return *matrix };
    let axes = [(image.width, region.x, region.width), (image.height, region.y, region.height)];
    let mut moved = *matrix;
    for row in moved.chunks_exact_mut(4) {
        for (axis, (full, start, length)) in axes.into_iter().enumerate() {
            let [full, start, length] = [full, start, length].map(|pixels| pixels as f32);
            row[axis] = (row[axis] * full - row[3] * start) / length;
        }
    }
    moved
}

/// Fraction that equals this number from 0.001 to 1000, to the precision of an `f32`: an integer over 1.001, as
/// in the rates of NTSC, or otherwise the simplest fraction.
fn fraction(number: f32) -> (i32, u32) {
    let whole = (f64::from(number) * 1.001).round();
    if number.fract() != 0.0 && (whole / 1.001) as f32 == number {
        return (whole as i32 * 1000, 1001);
    }
    let half = |other: f32| 0.5 * (f64::from(number) + f64::from(other));
    let (low, high) = (half(number.next_down()), half(number.next_up()));
    // On the Stern–Brocot tree, followed by runs of steps in one direction, the first fraction between low and
    // high is the simplest: Knuth, Graham, Patashnik, "Concrete Mathematics", section 4.5.
    let (mut left, mut right) = ((0_u32, 1_u32), (1_u32, 0_u32));
    loop {
        let middle = (left.0 + right.0, left.1 + right.1);
        let value = f64::from(middle.0) / f64::from(middle.1);
        if value <= low {
            let run = steps(low, right, left);
            left = (left.0 + run * right.0, left.1 + run * right.1);
        } else if value >= high {
            let run = steps(high, left, right);
            right = (right.0 + run * left.0, right.1 + run * left.1);
        } else {
            return (i32::try_from(middle.0).unwrap_or(i32::MAX), middle.1);
        }
    }
}

/// Number of times that `by` may be added to `from` before it passes `end`; at least once.
fn steps(end: f64, by: (u32, u32), from: (u32, u32)) -> u32 {
    let [by, from] = [by, from].map(|(over, under)| (f64::from(over), f64::from(under)));
    let run = (end * from.1 - from.0) / (by.0 - end * by.1);
    (run.floor() as u32).max(1)
}

#[cfg(test)]
mod tests {
    use super::fraction;

    #[test]
    fn frame_rates_become_their_usual_fractions() {
        for (rate, wanted) in [
            (24.0, (24, 1)),
            (29.97, (2997, 100)),
            (23.976_024, (24_000, 1001)),
            (59.940_06, (60_000, 1001)),
            (12.5, (25, 2)),
            (0.001, (1, 1000)),
            (1000.0, (1000, 1)),
            (0.333_333_34, (1, 3)),
        ] {
            assert_eq!(fraction(rate), wanted, "{rate}");
        }
    }

    #[test]
    fn a_fraction_rounds_to_its_rate() {
        let (least, most) = (0.001_f32.to_bits(), 1000.0_f32.to_bits());
        for bits in (least..=most).step_by(99_991) {
            let rate = f32::from_bits(bits);
            let (over, under) = fraction(rate);
            assert_eq!((f64::from(over) / f64::from(under)) as f32, rate);
        }
    }
}
