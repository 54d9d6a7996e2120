//! A surface that shows only the shadows on it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::bsdf::Bsdf;
use super::{IncidentLight, Material, Shade, ShadingPoint};
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::Fraction;

/// Shows only the shadows on it, as black over the background: a picture with a transparent background keeps them in
/// its alpha, for compositing.
///
/// Its opacity is the fraction of the light that shadows and ambient occlusion take away. Behind it, the background is
/// seen, not the objects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct ShadowCatcher {
    /// Opacity where no light arrives.
    #[serde(default = "default_opacity")]
    pub opacity: Fraction,
}

impl Material {
    /// Whether it shows the shadows on it and nothing else.
    pub fn is_shadow_catcher(&self) -> bool {
        matches!(self, Self::ShadowCatcher(_))
    }

    /// Fraction of the background that is seen through a shadow catcher; `None` for other materials.
    pub fn transparency<R: Real>(&self, light: &IncidentLight<R>) -> Option<R> {
        let (Self::ShadowCatcher(catcher), Some(shadow)) = (self, light.shadow) else { return None };
        let opacity = shadow.uniform(catcher.opacity.get());
        Some(shadow.constant(1.0) - shadow * opacity)
    }
}

impl Shade for ShadowCatcher {
    const EXAMPLE: &'static str = "{}";
    const MORE_EXAMPLES: &'static [&'static str] = &[r#"{ "opacity": 0.6 }"#];

    fn shade<R: Real>(&self, place: &ShadingPoint<R>, _: &IncidentLight<R>) -> Vec3<R> {
        self.albedo(place)
    }

    fn albedo<R: Real>(&self, place: &ShadingPoint<R>) -> Vec3<R> {
        let zero = place.camera_t.constant(0.0);
        vec3(zero, zero, zero)
    }

    fn bsdf<R: Real>(&self, place: &ShadingPoint<R>) -> Bsdf<R> {
        Bsdf::black(place.camera_t)
    }

    fn is_lit(&self) -> bool {
        true
    }
}

fn default_opacity() -> Fraction {
    Fraction::new(1.0).expect("1 is in range")
}
