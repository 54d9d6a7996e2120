//! Terrain: heights over a plane, from noise.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::displacement_bounds::DisplacementBounds;
use super::sdf::NOISE_COST;
use super::{Exactness, Sdf, SdfValue};
use crate::bounds::Bounds;
use crate::noise::Noise;
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::Length;

/// Terrain that is solid below y = height · noise(x, 0, z); without `size` it is infinite.
///
/// With a noise of Lipschitz factor L, the Lipschitz factor of y − height · noise is √(1 + (height·L)²).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct HeightField {
    /// The noise.
    pub noise: Noise,
    /// Height of the terrain where the noise is 1.
    pub height: Length,
    /// Full extents of the box around the origin to which the terrain is cut.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size: Option<[Length; 3]>,
}

impl HeightField {
    /// Lipschitz factor of the formula, less 1.
    fn slope_bound(&self) -> f32 {
        let slope = self.height.in_frame() * self.noise.lipschitz();
        // √(1 + slope²) − 1, without cancellation; for a large slope, whose square may overflow, the
        // slope itself.
        if slope > 1e6 { slope } else { slope * slope / (1.0 + Real::sqrt(1.0 + slope * slope)) }
    }

    fn displacement(&self) -> DisplacementBounds {
        let (low, high) = self.noise.range();
        let height = self.height.in_frame();
        DisplacementBounds::new([-height * low, -height * high], self.slope_bound())
    }
}

impl Sdf for HeightField {
    const EXAMPLE: &'static str =
        r#"{ "noise": { "perlin": { "scale": 1.7, "octaves": 5 } }, "height": 0.6, "size": [1.6, 1, 1.6] }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "noise": { "perlin": { "octaves": 3, "seed": 4, "scale": 2, "fractal": "ridged" } }, "height": 0.4, "size": [1.6, 0.8, 1.6] }"#,
        r#"{ "noise": { "simplex": { "octaves": 3 } }, "height": 0.3 }"#,
    ];

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, _: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let like = p.x;
        let land = self
            .displacement()
            .displaced(p.y, || self.noise.value(vec3(p.x, like.constant(0.0), p.z)) * like.uniform(-self.height.get()));
        V::new(match &self.size {
            None => land,
            Some(size) => {
                let half = Vec3::uniform(like, half_extents(size));
                land.max((vec3(p.x.abs(), p.y.abs(), p.z.abs()) - half).max_element())
            }
        })
    }

    fn lipschitz(&self) -> f32 {
        1.0 + self.slope_bound()
    }

    fn own_exactness(&self) -> Exactness {
        Exactness::Bound
    }

    fn is_fine(&self) -> bool {
        true
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let top = self.displacement().inflate(isolevel);
        let land = Bounds { max: vec3(f32::INFINITY, top, f32::INFINITY), ..Bounds::INFINITE };
        self.size.as_ref().map_or(land, |size| {
            let Vec3 { x, y, z } = half_extents(size);
            land.intersection(Bounds::symmetric(x, y, z).expanded(isolevel))
        })
    }

    fn formula_cost(&self) -> f32 {
        NOISE_COST
    }

    fn lipschitz_advice(&self) -> &'static str {
        "lower its height, or the scale or octaves of its noise"
    }
}

fn half_extents([x, y, z]: &[Length; 3]) -> Vec3<f32> {
    vec3(x.in_frame() * 0.5, y.in_frame() * 0.5, z.in_frame() * 0.5)
}
