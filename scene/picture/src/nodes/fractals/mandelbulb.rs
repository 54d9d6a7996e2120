//! The Mandelbulb and its Julia sets.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{MAX_DERIVATIVE, clamp_to_hull, iterations};
use crate::bounds::Bounds;
use crate::kinds::{Exactness, NodeError};
use crate::limits::MAX_ITERATIONS;
use crate::nodes::Primitive;
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Point, Power};

/// The Mandelbulb: z → zⁿ + p in polar coordinates about the z axis.
///
/// Daniel White and Paul Nylander's formula; the distance estimate is ½·ln r·r/dr with dr → n·rⁿ⁻¹·dr + 1, as in
/// Mikael Christensen, "Distance Estimated 3D Fractals", part V:
/// <http://blog.hvidtfeldts.net/index.php/2011/09/distance-estimated-3d-fractals-v-the-mandelbulb-different-de-approximations/>.
/// At large distances the estimate grows faster than the distance. It is therefore clamped to the distance from the
/// ball of radius 1.5 that contains every bulb of power 3 or more (of radius 2 for lower powers). Near the poles,
/// where orbits diverge faster around the axis than dr, the estimate may exceed the distance to a thin piece; the
/// estimate of the Julia sets accounts for this.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Mandelbulb {
    /// The power n.
    pub power: Power,
    /// Maximum number of iterations: more give finer detail.
    #[schemars(range(min = 1, max = MAX_ITERATIONS))]
    #[serde(deserialize_with = "iterations")]
    pub iterations: u32,
    /// A constant to add instead of the point, of length 1.5 or less: the shape is then the corresponding Julia set.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub julia: Option<Point>,
}

/// Escape radius.
const ESCAPE_RADIUS: f32 = 2.0;
/// Escape radius of a Julia set, small enough that its 32nd power has a finite square.
const JULIA_ESCAPE_RADIUS: f32 = 3.0;
/// Logarithm of that radius.
const JULIA_ESCAPE_LOGARITHM: f32 = 1.098_612_3;
/// Distance from the bounding ball of a Julia set within which the estimate is used.
const MARGIN: f32 = 0.25;
/// Maximum length of the constant, which keeps every Julia set well within the escape radius.
const MAX_JULIA_LENGTH: f32 = 1.5;

impl Primitive for Mandelbulb {
    const EXAMPLE: &str = r#"{ "power": 8, "iterations": 8 }"#;
    const MORE_EXAMPLES: &[&str] = &[
        r#"{ "power": 8, "iterations": 4, "julia": [-0.8, 0.3, 0.3] }"#,
        r#"{ "power": 3, "iterations": 6, "julia": [-0.4, 0.1, 0.6] }"#,
    ];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        match &self.julia {
            Some(constant) => clamp_to_hull(p.length() - p.x.uniform(self.bounding_radius()), MARGIN, || {
                self.julia_distance(p, Vec3::uniform(p.x, constant.get()))
            }),
            None => self.bulb_distance(p),
        }
    }

    fn exactness(&self) -> Exactness {
        Exactness::Estimate
    }

    fn validate(&self) -> Option<NodeError> {
        if self.julia.is_some() && as_integer(&self.power).is_none() {
            let cure = format!(
                "must be a whole number for a Julia set, because other powers are discontinuous: make it {}, the same in all frames",
                self.power.in_frame().round()
            );
            return Some(NodeError::new("power", cure));
        }
        let is_long = self.julia.as_ref().is_some_and(|constant| constant.in_frame().length() > MAX_JULIA_LENGTH);
        is_long.then(|| {
            let cure = "is longer than 1.5, so the set is only dust: make the sum of its squares 2.25 or less";
            NodeError::new("julia", cure)
        })
    }

    fn is_fine(&self) -> bool {
        true
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        // Inside the escape ball the estimate hardly depends on the distance to the surface.
        let ball = self.bounding_radius();
        let radius = if isolevel > 0.0 { (ball + isolevel).max(ESCAPE_RADIUS) } else { ball };
        Bounds::symmetric(radius, radius, radius)
    }
}

impl Mandelbulb {
    fn bulb_distance<R: Real>(&self, p: Vec3<R>) -> R {
        let away = p.length();
        let one = away.constant(1.0);
        let power = away.uniform(self.power.get());
        let bounded = !away.above(ESCAPE_RADIUS);
        let (_, radius, slope) = R::when(bounded, (p, away, one), || {
            R::repeat(self.iterations, (p, away, one), |(z, radius, slope)| {
                let radius = radius.at_least(1e-6);
                let (next, growth) = match as_integer(&self.power) {
                    Some(whole) => {
                        let PowerStep { next, growth, .. } = power_by_products(z, radius, whole, p);
                        (next, growth)
                    }
                    None => power_by_angles(z, radius, power, p),
                };
                let slope = (growth * power).mul_add(slope, one).at_most(MAX_DERIVATIVE);
                let radius = next.length();
                (!radius.above(ESCAPE_RADIUS), (next, radius, slope))
            })
        });
        let radius = radius.at_least(1e-6);
        let estimate = radius.ln() * radius / slope * 0.5;
        R::select(away.above(ESCAPE_RADIUS), estimate.min(away - away.uniform(self.bounding_radius())), estimate)
    }

    /// Estimate for a Julia set. Orbits diverge by at most n·rⁿ⁻¹ along a meridian, and around the axis in proportion
    /// to their distance from it.
    fn julia_distance<R: Real>(&self, p: Vec3<R>, constant: Vec3<R>) -> R {
        let one = p.x.constant(1.0);
        let whole = self.power.in_frame() as u32;
        let power = one.uniform(self.power.get());
        // Points that have not escaped by the last iteration are solid: their potential is at most ln
        // E/nᴺ.
        let share = Real::powf(self.power.in_frame(), -(self.iterations as f32));
        let isolevel = one.uniform(JULIA_ESCAPE_LOGARITHM * share);
        let (_, radius, slope, isolevel) =
            R::repeat(self.iterations, (p, p.length(), one, isolevel), |(z, radius, slope, isolevel)| {
                let radius = radius.at_least(1e-6);
                let PowerStep { next, growth, around } = power_by_products(z, radius, whole, constant);
                // Orbits do not diverge at 0, but they do near it.
                let slope = (growth.max(around) * power * slope).at_least(1.0).at_most(MAX_DERIVATIVE);
                let radius = next.length();
                (!radius.above(JULIA_ESCAPE_RADIUS), (next, radius, slope, isolevel * power))
            });
        let radius = radius.at_least(1e-6);
        (radius.ln() - isolevel) * radius / slope * 0.5
    }

    /// Beyond the radius R where Rⁿ − |c| = R orbits only grow; in a Julia set |c| is at most 1.5.
    fn bounding_radius(&self) -> f32 {
        match &self.julia {
            _ if self.power.in_frame() >= 3.0 => 1.5,
            Some(_) => 1.85,
            None => 2.0,
        }
    }
}

/// The power, if it is an integer. The formula then depends on it in code, not in data.
fn as_integer(power: &Power) -> Option<u32> {
    power.constant().filter(|power| power % 1.0 == 0.0).map(|power| power as u32)
}

/// zⁿ + p and rⁿ⁻¹ for any power n.
fn power_by_angles<R: Real>(z: Vec3<R>, radius: R, power: R, p: Vec3<R>) -> (Vec3<R>, R) {
    let (sin_theta, cos_theta) = ((z.z / radius).acos() * power).sin_cos();
    let (sin_phi, cos_phi) = (z.y.atan2(z.x) * power).sin_cos();
    let growth = radius.powf(power - 1.0);
    let direction = vec3(sin_theta * cos_phi, sin_theta * sin_phi, cos_theta);
    (direction.mul_add(growth * radius, p), growth)
}

/// One step of the power by products.
struct PowerStep<R> {
    /// zⁿ + p.
    next: Vec3<R>,
    /// rⁿ⁻¹.
    growth: R,
    /// Ratio of the distances of zⁿ and z from the axis.
    around: R,
}

/// Power for integers, which needs no angles: (z + iρ)ⁿ is rⁿ(cos nθ + i sin nθ), and the unit number (x +
/// iy)/ρ to the power n is cos nφ + i sin nφ, by de Moivre's formula.
fn power_by_products<R: Real>(z: Vec3<R>, radius: R, power: u32, p: Vec3<R>) -> PowerStep<R> {
    let from_axis = z.x.square_add(z.y.square()).sqrt();
    let per_axis = z.x.constant(1.0) / from_axis.at_least(1e-12);
    let (along, across) = complex_power((z.z, from_axis), power);
    let (cosine, sine) = complex_power((z.x * per_axis, z.y * per_axis), power);
    let next = vec3(across.mul_add(cosine, p.x), across.mul_add(sine, p.y), along + p.z);
    let growth = pow_by_squaring(radius, power - 1, |a: R, b: R| a * b);
    PowerStep { next, growth, around: (across * per_axis).abs() }
}

/// Real and imaginary part of a + bi to an integer power, 1 or more.
fn complex_power<R: Real>(number: (R, R), power: u32) -> (R, R) {
    pow_by_squaring(number, power, |(a, b): (R, R), (c, d): (R, R)| (a.mul_add(c, -(b * d)), a.mul_add(d, b * c)))
}

/// Product of `power` factors `base`, 1 or more, by repeated squaring.
fn pow_by_squaring<T: Copy>(base: T, power: u32, product: impl Fn(T, T) -> T) -> T {
    let mut result = base;
    for bit in (0..power.ilog2()).rev() {
        result = product(result, result);
        if power >> bit & 1 == 1 {
            result = product(result, base);
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn power_by_products_equals_power_by_angles() {
        for power in [2_u32, 3, 5, 8, 13] {
            for step in 0..200 {
                let turn = |speed: f32| Real::sin(speed * step as f32);
                let z = vec3(turn(1.3), turn(2.1), turn(0.7));
                let p = vec3(turn(0.4), turn(3.1), turn(1.9));
                let (radius, exponent) = (z.length(), power as f32);
                if radius < 0.1 {
                    continue;
                }
                let got = power_by_products(z, radius, power, p);
                let (want, want_growth) = power_by_angles(z, radius, exponent, p);
                let error = (got.next - want).length();
                assert!(error < 3e-6 * exponent * want_growth.max(1.0), "power {power} of {z:?}: {error}");
                assert!((got.growth - want_growth).abs() < 1e-5 * want_growth, "power {power} of {z:?}");
            }
        }
    }
}
