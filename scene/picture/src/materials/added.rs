//! Material that exists in unit tests alone: shows what adding one takes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::bsdf::Bsdf;
use super::{IncidentLight, Shade, ShadingPoint};
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::Color;

/// A constant color under light from any angle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct AddedMaterial {
    /// The color.
    pub color: Color,
}

impl Shade for AddedMaterial {
    const EXAMPLE: &str = r#"{ "color": [0.8, 0.4, 0.1] }"#;

    fn shade<R: Real>(&self, place: &ShadingPoint<R>, light: &IncidentLight<R>) -> Vec3<R> {
        let own = self.albedo(place);
        light
            .lights
            .iter()
            .fold(own * place.camera_t.constant(0.0), |sum, light| own.mul_elementwise(light.radiance) + sum)
    }

    fn albedo<R: Real>(&self, place: &ShadingPoint<R>) -> Vec3<R> {
        Vec3::uniform(place.camera_t, self.color.get())
    }

    fn bsdf<R: Real>(&self, place: &ShadingPoint<R>) -> Bsdf<R> {
        Bsdf { diffuse: self.albedo(place), ..Bsdf::black(place.camera_t) }
    }

    fn is_lit(&self) -> bool {
        true
    }
}
