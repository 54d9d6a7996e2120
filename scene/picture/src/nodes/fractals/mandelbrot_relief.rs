//! The Mandelbrot set as a relief.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{clamp_to_hull, distance_from_box, iterations};
use crate::bounds::Bounds;
use crate::kinds::{Exactness, NodeError};
use crate::limits::MAX_ITERATIONS;
use crate::nodes::Primitive;
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Coordinate, Length};

/// A square part of the Mandelbrot set as a slab on the plane y = 0: seen from above with −z up the page, the real
/// axis runs along x and the imaginary axis up.
///
/// The distance in the plane is estimated from the potential G and its slope: it is at least (1 − e⁻²ᴳ)/(4·|G′|),
/// hence at least ½·G/((1 + 2·G)·|G′|), with G = ln |z|/2ⁿ and |G′| = |z′|/(|z|·2ⁿ). After N iterations, points with G
/// of at most ln E/2ᴺ are solid, so that value is subtracted from G. John Milnor, "Self-similarity and hairiness in
/// the Mandelbrot set", 1989, and Inigo Quilez, "Distance to fractals":
/// <https://iquilezles.org/articles/distancefractals/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct MandelbrotRelief {
    /// Edge of the square, in scene units.
    pub size: Length,
    /// Height of the slab, in scene units.
    pub height: Length,
    /// The complex number at its center: real and imaginary part, within ±2.
    #[serde(default = "default_center")]
    pub center: [Coordinate; 2],
    /// Edge of the square in the complex plane, from 0.0001 to 8: smaller values zoom in.
    #[serde(default = "default_width")]
    pub width: Length,
    /// Maximum number of iterations of z → z² + c: more give finer detail.
    #[schemars(range(min = 1, max = MAX_ITERATIONS))]
    #[serde(deserialize_with = "iterations")]
    pub iterations: u32,
}

/// Square of the escape radius; large, so that the potential is near its limit.
const ESCAPE_SQUARED: f32 = 256.0;
/// Logarithm of that radius.
const ESCAPE_LOGARITHM: f32 = 2.772_588_7;
/// Keeps the square of a derivative within the range of a divisor.
const MAX_DERIVATIVE: f32 = 1e14;
/// Distance from its box within which the estimate is used, in widths.
const MARGIN: f32 = 0.25;

impl Primitive for MandelbrotRelief {
    const EXAMPLE: &str = r#"{ "size": 1.8, "height": 0.3, "center": [-0.65, 0], "width": 2.6, "iterations": 40 }"#;
    const MORE_EXAMPLES: &[&str] = &[
        r#"{ "size": 1.6, "height": 0.2, "center": [-0.745, 0.113], "width": 0.05, "iterations": 64 }"#,
        r#"{ "size": 1.6, "height": 0.5, "iterations": 6 }"#,
    ];

    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let (half, half_height) = (self.size.in_frame() * 0.5, self.height.in_frame() * 0.5);
        let p = vec3(p.x, p.y - p.x.uniform(half_height), p.z);
        clamp_to_hull(distance_from_box(p, vec3(half, half_height, half)), MARGIN * self.size.in_frame(), || {
            let across = self.planar_distance(p.x, p.z);
            let along = p.y.abs() - p.x.uniform(half_height);
            let outside = across.at_least(0.0).square_add(along.at_least(0.0).square()).sqrt();
            outside + across.max(along).at_most(0.0)
        })
    }

    fn exactness(&self) -> Exactness {
        Exactness::Estimate
    }

    fn validate(&self) -> Option<NodeError> {
        let [real, imaginary] = self.center.each_ref().map(Coordinate::in_frame);
        if real.abs().max(imaginary.abs()) > 2.0 {
            return Some(NodeError::new("center", "is outside ±2, where the set is: make both numbers from -2 to 2"));
        }
        let is_near = (1e-4..=8.0).contains(&self.width.in_frame());
        (!is_near).then(|| NodeError::new("width", "must be from 0.0001 to 8: make it 3 to see the whole set"))
    }

    fn is_fine(&self) -> bool {
        true
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let (half, height) = (self.size.in_frame() * 0.5, self.height.in_frame());
        Bounds { min: vec3(-half, 0.0, -half), max: vec3(half, height, half) }.expanded(isolevel)
    }
}

impl MandelbrotRelief {
    /// Lower bound of the distance to the set in the plane, in scene units; slightly below 0 inside.
    fn planar_distance<R: Real>(&self, x: R, z: R) -> R {
        let [real, imaginary] = self.center.each_ref().map(Coordinate::in_frame);
        let unit = x.uniform(self.width.get() / self.size.get());
        let (cx, cy) = (x.mul_add(unit, x.uniform(real)), x.uniform(imaginary) - z * unit);
        let one = x.constant(1.0);
        // Points that have not escaped by the last iteration are solid: their potential is at most ln
        // E/2ᴺ.
        let isolevel = x.uniform(ESCAPE_LOGARITHM * half_extents(self.iterations));
        let start = ((cx, cy), (one, one.constant(0.0)), cx.square_add(cy.square()), isolevel, one);
        let (_, (dx, dy), squared, isolevel, share) =
            R::repeat(self.iterations, start, |((a, b), (da, db), _, isolevel, share)| {
                let (twice_a, twice_b) = (a * 2.0, b * 2.0);
                let next_da = twice_a.mul_add(da, one - twice_b * db);
                let next_db = twice_a.mul_add(db, twice_b * da);
                let (a, b) = (a.square_add(cx - b.square()), twice_a.mul_add(b, cy));
                let squared = a.square_add(b.square());
                let slope = (clamp_derivative(next_da), clamp_derivative(next_db));
                (squared.below(ESCAPE_SQUARED), ((a, b), slope, squared, isolevel * 2.0, share * 0.5))
            });
        let squared = squared.at_least(1e-12);
        // Both in units of this iteration's fraction of the potential.
        let above = squared.ln() * 0.5 - isolevel;
        let slope = dx.square_add(dy.square()).at_least(1.0);
        let bound = above / (share * above.at_least(0.0) * 2.0 + 1.0);
        (squared / slope).sqrt() * bound * (x.uniform(self.size.get() / self.width.get()) * 0.5)
    }
}

/// 1/2ⁿ.
fn half_extents(times: u32) -> f32 {
    1.0 / (1_u64 << times.min(63)) as f32
}

/// Component of a derivative, clamped so that its square is finite.
fn clamp_derivative<R: Real>(slope: R) -> R {
    slope.at_most(MAX_DERIVATIVE).at_least(-MAX_DERIVATIVE)
}

fn default_center() -> [Coordinate; 2] {
    [-0.75, 0.0].map(|c| Coordinate::new(c).expect("it is in range"))
}

fn default_width() -> Length {
    Length::new(3.0).expect("3 is in range")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_that_have_not_escaped_are_solid() {
        let shape: MandelbrotRelief = serde_json::from_str(r#"{ "size": 3, "height": 1, "iterations": 20 }"#).unwrap();
        let mut counts = [0, 0];
        for (row, column) in (0..300).flat_map(|row| (0..300).map(move |column| (row, column))) {
            let (x, z) = (column as f32 * 0.01 - 1.495, row as f32 * 0.01 - 1.495);
            let (cx, cy) = (f64::from(x) - 0.75, f64::from(-z));
            let (mut a, mut b) = (cx, cy);
            for _ in 0..20 {
                if a * a + b * b < 256.0 {
                    (a, b) = (a * a - b * b + cx, 2.0 * a * b + cy);
                }
            }
            let is_solid = a * a + b * b < 256.0;
            let value = shape.distance(vec3(x, 0.5, z));
            // A point on the edge is on either side by rounding.
            assert!((value < 0.0) == is_solid || value.abs() < 1e-6, "{value} at {cx} + {cy}i");
            counts[usize::from(is_solid)] += 1;
        }
        assert!(counts.iter().all(|count| *count > 10_000), "{counts:?} are outside and solid");
    }
}
