//! Fractals: shapes of endless detail, whose distance is an estimate.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Primitive;
use crate::limits::MAX_ITERATIONS;
use crate::real::{Real, Vec3, vec3};
use crate::values::Power;

/// The Mandelbulb: z → zⁿ + p in polar coordinates about the z axis.
///
/// Daniel White and Paul Nylander's formula; the distance estimate is ½·ln r·r/dr with dr → n·rⁿ⁻¹·dr + 1,
/// as in Mikael Christensen, "Distance Estimated 3D Fractals", part V:
/// <http://blog.hvidtfeldts.net/index.php/2011/09/distance-estimated-3d-fractals-v-the-mandelbulb-different-de-approximations/>.
/// Far away, where the estimate grows faster than the distance, it is held to the distance from the
/// ball of radius 1.5 that holds every bulb of power 3 or more (of radius 2 for lower powers).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Mandelbulb {
    /// The power n.
    pub power: Power,
    /// How often the formula is applied at most: the finer the deeper.
    #[schemars(range(min = 1, max = MAX_ITERATIONS))]
    #[serde(deserialize_with = "iterations")]
    pub iterations: u32,
}

/// Where a point has escaped.
const ESCAPE_RADIUS: f32 = 2.0;
/// Keeps the growth of dr within what a quotient may have below it.
const LARGEST_SLOPE: f32 = 1e30;

impl Primitive for Mandelbulb {
    const EXAMPLE: &str = r#"{ "power": 8, "iterations": 8 }"#;

    #[inline(always)]
    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let power = self.power.get();
        let away = p.length();
        let one = away.splat(1.0);
        let bounded = !away.above(ESCAPE_RADIUS);
        let (_, radius, slope) = R::when(
            bounded,
            (p, away, one),
            #[inline(always)]
            || {
                R::repeat(
                    self.iterations,
                    (p, away, one),
                    #[inline(always)]
                    |(z, radius, slope)| {
                        let radius = radius.at_least(1e-6);
                        let (sin_theta, cos_theta) = ((z.z / radius).acos() * power).sin_cos();
                        let (sin_phi, cos_phi) = (z.y.atan2(z.x) * power).sin_cos();
                        let growth = radius.powf(radius.splat(power - 1.0));
                        let grown = growth * radius;
                        let turned = vec3(sin_theta * cos_phi, sin_theta * sin_phi, cos_theta);
                        let next = turned.mul_add(grown, p);
                        let slope = (growth * power).mul_add(slope, one).at_most(LARGEST_SLOPE);
                        let radius = next.length();
                        (!radius.above(ESCAPE_RADIUS), (next, radius, slope))
                    },
                )
            },
        );
        let radius = radius.at_least(1e-6);
        let estimate = radius.ln() * radius / slope * 0.5;
        R::select(away.above(ESCAPE_RADIUS), estimate.min(away - self.bounding_radius()), estimate)
    }

    fn is_estimate(&self) -> bool {
        true
    }
}

impl Mandelbulb {
    fn bounding_radius(&self) -> f32 {
        if self.power.get() < 3.0 { 2.0 } else { 1.5 }
    }
}

/// Reads a number of iterations that is in range.
fn iterations<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    crate::values::whole(deserializer, 1, MAX_ITERATIONS, "iterations")
}
