//! Light of the sun, for a background with a sun.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{LightOptions, LightSample, LightSource, default_shadow, default_strength, sample_cone};
use crate::backgrounds::{Background, Day};
use crate::kinds::NodeError;
use crate::light_groups::LightGroup;
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::{FullAngle, Strength};

/// The sun of the background's `day`, which decides its direction and color.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Sun {
    /// Factor of the sun's radiance.
    #[serde(default = "default_strength")]
    pub strength: Strength,
    /// Angular diameter of the sun, in degrees.
    #[serde(default = "default_angle")]
    pub angle: FullAngle,
    /// Whether objects cast shadows in this light.
    #[serde(default = "default_shadow")]
    pub shadow: bool,
    /// Light group, whose light an EXR has in layers of its own (`image.light_groups`).
    #[serde(default, skip_serializing)]
    pub group: Option<LightGroup>,
}

impl LightSource for Sun {
    const EXAMPLE: &'static str = "{}";
    const MORE_EXAMPLES: &'static [&'static str] = &[r#"{ "strength": 0.6, "angle": 9 }"#];

    fn sample<R: Real>(
        &self,
        p: Vec3<R>,
        farthest: R,
        day: Option<&Day>,
        pair: impl FnOnce() -> (R, R),
    ) -> Option<(LightSample<R>, R)> {
        let day = day?;
        let direction = sample_cone(p.x, day.sun.unit(), &self.angle, pair);
        let (color, strength) = (day.sun_color(), self.strength.in_frame());
        let radiance = Vec3::uniform(p.x, color.map(|channel| channel * strength));
        Some((LightSample { direction, radiance }, farthest))
    }

    fn options(&self) -> LightOptions<'_> {
        LightOptions { group: self.group.as_ref(), casts_shadows: self.shadow, is_dark: self.strength.is_zero() }
    }

    fn is_of_environment(&self) -> bool {
        true
    }

    fn strength<R: Real>(&self, p: Vec3<R>, day: Option<&Day>) -> R {
        day.map_or(p.x.constant(0.0), |day| p.x.uniform(day.sun_color().mean() * self.strength.get()))
    }

    fn validate(&self, background: &Background) -> Option<NodeError> {
        background.day().is_none().then(|| {
            NodeError::new(
                "",
                "needs a sky with a sun: make the background or the `environment` a `day`, or use a `directional` light",
            )
        })
    }
}

fn default_angle() -> FullAngle {
    FullAngle::new(0.53).expect("0.53 is in range")
}
