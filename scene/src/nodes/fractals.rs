//! Fractals: shapes of endless detail, whose distance is an estimate.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Exactness, Primitive};
use crate::bounds::Bounds;
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
        let away = p.length();
        let one = away.splat(1.0);
        let power = away.given(self.power.get());
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
                        let (next, growth) = match whole(self.power) {
                            Some(whole) => turned_by_products(z, radius, whole, p),
                            None => turned_by_angles(z, radius, power, p),
                        };
                        let slope = (growth * power).mul_add(slope, one).at_most(LARGEST_SLOPE);
                        let radius = next.length();
                        (!radius.above(ESCAPE_RADIUS), (next, radius, slope))
                    },
                )
            },
        );
        let radius = radius.at_least(1e-6);
        let estimate = radius.ln() * radius / slope * 0.5;
        R::select(away.above(ESCAPE_RADIUS), estimate.min(away - away.given(self.bounding_radius())), estimate)
    }

    fn exactness(&self) -> Exactness {
        Exactness::Estimate
    }

    fn bounds(&self, level: f32) -> Bounds {
        // Inside the ball of escape the estimate says little about how far the surface is.
        let ball = self.bounding_radius();
        let radius = if level > 0.0 { (ball + level).max(ESCAPE_RADIUS) } else { ball };
        Bounds::symmetric(radius, radius, radius)
    }
}

impl Mandelbulb {
    fn bounding_radius(&self) -> f32 {
        if self.power.get() < 3.0 { 2.0 } else { 1.5 }
    }
}

/// The power, if it is a whole number in all frames: then its formula is code, not data.
fn whole(power: Power) -> Option<u32> {
    (power.get() % 1.0 == 0.0 && !power.is_moving()).then_some(power.get() as u32)
}

/// zⁿ + p and rⁿ⁻¹ for any power n.
#[inline(always)]
fn turned_by_angles<R: Real>(z: Vec3<R>, radius: R, power: R, p: Vec3<R>) -> (Vec3<R>, R) {
    let (sin_theta, cos_theta) = ((z.z / radius).acos() * power).sin_cos();
    let (sin_phi, cos_phi) = (z.y.atan2(z.x) * power).sin_cos();
    let growth = radius.powf(power - 1.0);
    let turned = vec3(sin_theta * cos_phi, sin_theta * sin_phi, cos_theta);
    (turned.mul_add(growth * radius, p), growth)
}

/// The same for a whole power, which needs no angles: (z + iρ)ⁿ is rⁿ(cos nθ + i sin nθ), and
/// the unit number (x + iy)/ρ to the power n is cos nφ + i sin nφ, by de Moivre's formula.
#[inline(always)]
fn turned_by_products<R: Real>(z: Vec3<R>, radius: R, power: u32, p: Vec3<R>) -> (Vec3<R>, R) {
    let from_axis = z.x.square_add(z.y.square()).sqrt();
    let per_axis = z.x.splat(1.0) / from_axis.at_least(1e-12);
    let (along, across) = complex_power((z.z, from_axis), power);
    let (cosine, sine) = complex_power((z.x * per_axis, z.y * per_axis), power);
    let next = vec3(across.mul_add(cosine, p.x), across.mul_add(sine, p.y), along + p.z);
    let growth = by_squares(
        radius,
        power - 1,
        #[inline(always)]
        |a: R, b: R| a * b,
    );
    (next, growth)
}

/// The real and imaginary parts of a + bi to a whole power, 1 or more.
#[inline(always)]
fn complex_power<R: Real>(number: (R, R), power: u32) -> (R, R) {
    by_squares(
        number,
        power,
        #[inline(always)]
        |(a, b): (R, R), (c, d): (R, R)| (a.mul_add(c, -(b * d)), a.mul_add(d, b * c)),
    )
}

/// The product of `power` times `base`, 1 or more, by repeated squaring.
#[inline(always)]
fn by_squares<T: Copy>(base: T, power: u32, product: impl Fn(T, T) -> T) -> T {
    let mut result = base;
    for bit in (0..power.ilog2()).rev() {
        result = product(result, result);
        if power >> bit & 1 == 1 {
            result = product(result, base);
        }
    }
    result
}

/// Reads a number of iterations that is in range.
fn iterations<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    crate::values::whole(deserializer, 1, MAX_ITERATIONS, "iterations")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_turn_as_far_as_angles() {
        for power in [2_u32, 3, 5, 8, 13] {
            for step in 0..200 {
                let turn = |speed: f32| Real::sin(speed * step as f32);
                let z = vec3(turn(1.3), turn(2.1), turn(0.7));
                let p = vec3(turn(0.4), turn(3.1), turn(1.9));
                let (radius, exponent) = (z.length(), power as f32);
                if radius < 0.1 {
                    continue;
                }
                let (got, got_growth) = turned_by_products(z, radius, power, p);
                let (want, want_growth) = turned_by_angles(z, radius, exponent, p);
                let error = (got - want).length();
                assert!(error < 3e-6 * exponent * want_growth.max(1.0), "power {power} of {z:?}: {error}");
                assert!((got_growth - want_growth).abs() < 1e-5 * want_growth, "power {power} of {z:?}");
            }
        }
    }
}
