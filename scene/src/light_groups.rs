//! Light groups: names that lights and objects share, whose light a picture has in layers of its own.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};

use crate::animation::JobAtFrame;
use crate::job::Image;
use crate::lights::LightSource;
use crate::scene::Scene;
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

/// The light groups of a picture, and what belongs to each: as the group's place in the picture's list, or the place after
/// the last for light of no listed group.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct LightGroups {
    names: Vec<LightGroup>,
    /// Of each light.
    pub lights: Vec<usize>,
    /// Of each object.
    pub objects: Vec<usize>,
    /// Of the sky and the background.
    pub sky: usize,
}

impl LightGroups {
    /// The light groups of a picture of a scene; `None` if it has none.
    pub(crate) fn of(image: &Image, scene: &Scene) -> Option<Self> {
        let names = &image.light_groups;
        if names.is_empty() {
            return None;
        }
        let place = |group: Option<&LightGroup>| {
            group.and_then(|group| names.iter().position(|name| name == group)).unwrap_or(names.len())
        };
        let lights: Vec<usize> = scene.lights.iter().map(|light| place(light.group())).collect();
        let sky = scene.sky_lights().next().map_or(names.len(), |index| lights[index]);
        let objects = scene.objects.iter().map(|object| place(object.light_group.as_ref())).collect();
        Some(Self { names: names.clone(), lights, objects, sky })
    }

    /// The place of light of no listed group.
    pub(crate) fn rest(&self) -> usize {
        self.names.len()
    }

    /// Objects of listed groups: the first and the last of those that follow one another, and their group's place.
    pub(crate) fn runs_of_objects(&self) -> Vec<([usize; 2], usize)> {
        let mut runs: Vec<([usize; 2], usize)> = Vec::new();
        for (index, &place) in self.objects.iter().enumerate().filter(|(_, place)| **place < self.rest()) {
            match runs.last_mut().filter(|([_, last], of_last)| *of_last == place && last + 1 == index) {
                Some(([_, last], _)) => *last = index,
                None => runs.push(([index; 2], place)),
            }
        }
        runs
    }
}

impl JobAtFrame<'_> {
    /// The light groups of the frame's picture; `None` if it has none.
    pub(crate) fn light_groups(&self) -> Option<LightGroups> {
        LightGroups::of(self.image(), self.scene())
    }
}
