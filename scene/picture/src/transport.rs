//! How light travels in a picture: `scene.integrator`.

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};

use crate::limits::MAX_BOUNCES;
use crate::seek::Seek;
use crate::values::integer_in_range;

/// How light travels.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(rename_all = "snake_case")]
pub enum Transport {
    /// Light comes from the lights and the sky; rays go on from mirrors and glass, up to `march.max_bounces` times.
    #[default]
    Direct,
    /// Light travels from surface to surface: path tracing, without bias but for the number of bounces.
    Path(PathSettings),
}

/// Settings of path tracing.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields, default)]
pub struct PathSettings {
    /// Maximum number of surfaces that scatter light between the one that is seen and the one that the light falls on
    /// first. With 0, surfaces are lit by lights, emitting surfaces and the sky alone.
    #[serde(deserialize_with = "max_bounces")]
    #[schemars(range(min = 0, max = MAX_BOUNCES))]
    pub max_bounces: u32,
    /// Whether light goes straight through glass to what it lights, in the color of the glass, instead of being refracted: no
    /// caustics, and less noise. Biased. False when absent.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub straight_shadows: bool,
}

impl Default for PathSettings {
    fn default() -> Self {
        Self { max_bounces: 8, straight_shadows: false }
    }
}

impl Transport {
    /// Whether paths of light are traced.
    pub fn is_path(&self) -> bool {
        matches!(self, Self::Path(_))
    }

    /// Whether it is the default.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

fn max_bounces<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    integer_in_range(deserializer, 0, MAX_BOUNCES, "bounces")
}
