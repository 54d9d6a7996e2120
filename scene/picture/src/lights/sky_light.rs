//! Ambient light from the background.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{AmbientLight, Light, LightOptions, LightSample, LightSource, default_shadow, default_strength};
use crate::backgrounds::{Background, Day};
use crate::kinds::NodeError;
use crate::light_groups::LightGroup;
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::Strength;

/// Light from all directions, with the background's radiance.
///
/// With shadows, each sample takes one direction, chosen by the cosine. Without shadows, a color or a gradient is
/// integrated in closed form, and `ambient_occlusion` darkens it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct SkyLight {
    /// Factor of the environment's radiance.
    #[serde(default = "default_strength")]
    pub strength: Strength,
    /// Background that emits the light; the scene's `environment` or background when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from: Option<Background>,
    /// Whether objects cast shadows in this light.
    #[serde(default = "default_shadow")]
    pub shadow: bool,
    /// Light group, whose light an EXR has in layers of its own (`image.light_groups`).
    #[serde(default, skip_serializing)]
    pub group: Option<LightGroup>,
}

impl Light {
    /// The ambient light of this light in front of the background, if it is one.
    pub fn ambient<'a>(&'a self, background: &'a Background) -> Option<AmbientLight<'a>> {
        let Self::Sky(sky) = self else { return None };
        Some(AmbientLight { from: sky.from.as_ref().unwrap_or(background), strength: sky.strength.in_frame() })
    }
}

impl LightSource for SkyLight {
    const EXAMPLE: &'static str = r#"{ "strength": 2 }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "strength": 2, "shadow": false }"#,
        r##"{ "from": { "gradient": { "bottom": "#e0863c", "top": "#b8d4ff" } } }"##,
    ];

    fn sample<R: Real>(
        &self,
        _: Vec3<R>,
        _: R,
        _: Option<&Day>,
        _: impl FnOnce() -> (R, R),
    ) -> Option<(LightSample<R>, R)> {
        None
    }

    fn options(&self) -> LightOptions<'_> {
        LightOptions { group: self.group.as_ref(), casts_shadows: self.shadow, is_dark: self.strength.is_zero() }
    }

    fn is_of_environment(&self) -> bool {
        true
    }

    /// It is met by rays that meet nothing else.
    fn strength<R: Real>(&self, p: Vec3<R>, _: Option<&Day>) -> R {
        p.x.constant(0.0)
    }

    fn validate(&self, background: &Background) -> Option<NodeError> {
        match &self.from {
            None => background.is_transparent().then(|| {
                NodeError::new(
                    "",
                    "uses the scene's background, which is transparent: set `from` or the scene's `environment` to a color, a gradient or a day",
                )
            }),
            Some(from) if from.is_transparent() => {
                Some(NodeError::new("from", "emits no light: choose a color, a gradient or a day"))
            }
            Some(from) => from.fault().map(|fault| fault.inside("from")),
        }
    }

    fn precompute(&mut self) {
        self.from.iter_mut().for_each(Background::precompute);
    }
}
