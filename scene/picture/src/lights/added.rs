//! Light that exists in unit tests alone: shows what adding one takes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{LightOptions, LightSample, LightSource};
use crate::backgrounds::Day;
use crate::light_groups::LightGroup;
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::{Color, Direction};

/// Light from a distant source that gets weaker with height and casts no shadows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct AddedLight {
    /// Direction toward the light.
    pub direction: Direction,
    /// Its color at height 0.
    pub color: Color,
    /// Light group, whose light an EXR has in layers of its own (`image.light_groups`).
    #[serde(default, skip_serializing)]
    pub group: Option<LightGroup>,
}

impl LightSource for AddedLight {
    const EXAMPLE: &str = r#"{ "direction": [0.2, 0.3, 1], "color": [0.5, 0.9, 0.4] }"#;

    fn sample<R: Real>(
        &self,
        p: Vec3<R>,
        farthest: R,
        _: Option<&Day>,
        _: impl FnOnce() -> (R, R),
    ) -> Option<(LightSample<R>, R)> {
        let one = p.x.constant(1.0);
        let radiance = Vec3::uniform(p.x, self.color.get()) * (one / (p.y.square() + one));
        Some((LightSample { direction: Vec3::uniform(p.x, self.direction.unit()), radiance }, farthest))
    }

    fn options(&self) -> LightOptions<'_> {
        LightOptions { group: self.group.as_ref(), casts_shadows: false, is_dark: self.color.is_black() }
    }

    fn strength<R: Real>(&self, p: Vec3<R>, _: Option<&Day>) -> R {
        p.x.uniform(self.color.in_frame().mean()) / (p.y.square() + 1.0)
    }
}
