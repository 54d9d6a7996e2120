//! Fog: its transmittance along a ray, and its color.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::ray::Ray;
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Color, Density};

/// Fog: objects fade into it with distance.
///
/// With a falloff it is densest near the ground: Inigo Quilez, "Better fog", <https://iquilezles.org/articles/fog/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Fog {
    /// Density: at height 0 if `falloff` is above 0, else everywhere.
    pub density: Density,
    /// Rate at which the density decreases with height, per unit; 0 means constant density.
    #[serde(default = "default_falloff")]
    pub falloff: Density,
    /// Color of the fog. When absent, the background's color in each direction, and the horizon's below the horizon;
    /// the environment's if the background is transparent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub color: Option<Color>,
}

impl Fog {
    /// Small valid values, as a user would write them, for pictures in the docs and for tests.
    pub(crate) fn examples() -> Vec<String> {
        [
            r##"{ "density": 0.12, "color": "#c3ccd6" }"##,
            r##"{ "density": 0.07, "falloff": 2, "color": "#e6e2da" }"##,
            r#"{ "density": 0.09 }"#,
        ]
        .map(str::to_owned)
        .into()
    }

    /// Direction in which the background is evaluated for fog without a color of its own.
    pub fn direction_of_color<R: Real>(direction: Vec3<R>) -> Vec3<R> {
        let level = vec3(direction.x, direction.y.at_least(0.0), direction.z);
        level * (direction.x.constant(1.0) / level.length().at_least(1e-3))
    }

    /// Transmittance along `length` of the ray.
    pub fn transmittance<R: Real>(&self, ray: &Ray<R>, length: R) -> R {
        let density = length.uniform(self.density.get());
        if self.falloff.is_zero() {
            return (-(density * length)).exp();
        }
        // ∫ exp(−falloff·(y + t·dy)) dt, if the ray climbs.
        let falloff = length.uniform(self.falloff.get());
        let start = (-(ray.origin.y * falloff)).at_most(20.0).exp();
        let slope = falloff * ray.direction.y;
        let level = slope.abs().below(1e-6);
        let slope = R::select(level, slope.constant(1e-6), slope);
        let climbed = (-(slope * length)).at_most(40.0).exp();
        let through = ((length.constant(1.0) - climbed) / slope).at_least(0.0);
        (-(density * start * R::select(level, length, through))).exp()
    }
}

fn default_falloff() -> Density {
    Density::new(0.0).expect("0 is in range")
}
