//! Light from a distant source.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{LightOptions, LightSample, LightSource, default_angle, default_color, default_shadow, sample_cone};
use crate::backgrounds::Day;
use crate::light_groups::LightGroup;
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::{Color, Direction, FullAngle};

/// Light from a distant source, the same everywhere.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Directional {
    /// Toward the light; of any length.
    pub direction: Direction,
    /// Its color and strength.
    #[serde(default = "default_color")]
    pub color: Color,
    /// Angular diameter, in degrees: above 0, shadows have soft edges. The sun has 0.53.
    #[serde(default = "default_angle")]
    pub angle: FullAngle,
    /// Whether objects cast shadows in this light.
    #[serde(default = "default_shadow")]
    pub shadow: bool,
    /// Light group, whose light an EXR has in layers of its own (`image.light_groups`).
    #[serde(default, skip_serializing)]
    pub group: Option<LightGroup>,
}

impl LightSource for Directional {
    const ALIASES: &'static [&'static str] = &["distant", "sunlight"];
    const EXAMPLE: &'static str = r#"{ "direction": [-0.5, 0.8, 0.6] }"#;
    const MORE_EXAMPLES: &'static [&'static str] =
        &[r#"{ "direction": [-0.9, 0.5, 0.3], "color": [1, 0.72, 0.42], "angle": 12 }"#];

    fn sample<R: Real>(
        &self,
        p: Vec3<R>,
        farthest: R,
        _: Option<&Day>,
        pair: impl FnOnce() -> (R, R),
    ) -> Option<(LightSample<R>, R)> {
        let direction = sample_cone(p.x, self.direction.unit(), &self.angle, pair);
        let radiance = Vec3::uniform(p.x, self.color.get());
        Some((LightSample { direction, radiance }, farthest))
    }

    fn options(&self) -> LightOptions<'_> {
        LightOptions { group: self.group.as_ref(), casts_shadows: self.shadow, is_dark: self.color.is_black() }
    }

    fn strength<R: Real>(&self, p: Vec3<R>, _: Option<&Day>) -> R {
        p.x.uniform(self.color.in_frame().mean())
    }
}
