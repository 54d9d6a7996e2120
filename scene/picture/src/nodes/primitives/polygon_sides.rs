//! Number of sides of a regular polygon, and the mirrors between them.

use std::borrow::Cow;
use std::f32::consts::PI;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::real::Real;
use crate::seek::{FrameTime, Seek, SeekError};
use crate::values::integer_in_range;

/// Maximum number of sides; a polygon with more looks like a circle, which is cheaper.
const MAX_SIDES: u32 = 64;

/// The number of sides of a regular polygon, 3 to 64.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PolygonSides {
    count: u32,
    /// Sine and cosine of half of a side's angle.
    half_side: (f32, f32),
    /// Sine and cosine of the angle of each mirror, from the center of a side; the first `mirrors_used` are used.
    fold_angles: [(f32, f32); 6],
    mirrors_used: usize,
}

impl PolygonSides {
    /// Sides of a hexagon.
    pub(super) const HEXAGON: Self = Self {
        count: 6,
        half_side: (0.5, 0.866_025_4),
        fold_angles: [(0.866_025_4, 0.5), (0.5, 0.866_025_4), (0.0, 1.0), (0.0, 1.0), (0.0, 1.0), (0.0, 1.0)],
        mirrors_used: 2,
    };

    /// Sides of an octagon.
    pub(super) const OCTAGON: Self = Self {
        count: 8,
        half_side: (0.382_683_43, 0.923_879_5),
        fold_angles: [
            (std::f32::consts::FRAC_1_SQRT_2, std::f32::consts::FRAC_1_SQRT_2),
            (0.382_683_43, 0.923_879_5),
            (0.0, 1.0),
            (0.0, 1.0),
            (0.0, 1.0),
            (0.0, 1.0),
        ],
        mirrors_used: 2,
    };

    /// A polygon with this number of sides; `None` if it is out of range.
    pub fn new(count: u32) -> Option<Self> {
        if !(3..=MAX_SIDES).contains(&count) {
            return None;
        }
        let sin_cos_of = |wedges: u32| Real::sin_cos(PI * wedges as f32 / count as f32);
        let mut sides = Self { count, half_side: sin_cos_of(1), fold_angles: [(0.0, 1.0); 6], mirrors_used: 0 };
        // Each mirror halves the number of remaining wedges while it is even.
        let mut wedges = if sides.is_even() { count / 2 } else { count };
        while wedges > 1 {
            wedges = wedges.div_ceil(2);
            sides.fold_angles[sides.mirrors_used] = sin_cos_of(wedges);
            sides.mirrors_used += 1;
        }
        Some(sides)
    }

    /// Number of sides.
    pub fn get(self) -> u32 {
        self.count
    }

    fn is_even(&self) -> bool {
        self.count.is_multiple_of(2)
    }

    /// Distance of the edges from the center of a polygon, and half their length, for this circumradius.
    pub(super) fn inradius_and_half_edge(&self, radius: f32) -> (f32, f32) {
        (radius * self.half_side.1, radius * self.half_side.0)
    }

    /// Folds the plane of x and z into the wedge from the +z axis to half a side's angle from it. Returns the point's
    /// position along the edge and its distance outward.
    pub(super) fn fold<R: Real>(&self, x: R, z: R) -> (R, R) {
        let (mut along, mut out) = (x.abs(), if self.is_even() { z.abs() } else { z });
        for &(sine, cosine) in &self.fold_angles[..self.mirrors_used] {
            let twice_behind = along.mul_add(x.constant(2.0 * cosine), out * (-2.0 * sine)).at_least(0.0);
            along = twice_behind.mul_add(x.constant(-cosine), along);
            out = twice_behind.mul_add(x.constant(sine), out);
        }
        (along, out)
    }
}

impl Seek for PolygonSides {
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        // The other fields follow from the count.
        let Self { count, half_side: _, fold_angles: _, mirrors_used: _ } = self;
        count.seek(clock)
    }
}

impl<'de> Deserialize<'de> for PolygonSides {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let count = integer_in_range(deserializer, 3, MAX_SIDES, "sides")?;
        Self::new(count).ok_or_else(|| serde::de::Error::custom("must be a number of sides in range"))
    }
}

impl Serialize for PolygonSides {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_u32(self.count)
    }
}

impl JsonSchema for PolygonSides {
    fn schema_name() -> Cow<'static, str> {
        "PolygonSides".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "type": "integer", "minimum": 3, "maximum": MAX_SIDES,
            "description": "The number of sides of a regular polygon."
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folding_preserves_the_radius_and_ends_in_the_wedge() {
        for sides in (3..=MAX_SIDES).filter_map(PolygonSides::new) {
            let (inradius, half_edge) = sides.inradius_and_half_edge(1.0);
            for step in 0..500 {
                let (x, z) = Real::sin_cos(step as f32 * 0.012_566_3);
                let (along, out) = sides.fold(x, z);
                assert!((along.hypot(out) - 1.0).abs() < 2e-6, "{sides:?}");
                assert!(along > -2e-6 && along * inradius <= out * half_edge + 2e-6, "{sides:?} at step {step}");
            }
        }
    }

    #[test]
    fn hexagon_and_octagon_equal_six_and_eight_sides() {
        for (constant, count) in [(PolygonSides::HEXAGON, 6), (PolygonSides::OCTAGON, 8)] {
            let made = PolygonSides::new(count).expect("a few sides");
            assert_eq!(constant.mirrors_used, made.mirrors_used);
            let pairs =
                constant.fold_angles.into_iter().zip(made.fold_angles).chain([(constant.half_side, made.half_side)]);
            for ((sine, cosine), (made_sine, made_cosine)) in pairs {
                assert!((sine - made_sine).abs() <= f32::EPSILON && (cosine - made_cosine).abs() <= f32::EPSILON);
            }
        }
    }
}
