//! Shapes with bumps: waves or noise added to the distance.

use std::f32::consts::TAU;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::displacement_bounds::MAX_LIPSCHITZ;
use super::displacement_bounds::{CachedDisplacementBounds, DisplacementBounds};
use super::per_axis::PerAxis;
use super::sdf::NOISE_COST;
use super::transforms::around_child;
use super::{Child, Exactness, Node, Sdf, SdfValue};
use crate::bounds::Bounds;
use crate::noise::Noise;
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::Coordinate;

/// A shape with bumps: amplitude · bumps is added to its distance, so the surface rises where the bumps are negative.
///
/// A Lipschitz factor is the child's plus |amplitude| times that of the bumps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Displace {
    /// The bumps.
    pub by: DisplacementFunction,
    /// Factor of the displacement.
    pub amplitude: Coordinate,
    /// The shape.
    pub child: Child,
    /// Cached region outside which the displacement is not evaluated.
    #[serde(skip)]
    pub bounds_cache: CachedDisplacementBounds,
}

/// Function added to a distance: an object whose member is the function's name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename_all = "snake_case")]
pub enum DisplacementFunction {
    /// Waves along all axes: sin(φx)·sin(φy)·sin(φz).
    Sine(Sine),
    /// A noise.
    Noise(Noise),
}

/// Waves along all axes: sin(φx)·sin(φy)·sin(φz).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Sine {
    /// φ, in radians per scene unit: one number, or one for each axis.
    pub frequency: PerAxis,
}

impl Sine {
    fn value<R: Real>(&self, p: Vec3<R>) -> R {
        let frequency = self.frequency.in_frame();
        let sine = periodic_sine(p.x, frequency.x) * periodic_sine(p.y, frequency.y);
        sine * periodic_sine(p.z, frequency.z)
    }

    /// The greatest frequency. With sᵢ, cᵢ the sines and cosines, the square of the gradient is Σ φᵢ²·cᵢ²·Πsⱼ² ≤ max
    /// φ² · Σ (1 − sᵢ²)·Πsⱼ². The last sum is at most 1, because it is the probability that exactly one of three
    /// independent events fails.
    fn lipschitz(&self) -> f32 {
        let Vec3 { x, y, z } = self.frequency.in_frame();
        x.abs().max(y.abs()).max(z.abs())
    }
}

/// sin(φ·c), accurate at any angle: full turns are subtracted first.
fn periodic_sine<R: Real>(c: R, frequency: f32) -> R {
    let turns = c * c.uniform(frequency / TAU);
    ((turns - (turns + 0.5).floor()) * TAU).sin()
}

impl DisplacementFunction {
    fn value<R: Real>(&self, p: Vec3<R>) -> R {
        match self {
            Self::Sine(sine) => sine.value(p),
            Self::Noise(noise) => noise.value(p),
        }
    }

    fn range(&self) -> (f32, f32) {
        match self {
            Self::Sine(_) => (-1.0, 1.0),
            Self::Noise(noise) => noise.range(),
        }
    }

    fn lipschitz(&self) -> f32 {
        match self {
            Self::Sine(sine) => sine.lipschitz(),
            Self::Noise(noise) => noise.lipschitz(),
        }
    }
}

impl Displace {
    fn bounds_cache(&self) -> DisplacementBounds {
        let amplitude = self.amplitude.in_frame();
        let (low, high) = self.by.range();
        let steepening = amplitude.abs() * self.by.lipschitz() / self.child.lipschitz();
        DisplacementBounds::new([low * amplitude, high * amplitude], steepening)
    }
}

impl Sdf for Displace {
    const EXAMPLE: &str = r#"{ "by": { "noise": { "perlin": { "scale": 5 } } }, "amplitude": -0.1,
        "child": { "sphere": { "radius": 1 } } }"#;
    const MORE_EXAMPLES: &[&str] = &[
        r#"{ "by": { "sine": { "frequency": 9 } }, "amplitude": 0.05, "child": { "sphere": { "radius": 1.1 } } }"#,
        r#"{ "by": { "sine": { "frequency": [20, 0.7, 0.7] } }, "amplitude": -0.2,
            "child": { "torus": { "radius": 0.8, "tube": 0.3 } } }"#,
        r#"{ "by": { "noise": { "cellular": { "scale": 4, "feature": "f2_minus_f1" } } }, "amplitude": -0.15,
            "child": { "sphere": { "radius": 1 } } }"#,
        r#"{ "by": { "noise": { "perlin": { "scale": 2, "octaves": 4, "fractal": "ridged" } } }, "amplitude": -0.2,
            "child": { "box": { "size": [1.3, 1.3, 1.3], "round": 0.1 } } }"#,
    ];

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let child: V = sample(0, p);
        let bounds = self.bounds_cache.0.unwrap_or_else(|| self.bounds_cache());
        let distance = bounds.displaced(child.distance(), || self.by.value(p) * p.x.uniform(self.amplitude.get()));
        child.with_distance(distance)
    }

    around_child!();

    fn prepare(&mut self, _: bool) {
        self.bounds_cache = CachedDisplacementBounds(Some(self.bounds_cache()));
    }

    fn lipschitz(&self) -> f32 {
        (self.child.lipschitz() + self.amplitude.in_frame().abs() * self.by.lipschitz()).min(MAX_LIPSCHITZ)
    }

    fn own_exactness(&self) -> Exactness {
        self.child.exactness().capped_at_bound()
    }

    fn is_fine(&self) -> bool {
        matches!(self.by, DisplacementFunction::Noise(_)) || self.child.is_fine()
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        self.child.bounds(self.bounds_cache().inflate(isolevel))
    }

    fn formula_cost(&self) -> f32 {
        NOISE_COST
    }

    fn lipschitz_advice(&self) -> &'static str {
        "lower its amplitude, frequency, scale or octaves"
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nodes::Distance;
    use crate::real::vec3;

    #[test]
    fn bumps_match_the_formula() {
        let text =
            r#"{ "by": { "sine": { "frequency": 9 } }, "amplitude": 0.05, "child": { "sphere": { "radius": 1.25 } } }"#;
        let node: Displace = serde_json::from_str(text).unwrap();
        for step in 1..100 {
            let turn = |speed: f32| Real::sin(speed * step as f32);
            let p = vec3(turn(1.3), turn(2.1), turn(0.7)).normalize() * 1.25;
            let want: f32 = 0.05 * Real::sin(9.0 * p.x) * Real::sin(9.0 * p.y) * Real::sin(9.0 * p.z);
            let got = node.eval::<f32, Distance<f32>>(p, &|index, q| node.children()[index].sample(q)).distance();
            assert!((got - want).abs() < 1e-6, "{got} at {p:?} should be {want}");
        }
    }
}
