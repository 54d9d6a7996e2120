//! A shape in a space distorted by noise.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::displacement_bounds::MAX_LIPSCHITZ;
use super::sdf::NOISE_COST;
use super::transforms::around_child;
use super::{Child, Exactness, Node, Sdf, SdfValue};
use crate::bounds::Bounds;
use crate::noise::Noise;
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::Coordinate;

/// A shape evaluated with each point shifted by three noises: domain warping, as in Inigo Quilez,
/// <https://iquilezles.org/articles/warp/>. The noises are `noise` with three seeds, each less the center of its
/// range.
///
/// The Lipschitz factor of the shift is at most |amplitude|·√3 times that of the noise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Warp {
    /// The noise.
    pub noise: Noise,
    /// Factor of the noises.
    pub amplitude: Coordinate,
    /// The shape.
    pub child: Child,
}

impl Sdf for Warp {
    const EXAMPLE: &str = r#"{ "noise": { "perlin": { "scale": 2 } }, "amplitude": 0.25,
        "child": { "box": { "size": [1.2, 1.2, 1.2] } } }"#;
    const MORE_EXAMPLES: &[&str] =
        &[r#"{ "noise": { "value": { "scale": 1.5, "octaves": 2, "seed": 3 } }, "amplitude": 0.2,
        "child": { "torus": { "radius": 0.8, "tube": 0.25 } } }"#];

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let (low, high) = self.noise.range();
        let shift = self.noise.vector(p).map(|c| c - (low + high) * 0.5);
        sample(0, shift.mul_add(p.x.uniform(self.amplitude.get()), p))
    }

    around_child!();

    fn lipschitz(&self) -> f32 {
        let shift = self.amplitude.in_frame().abs() * Real::sqrt(3.0_f32) * self.noise.lipschitz();
        (self.child.lipschitz() * (1.0 + shift)).min(MAX_LIPSCHITZ)
    }

    fn own_exactness(&self) -> Exactness {
        self.child.exactness().capped_at_bound()
    }

    fn is_fine(&self) -> bool {
        true
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let (low, high) = self.noise.range();
        self.child.bounds(isolevel).expanded(self.amplitude.in_frame().abs() * (high - low) * 0.5)
    }

    fn formula_cost(&self) -> f32 {
        3.0 * NOISE_COST
    }

    fn lipschitz_advice(&self) -> &'static str {
        "lower its amplitude, frequency, scale or octaves"
    }
}
