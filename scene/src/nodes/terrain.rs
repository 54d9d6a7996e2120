//! Land: heights over a plane, from noise.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::displacement_bounds::Relief;
use super::sdf::NOISE_COST;
use super::{Exactness, Primitive};
use crate::bounds::Bounds;
use crate::noise::Noise;
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::Length;

/// Land that is solid below y = height · noise(x, 0, z); without `size` it is infinite.
///
/// With a noise of Lipschitz factor L, the Lipschitz factor of y − height · noise is √(1 + (height·L)²).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct HeightField {
    /// The noise.
    pub noise: Noise,
    /// Height of the land where the noise is 1.
    pub height: Length,
    /// Whole extents of the box around the origin that the land is cut to.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size: Option<[Length; 3]>,
}

impl HeightField {
    /// Lipschitz factor of the formula, less 1.
    fn steepening(&self) -> f32 {
        let slope = self.height.get() * self.noise.lipschitz();
        // √(1 + slope²) − 1, without cancellation; for a large slope, whose square may overflow, the
        // slope itself.
        if slope > 1e6 { slope } else { slope * slope / (1.0 + Real::sqrt(1.0 + slope * slope)) }
    }

    #[inline(always)]
    fn relief(&self) -> Relief {
        let (low, high) = self.noise.range();
        let height = self.height.get();
        Relief::new([-height * low, -height * high], self.steepening())
    }
}

impl Primitive for HeightField {
    const EXAMPLE: &str =
        r#"{ "noise": { "perlin": { "scale": 1.7, "octaves": 5 } }, "height": 0.6, "size": [1.6, 1, 1.6] }"#;
    const MORE: &[&str] = &[
        r#"{ "noise": { "perlin": { "octaves": 3, "seed": 4, "scale": 2, "fractal": "ridged" } }, "height": 0.4, "size": [1.6, 0.8, 1.6] }"#,
        r#"{ "noise": { "simplex": { "octaves": 3 } }, "height": 0.3 }"#,
    ];

    #[inline(always)]
    fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        let like = p.x;
        let land = self.relief().added(
            p.y,
            #[inline(always)]
            || self.noise.value(vec3(p.x, like.splat(0.0), p.z)) * like.given(-self.height.get()),
        );
        match &self.size {
            None => land,
            Some(size) => {
                let half = Vec3::given(like, halved(size));
                land.max((vec3(p.x.abs(), p.y.abs(), p.z.abs()) - half).max_element())
            }
        }
    }

    fn stretch(&self) -> f32 {
        1.0 + self.steepening()
    }

    fn exactness(&self) -> Exactness {
        Exactness::Bound
    }

    fn is_fine(&self) -> bool {
        true
    }

    fn bounds(&self, level: f32) -> Bounds {
        let top = self.relief().level(level);
        let land = Bounds { high: vec3(f32::INFINITY, top, f32::INFINITY), ..Bounds::EVERYWHERE };
        self.size.as_ref().map_or(land, |size| {
            let Vec3 { x, y, z } = halved(size);
            land.overlap(Bounds::symmetric(x, y, z).widened(level))
        })
    }

    fn formula_cost(&self) -> f32 {
        NOISE_COST
    }

    fn lipschitz_advice(&self) -> &'static str {
        "lower its height, or the scale or octaves of its noise"
    }
}

fn halved([x, y, z]: &[Length; 3]) -> Vec3<f32> {
    vec3(x.get() * 0.5, y.get() * 0.5, z.get() * 0.5)
}
