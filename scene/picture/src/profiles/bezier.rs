//! Quadratic Bézier curves: segments of parabolas.
//!
//! If the parabola's vertex is not inside a segment, the squared distance to a point of it has a convex derivative (a
//! cubic in the parameter), so Newton's method from the far end converges to its largest root without overshoot, and
//! no cubic needs to be solved. The only other candidate for the nearest point is the segment's start.

use super::Bounds2;
use super::edge::{EdgeScan, is_crossed};
use crate::real::{FunctionKey, Real};

/// Maximum deviation at which a curve is replaced by a straight line, as a fraction of a font's size.
const FLATNESS_TOLERANCE: f32 = 1e-5;

/// A quadratic Bézier curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct QuadraticBezier {
    pub(super) from: [f32; 2],
    pub(super) control: [f32; 2],
    pub(super) to: [f32; 2],
}

/// A segment of a parabola on one side of its vertex, which may be its start: start + 2·a·t + b·t² for t from 0 to 1,
/// with a·b at least 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct HalfParabola {
    start: [f32; 2],
    end: [f32; 2],
    a: [f32; 2],
    b: [f32; 2],
    /// One over the cross product of 2·a and b, for a segment of an outline.
    over_turn: f32,
}

fn dot(a: [f32; 2], b: [f32; 2]) -> f32 {
    a[0] * b[0] + a[1] * b[1]
}

fn cross(a: [f32; 2], b: [f32; 2]) -> f32 {
    a[0] * b[1] - a[1] * b[0]
}

fn mix(a: [f32; 2], b: [f32; 2], t: f32) -> [f32; 2] {
    [a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t]
}

impl QuadraticBezier {
    /// Half of its derivative at the start, and half of its second derivative.
    fn derivatives(&self) -> ([f32; 2], [f32; 2]) {
        let axis = |axis: usize| {
            let (a, last) = (self.control[axis] - self.from[axis], self.to[axis] - self.control[axis]);
            (a, last - a)
        };
        let ((a_x, b_x), (a_y, b_y)) = (axis(0), axis(1));
        ([a_x, a_y], [b_x, b_y])
    }

    /// Parameter of the parabola's vertex, or of the nearest end.
    pub(super) fn vertex(&self) -> f32 {
        let (a, b) = self.derivatives();
        (-dot(a, b) / dot(b, b).max(1e-30)).clamp(0.0, 1.0)
    }

    /// Parameter, from 0 to 1, at which its tangent is parallel to the x axis (1) or y axis (0).
    pub(super) fn extreme(&self, axis: usize) -> f32 {
        let (a, b) = self.derivatives();
        let divisor = if b[axis].abs() < 1e-20 { 1e-20 } else { b[axis] };
        (-a[axis] / divisor).clamp(0.0, 1.0)
    }

    fn at(&self, t: f32) -> [f32; 2] {
        mix(mix(self.from, self.control, t), mix(self.control, self.to, t), t)
    }

    /// Its two parts, before and after a parameter.
    pub(super) fn split(&self, t: f32) -> [Self; 2] {
        let middle = self.at(t);
        [
            Self { from: self.from, control: mix(self.from, self.control, t), to: middle },
            Self { from: middle, control: mix(self.control, self.to, t), to: self.to },
        ]
    }

    /// Smallest rectangle that contains it.
    pub(super) fn extent(&self) -> Bounds2 {
        Bounds2::from_points([self.from, self.to, self.at(self.extreme(0)), self.at(self.extreme(1))])
    }

    /// Whether its deviation from the line between its ends is too small to be visible.
    pub(super) fn is_straight(&self) -> bool {
        let (a, b) = self.derivatives();
        let chord = [self.to[0] - self.from[0], self.to[1] - self.from[1]];
        // Its deviation is half of the height of the triangle of its points.
        cross(a, b).abs() <= 2.0 * FLATNESS_TOLERANCE * Real::sqrt(dot(chord, chord))
    }

    /// Minimum radius of curvature; infinite if it is straight.
    pub(super) fn least_radius(&self) -> f32 {
        let ((a, b), t) = (self.derivatives(), self.vertex());
        let speed = [a[0] + b[0] * t, a[1] + b[1] * t];
        let turn = cross(a, b).abs();
        let square = dot(speed, speed);
        if turn == 0.0 { f32::INFINITY } else { 2.0 * square * Real::sqrt(square) / turn }
    }
}

impl HalfParabola {
    /// The end nearest to the parabola's vertex.
    pub(super) fn start(&self) -> [f32; 2] {
        self.start
    }

    /// Smallest rectangle that contains it.
    pub(super) fn extent(&self) -> Bounds2 {
        let control = [self.start[0] + self.a[0], self.start[1] + self.a[1]];
        QuadraticBezier { from: self.start, control, to: self.end }.extent()
    }

    /// A curve whose vertex is at or before its start, or at or after its end.
    pub(super) fn new(curve: QuadraticBezier) -> Self {
        let (a, b) = curve.derivatives();
        let reversed = QuadraticBezier { from: curve.to, control: curve.control, to: curve.from };
        // Its speed is least at the vertex.
        let curve = if 2.0 * dot(a, b) + dot(b, b) < 0.0 { reversed } else { curve };
        let (a, b) = curve.derivatives();
        let turn = 2.0 * cross(a, b);
        Self { start: curve.from, end: curve.to, a, b, over_turn: if turn == 0.0 { 0.0 } else { 1.0 / turn } }
    }

    /// Squared distance to the nearer of the nearest segment so far and this one.
    pub(super) fn min_distance_squared<R: Real>(&self, x: R, y: R, nearest: R) -> R {
        let Self { start, a, b, .. } = *self;
        x.call(
            FunctionKey::new("half_parabola"),
            (
                (x - x.uniform(start[0]), y - x.uniform(start[1])),
                (x.uniform(a[0]), x.uniform(a[1])),
                (x.uniform(b[0]), x.uniform(b[1])),
                nearest,
            ),
            |(off, a, b, nearest)| nearest.min(square(off, a, b)),
        )
    }

    /// Adds this segment of an outline, which is monotonic in y, to a scan.
    ///
    /// The side of the curve on which a point is follows from its position in the frame of 2·a and b, in which the
    /// curve is (t, t²): Charles Loop and Jim Blinn, "Resolution Independent Curve Rendering using Programmable
    /// Graphics Hardware", <https://doi.org/10.1145/1073204.1073303>.
    pub(super) fn pass<R: Real>(&self, x: R, y: R, found: EdgeScan<R>) -> EdgeScan<R> {
        let Self { start, end, a, b, over_turn } = *self;
        x.call(
            FunctionKey::new("outline_curve"),
            (
                (x, y),
                found,
                (x.uniform(start[0]), x.uniform(start[1])),
                (x.uniform(a[0]), x.uniform(a[1])),
                (x.uniform(b[0]), x.uniform(b[1])),
                (x.uniform(over_turn), x.uniform(end[1])),
            ),
            |((x, y), (nearest, sign), (start_x, start_y), (a_x, a_y), (b_x, b_y), (over_turn, end_y))| {
                let off = (x - start_x, y - start_y);
                let square = square(off, (a_x, a_y), (b_x, b_y));
                let along = (off.0 * b_y - off.1 * b_x) * over_turn;
                let up = (a_x * off.1 - a_y * off.0) * over_turn * 2.0;
                // Distance from the chord where that is greater than the distance from the curve.
                let off_curve = (up - along.min(along.square())) * over_turn;
                let is_crossed = is_crossed(y, start_y, end_y, off_curve.above(0.0));
                (nearest.min(square), R::select(is_crossed, -sign, sign))
            },
        )
    }
}

fn product<R: Real>(p: (R, R), q: (R, R)) -> R {
    p.0.mul_add(q.0, p.1 * q.1)
}

/// Squared distance from a point, relative to the start, to the segment 2·a·t + b·t².
fn square<R: Real>(off: (R, R), a: (R, R), b: (R, R)) -> R {
    // After six steps the distance is accurate to 4·10⁻⁶ of the segment's length, as measured on random
    // segments.
    const STEPS: usize = 6;
    let cubic = product(b, b);
    let squared = product(a, b) * 3.0;
    let linear = product(a, a) * 2.0 - product(off, b);
    let constant = -product(off, a);
    let mut t = off.0.constant(1.0);
    for _ in 0..STEPS {
        let value = t.mul_add(t.mul_add(t.mul_add(cubic, squared), linear), constant);
        let slope = t.mul_add(t.mul_add(cubic * 3.0, squared * 2.0), linear);
        t = (t - value.at_least(0.0) / slope.at_least(1e-20)).at_least(0.0);
    }
    let (to_x, to_y) = (t.mul_add(t.mul_add(b.0, a.0 * 2.0), -off.0), t.mul_add(t.mul_add(b.1, a.1 * 2.0), -off.1));
    to_x.square_add(to_y.square()).min(off.0.square_add(off.1.square()))
}
