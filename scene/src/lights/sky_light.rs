//! Light from all around.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{AmbientLight, HasExamples, LightSample, LightSource, default_shadow, default_strength};
use crate::backgrounds::{Backdrop, Background, Day};
use crate::nodes::NodeError;
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::Strength;

/// Light from all around, as the background shows it.
///
/// With shadows each sample looks in one direction, chosen by the cosine; without, a color or a gradient
/// is summed in closed form, and `ambient_occlusion` darkens it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct SkyLight {
    /// How bright it is beside what is seen of it.
    #[serde(default = "default_strength")]
    pub strength: Strength,
    /// What shines, where it is not the background.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from: Option<Background>,
    /// Whether things cast shadows in it.
    #[serde(default = "default_shadow")]
    pub shadow: bool,
}

impl HasExamples for SkyLight {
    const EXAMPLE: &'static str = r#"{ "strength": 2 }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "strength": 2, "shadow": false }"#,
        r##"{ "from": { "gradient": { "bottom": "#e0863c", "top": "#b8d4ff" } } }"##,
    ];
}

impl LightSource for SkyLight {
    #[inline(always)]
    fn sample<R: Real>(
        &self,
        _: Vec3<R>,
        _: R,
        _: Option<&Day>,
        _: impl FnOnce() -> (R, R),
    ) -> Option<(LightSample<R>, R)> {
        None
    }

    #[inline(always)]
    fn ambient<'a>(&'a self, background: &'a Background) -> Option<AmbientLight<'a>> {
        Some(AmbientLight { from: self.from.as_ref().unwrap_or(background), strength: self.strength.get() })
    }

    fn casts_shadows(&self) -> bool {
        self.shadow
    }

    fn is_dark(&self) -> bool {
        self.strength.is_zero()
    }

    fn validate(&self, background: &Background) -> Option<NodeError> {
        match &self.from {
            None => background
                .is_transparent()
                .then(|| NodeError::new("", "comes from a background that is transparent: say what shines by `from`")),
            Some(from) if from.is_transparent() => {
                Some(NodeError::new("from", "is nothing that shines: choose a color, a gradient or a day"))
            }
            Some(from) => from.validate().map(|fault| fault.inside("from")),
        }
    }

    fn precompute(&mut self) {
        self.from.iter_mut().for_each(Backdrop::precompute);
    }
}
