//! What lies between and around surfaces: fog, and how much of the sky a place sees.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::camera::Ray;
use crate::kinds::Exemplary;
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::{Color, Density, Length, Share};

/// Fog: what is further away fades into it.
///
/// With a falloff it lies on the ground: Inigo Quilez, "Better fog", <https://iquilezles.org/articles/fog/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Fog {
    /// How thick it is, at height 0 if it falls off.
    pub density: Density,
    /// By what share of itself it gets thinner on a unit of height; 0 is as thick everywhere.
    #[serde(default = "even")]
    pub falloff: Density,
    /// Its colour; the background's in each direction when absent, which then fades nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub color: Option<Color>,
}

/// How light from all around is lost in corners, found from distances alone.
///
/// Alex Evans, "Fast approximations for global illumination on dynamic scenes", SIGGRAPH 2006 course:
/// five distances along the normal are compared with how far out they were taken.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct AmbientOcclusion {
    /// How far away things still matter.
    pub distance: Length,
    /// How dark a corner gets.
    #[serde(default = "whole")]
    pub strength: Share,
}

impl Exemplary for Fog {
    const EXAMPLE: &'static str = r##"{ "density": 0.12, "color": "#c3ccd6" }"##;
    const MORE: &'static [&'static str] =
        &[r##"{ "density": 0.07, "falloff": 2, "color": "#e6e2da" }"##, r#"{ "density": 0.09 }"#];
}

impl Exemplary for AmbientOcclusion {
    const EXAMPLE: &'static str = r#"{ "distance": 0.8 }"#;
}

impl Fog {
    /// The share of the light that comes through `length` of the ray.
    #[inline(always)]
    pub fn transmittance<R: Real>(&self, ray: &Ray<R>, length: R) -> R {
        let density = length.given(self.density.get());
        if self.falloff.is_zero() {
            return (-(density * length)).exp();
        }
        // ∫ exp(−falloff·(y + t·dy)) dt, where the ray climbs by more than nothing.
        let falloff = length.given(self.falloff.get());
        let start = (-(ray.origin.y * falloff)).at_most(20.0).exp();
        let slope = falloff * ray.direction.y;
        let level = slope.abs().below(1e-6);
        let slope = R::select(level, slope.splat(1e-6), slope);
        let climbed = (-(slope * length)).at_most(40.0).exp();
        let through = ((length.splat(1.0) - climbed) / slope).at_least(0.0);
        (-(density * start * R::select(level, length, through))).exp()
    }
}

impl AmbientOcclusion {
    /// How open a place is, 0 to 1. `distance` tells how far a point is from the nearest surface.
    #[inline(always)]
    pub fn openness<R: Real>(&self, p: Vec3<R>, normal: Vec3<R>, distance: impl Fn(Vec3<R>) -> R) -> R {
        const TAPS: u32 = 5;
        let mut missing = p.x.splat(0.0);
        let mut weight = 1.0;
        let mut weights = 0.0;
        for tap in 1..=TAPS {
            let out = self.distance.get() * tap as f32 / TAPS as f32;
            let found = distance(normal.mul_add(p.x.given(out), p));
            missing = ((p.x.given(out) - found) * p.x.given(weight / out)).at_least(0.0) + missing;
            weights += weight;
            weight *= 0.75;
        }
        let openness = missing.splat(1.0) - missing * p.x.given(self.strength.get() / weights);
        openness.at_least(0.0)
    }
}

fn even() -> Density {
    Density::new(0.0).expect("0 is in range")
}

fn whole() -> Share {
    Share::new(1.0).expect("1 is in range")
}
