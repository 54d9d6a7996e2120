//! Light from a single point.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{LightOptions, LightSample, LightSource, default_color, default_shadow, strength_of_point};
use crate::backgrounds::Day;
use crate::light_groups::LightGroup;
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::{Color, Point};

/// Light from a point; its strength falls as 1/d².
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct PointLight {
    /// Position of the light.
    pub position: Point,
    /// Its color, and its strength at a distance of 1.
    #[serde(default = "default_color")]
    pub color: Color,
    /// Whether objects cast shadows in this light.
    #[serde(default = "default_shadow")]
    pub shadow: bool,
    /// Light group, whose light an EXR has in layers of its own (`image.light_groups`).
    #[serde(default, skip_serializing)]
    pub group: Option<LightGroup>,
}

impl LightSource for PointLight {
    const EXAMPLE: &'static str = r#"{ "position": [-1.1, 0.9, 1.5], "color": [2.6, 2.3, 1.9] }"#;

    fn sample<R: Real>(
        &self,
        p: Vec3<R>,
        _: R,
        _: Option<&Day>,
        _: impl FnOnce() -> (R, R),
    ) -> Option<(LightSample<R>, R)> {
        let toward = Vec3::uniform(p.x, self.position.get()) - p;
        let distance = toward.length().at_least(1e-6);
        let per_distance = p.x.constant(1.0) / distance;
        let radiance = Vec3::uniform(p.x, self.color.get()) * per_distance.square();
        Some((LightSample { direction: toward * per_distance, radiance }, distance))
    }

    fn options(&self) -> LightOptions<'_> {
        LightOptions { group: self.group.as_ref(), casts_shadows: self.shadow, is_dark: self.color.is_black() }
    }

    fn place(&self) -> Option<(Vec3<f32>, f32)> {
        Some((self.position.in_frame(), 0.0))
    }

    fn strength<R: Real>(&self, p: Vec3<R>, _: Option<&Day>) -> R {
        strength_of_point(p, &self.position, &self.color, 0.0)
    }
}
