//! Materials that ignore light.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::bsdf::Bsdf;
use super::{ColorParam, IncidentLight, Shade, ShadingPoint, Texture};
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::Color;

/// One color, independent of light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Flat {
    /// The color.
    pub color: ColorParam,
}

impl Shade for Flat {
    const ALIASES: &'static [&'static str] = &["constant"];
    const EXAMPLE: &'static str = r##"{ "color": "#e07a3c" }"##;
    const MORE_EXAMPLES: &'static [&'static str] = &[r##"{ "color": { "gradient": {
        "by": { "position": { "from": [0, -1, 0], "to": [0, 1, 0] } },
        "ramp": [[0, "#26304f"], [0.5, "#c8506a"], [1, "#ffd9a0"]]
    } } }"##];

    fn shade<R: Real>(&self, place: &ShadingPoint<R>, _: &IncidentLight<R>) -> Vec3<R> {
        self.albedo(place)
    }

    fn albedo<R: Real>(&self, place: &ShadingPoint<R>) -> Vec3<R> {
        self.color.at(place)
    }

    /// It emits its color.
    fn bsdf<R: Real>(&self, place: &ShadingPoint<R>) -> Bsdf<R> {
        Bsdf { emission: self.albedo(place), ..Bsdf::black(place.camera_t) }
    }

    fn is_lit(&self) -> bool {
        false
    }

    fn uniform_emission(&self) -> Option<Vec3<f32>> {
        self.color.as_constant().filter(|color| !color.is_black()).map(Color::in_frame)
    }

    fn textures(&self) -> Vec<&Texture> {
        self.color.texture().into_iter().collect()
    }
}

/// The normal N as a color: (N + 1)/2.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Normals {}

impl Shade for Normals {
    const EXAMPLE: &'static str = "{}";

    fn shade<R: Real>(&self, place: &ShadingPoint<R>, _: &IncidentLight<R>) -> Vec3<R> {
        self.albedo(place)
    }

    fn albedo<R: Real>(&self, place: &ShadingPoint<R>) -> Vec3<R> {
        place.normal.map(|c| c.mul_add(c.constant(0.5), c.constant(0.5)))
    }

    /// It emits its color.
    fn bsdf<R: Real>(&self, place: &ShadingPoint<R>) -> Bsdf<R> {
        Bsdf { emission: self.albedo(place), ..Bsdf::black(place.camera_t) }
    }

    fn is_lit(&self) -> bool {
        false
    }
}
