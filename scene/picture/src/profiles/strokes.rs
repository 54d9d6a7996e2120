//! Profiles that are a thick line with round ends.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::bezier::{HalfParabola, QuadraticBezier};
use super::{Bounds2, Point2, ProfileSdf};
use crate::kinds::Exactness;
use crate::real::Real;
use crate::seek::Seek;
use crate::values::{Length, SweepAngle, sin_cos_degrees};

/// A part of a ring around the origin with round ends, its center at the top.
///
/// Inigo Quilez, "2D distance functions": <https://iquilezles.org/articles/distfunctions2d/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Arc {
    /// Radius of the line's center.
    pub radius: Length,
    /// Angle between its ends at the origin.
    pub degrees: SweepAngle,
    /// Thickness.
    pub thickness: Length,
}

impl ProfileSdf for Arc {
    const EXAMPLE: &str = r#"{ "radius": 0.8, "degrees": 250, "thickness": 0.4 }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "radius": 1, "degrees": 60, "thickness": 0.3 }"#,
        r#"{ "radius": 0.8, "degrees": 340, "thickness": 0.5 }"#,
        r#"{ "radius": 0.7, "degrees": 360, "thickness": 0.2 }"#,
    ];

    fn is_symmetric(&self) -> bool {
        true
    }

    fn distance<R: Real>(&self, x: R, y: R) -> R {
        let (s, c) = sin_cos_degrees(self.degrees.in_frame() / 2.0);
        let radius = self.radius.get();
        let across = x.abs();
        let (from_end_x, from_end_y) = (across - x.uniform(s * radius), y - x.uniform(c * radius));
        let from_end = from_end_x.square_add(from_end_y.square()).sqrt();
        let from_ring = (across.square_add(y.square()).sqrt() - x.uniform(radius)).abs();
        let is_past_end = (y * x.uniform(s)).lt(across * x.uniform(c));
        R::select(is_past_end, from_end, from_ring) - x.uniform(self.thickness.get() / 2.0)
    }

    fn extent(&self, isolevel: f32) -> Bounds2 {
        let (s, c) = sin_cos_degrees(self.degrees.in_frame() / 2.0);
        let radius = self.radius.in_frame();
        let across = if c < 0.0 { radius } else { radius * s };
        Bounds2 { low: [-across, radius * c], high: [across, radius] }
            .widened(self.thickness.in_frame() / 2.0 + isolevel)
    }

    fn exactness(&self) -> Exactness {
        // Inside, the distance to the outline follows from the distance to the center line, unless the line's ends, or
        // both sides of its circle, are closer to each other than the thickness.
        let (s, c) = sin_cos_degrees(self.degrees.in_frame() / 2.0);
        let (radius, half) = (self.radius.in_frame(), self.thickness.in_frame() / 2.0);
        let is_closed = s == 0.0;
        if half <= radius && (c >= 0.0 || is_closed || radius * s >= half) {
            Exactness::Exact
        } else {
            Exactness::Bound
        }
    }
}

/// A curve between two points, controlled by a third, with round ends: a quadratic Bézier curve.
///
/// The distance is the lesser of the distances to the two halves of its parabola, each by Newton's method from the end
/// at which it cannot overshoot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Bezier {
    /// Its start, its control point, and its end.
    pub points: [Point2; 3],
    /// Thickness.
    pub thickness: Length,
}

impl Bezier {
    fn curve(&self) -> QuadraticBezier {
        let [from, control, to] = self.points.each_ref().map(Point2::in_frame);
        QuadraticBezier { from, control, to }
    }
}

impl ProfileSdf for Bezier {
    const EXAMPLE: &str = r#"{ "points": [[-0.9, -0.7], [0, 1.8], [0.9, -0.7]], "thickness": 0.3 }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "points": [[-1, -0.4], [-0.4, 0.9], [1, 0.5]], "thickness": 0.2 }"#,
        r#"{ "points": [[-0.9, -0.5], [0, 0], [0.9, 0.5]], "thickness": 0.4 }"#,
        r#"{ "points": [[-0.3, -0.8], [0.1, 2.4], [0.3, -0.6]], "thickness": 0.5 }"#,
    ];

    fn distance<R: Real>(&self, x: R, y: R) -> R {
        let curve = self.curve();
        let [first, second] = curve.split(curve.vertex()).map(HalfParabola::new);
        // A squared distance greater than any, but finite.
        let nearest = second.min_distance_squared(x, y, first.min_distance_squared(x, y, x.constant(1e30)));
        nearest.sqrt() - x.uniform(self.thickness.get() / 2.0)
    }

    fn extent(&self, isolevel: f32) -> Bounds2 {
        self.curve().extent().widened(self.thickness.in_frame() / 2.0 + isolevel)
    }

    fn exactness(&self) -> Exactness {
        // Inside, the distance to the outline follows from the distance to the curve, if no circle with the thickness
        // as its diameter touches the curve twice. A parabola turns by less than 180 degrees, so no circle does unless
        // it is larger than the smallest circle of curvature.
        let is_slack = self.thickness.in_frame() / 2.0 <= self.curve().least_radius();
        if is_slack { Exactness::Exact } else { Exactness::Bound }
    }

    fn size_in_nodes(&self) -> u32 {
        2
    }
}
