//! Profiles with rotational symmetry: regular polygons and stars. Each is exact.
//!
//! A point is first folded into the wedge between a corner and the center of a side, by one reflection for each time
//! that the number of wedges can be halved. No angle is computed.

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};

use super::{Bounds2, ProfileSdf};
use crate::kinds::NodeError;
use crate::real::Real;
use crate::seek::Seek;
use crate::values::{Length, LengthOrZero, integer_in_range};

/// Maximum number of sides of a regular polygon and of points of a star.
const MAX_SIDES: u32 = 64;

/// A polygon of equal sides around the origin, a corner at the top.
///
/// The distance in the folded wedge is that to one side and its end.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct RegularPolygon {
    /// Number of sides.
    #[serde(deserialize_with = "sides")]
    #[schemars(range(min = 3, max = MAX_SIDES))]
    pub sides: u32,
    /// Radius of the circle through its corners.
    pub radius: Length,
    /// Radius of its rounded corners, inside the sharp polygon.
    #[serde(default = "super::default_round")]
    pub round: LengthOrZero,
}

/// A star around the origin, a point at the top.
///
/// The distance in the folded wedge is that to one edge.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Star {
    /// Number of points.
    #[serde(deserialize_with = "star_points")]
    #[schemars(range(min = 3, max = MAX_SIDES))]
    pub points: u32,
    /// Distance of the points from the origin.
    pub outer: Length,
    /// Distance of the notches from the origin.
    pub inner: Length,
}

/// Sine and cosine of π/n.
fn half_sector_sin_cos(n: u32) -> (f32, f32) {
    Real::sin_cos(std::f32::consts::PI / n as f32)
}

/// Folds (`x`, `y`) into the wedge of π/n clockwise from the top: up along the corner and across from it.
fn fold<R: Real>(x: R, y: R, n: u32) -> (R, R) {
    let (mut up, mut across) = (y, x.abs());
    let mut wedges = n;
    while wedges > 1 {
        // Points beyond half of the wedges, rounded up, are reflected about their end.
        wedges = wedges.div_ceil(2);
        let (s, c) = Real::sin_cos(std::f32::consts::PI * wedges as f32 / n as f32);
        let beyond = up.mul_add(x.uniform(s), -(across * x.uniform(c))).at_most(0.0);
        (up, across) = (beyond.mul_add(x.uniform(-2.0 * s), up), beyond.mul_add(x.uniform(2.0 * c), across));
    }
    (up, across)
}

impl RegularPolygon {
    /// Distance from the origin to a side.
    fn apothem(&self) -> f32 {
        self.radius.in_frame() * half_sector_sin_cos(self.sides).1
    }
}

impl ProfileSdf for RegularPolygon {
    const EXAMPLE: &str = r#"{ "sides": 6, "radius": 1, "round": 0.15 }"#;
    const MORE_EXAMPLES: &'static [&'static str] =
        &[r#"{ "sides": 3, "radius": 1.1 }"#, r#"{ "sides": 13, "radius": 0.8 }"#];

    fn is_symmetric(&self) -> bool {
        true
    }

    fn distance<R: Real>(&self, x: R, y: R) -> R {
        let (s, c) = half_sector_sin_cos(self.sides);
        let apothem = self.apothem() - self.round.in_frame();
        let (up, across) = fold(x, y, self.sides);
        let past_side = up.mul_add(x.uniform(c), across.mul_add(x.uniform(s), -x.uniform(apothem)));
        // Half of a side is its apothem times the tangent of half its angle.
        let past_end =
            up.mul_add(x.uniform(s), -across.mul_add(x.uniform(c), x.uniform(apothem * (s / c)))).at_least(0.0);
        let outside = past_end.square_add(past_side.at_least(0.0).square()).sqrt();
        R::select(past_side.below(0.0), past_side, outside) - x.uniform(self.round.get())
    }

    fn extent(&self, isolevel: f32) -> Bounds2 {
        Bounds2::symmetric(self.radius.in_frame(), self.radius.in_frame()).widened(isolevel)
    }

    fn validate(&self) -> Option<NodeError> {
        let most = self.apothem();
        let message = format!("must be at most the distance from the center to a side: make round {most} or less");
        (self.round.in_frame() > most).then(|| NodeError::new("round", message))
    }
}

impl ProfileSdf for Star {
    const EXAMPLE: &str = r#"{ "points": 5, "outer": 1.1, "inner": 0.5 }"#;
    const MORE_EXAMPLES: &'static [&'static str] =
        &[r#"{ "points": 12, "outer": 1, "inner": 0.8 }"#, r#"{ "points": 4, "outer": 0.5, "inner": 1 }"#];

    fn is_symmetric(&self) -> bool {
        true
    }

    fn distance<R: Real>(&self, x: R, y: R) -> R {
        let (s, c) = half_sector_sin_cos(self.points);
        let (outer, inner) = (self.outer.in_frame(), self.inner.in_frame());
        // The edge from the point down to the notch.
        let (edge_up, edge_across) = (inner * c - outer, inner * s);
        let over_square = 1.0 / (edge_up * edge_up + edge_across * edge_across);
        let (up, across) = fold(x, y, self.points);
        let up = up - x.uniform(outer);
        let along = up.mul_add(x.uniform(edge_up * over_square), across * x.uniform(edge_across * over_square));
        let share = along.at_least(0.0).at_most(1.0);
        let (off_up, off_across) =
            (share.mul_add(x.uniform(-edge_up), up), share.mul_add(x.uniform(-edge_across), across));
        let distance = off_up.square_add(off_across.square()).sqrt();
        let outward = up.mul_add(x.uniform(edge_across), -(across * x.uniform(edge_up)));
        R::select(outward.below(0.0), -distance, distance)
    }

    fn extent(&self, isolevel: f32) -> Bounds2 {
        let radius = self.outer.in_frame().max(self.inner.in_frame());
        Bounds2::symmetric(radius, radius).widened(isolevel)
    }
}

fn sides<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    integer_in_range(deserializer, 3, MAX_SIDES, "sides")
}

fn star_points<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    integer_in_range(deserializer, 3, MAX_SIDES, "points")
}
