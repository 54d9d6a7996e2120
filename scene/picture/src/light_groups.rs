//! Light groups: names that lights and objects share, whose light a picture has in layers of its own.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};

use crate::seek::{FrameTime, Seek, SeekError};

/// Name of the layers of all light that is of no listed group.
pub const REST: &str = "rest";
/// Maximum number of characters of the name of a light group.
const MAX_GROUP_CHARS: usize = 64;

/// Name of a light group: 1 to 64 letters, digits, `_` and `-`, but not [`REST`].
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct LightGroup(String);

impl LightGroup {
    /// The name.
    pub fn name(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for LightGroup {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}

impl<'de> Deserialize<'de> for LightGroup {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        let is_allowed = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        if name == REST {
            return Err(D::Error::custom("names the light of no listed group: choose another name than \"rest\""));
        }
        if name.is_empty() || name.len() > MAX_GROUP_CHARS || !name.chars().all(is_allowed) {
            return Err(D::Error::custom(format_args!(
                "must be a name of 1 to {MAX_GROUP_CHARS} letters, digits, _ and -, such as \"key\", not {name:?}"
            )));
        }
        Ok(Self(name))
    }
}

impl JsonSchema for LightGroup {
    fn schema_name() -> Cow<'static, str> {
        "LightGroup".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "Name of a light group: letters, digits, _ and -. The name rest is taken.",
            "type": "string",
            "pattern": format!("^(?!{REST}$)[A-Za-z0-9_-]{{1,{MAX_GROUP_CHARS}}}$")
        })
    }
}

impl Seek for LightGroup {
    fn seek(&mut self, _: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        Ok(false)
    }
}
