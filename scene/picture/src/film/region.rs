//! Region: the part of a picture that is rendered.

use std::borrow::Cow;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};

use super::ImageSpec;
use crate::limits::MAX_EDGE_PX;
use crate::seek::{FrameTime, Seek, SeekError};
use crate::values::integer_in_range;

/// The part of a picture that is rendered, in pixels: `[x, y, width, height]` from the picture's top left.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Region {
    /// Left column.
    pub x: u32,
    /// Top row.
    pub y: u32,
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
}

impl ImageSpec {
    /// The part of the picture that is rendered.
    pub fn rendered(&self) -> Region {
        self.region.unwrap_or(Region { x: 0, y: 0, width: self.width, height: self.height })
    }

    /// The message about a region that is not within the picture.
    pub fn region_error(&self) -> Option<String> {
        let Region { x, y, width, height } = self.rendered();
        let is_inside =
            |start: u32, length: u32, full: u32| length > 0 && u64::from(start) + u64::from(length) <= full.into();
        let is_valid = is_inside(x, width, self.width) && is_inside(y, height, self.height);
        (!is_valid).then(|| {
            format!(
                "is not within the picture of {}×{} pixels: write [x, y, width, height], counted from its top left",
                self.width, self.height
            )
        })
    }

    /// Scales the picture, so that its rendered part has this width and height.
    pub fn resize(&mut self, width: u32, height: u32) {
        let Some(region) = &mut self.region else {
            (self.width, self.height) = (width, height);
            return;
        };
        let scale = |length: u32, to: u32, from: u32| {
            u32::try_from(u64::from(length) * u64::from(to) / u64::from(from)).unwrap_or(MAX_EDGE_PX).max(1)
        };
        let start = |start: u32, to: u32, from: u32| (u64::from(start) * u64::from(to) / u64::from(from)) as u32;
        self.width = scale(self.width, width, region.width);
        self.height = scale(self.height, height, region.height);
        region.x = start(region.x, width, region.width);
        region.y = start(region.y, height, region.height);
        (region.width, region.height) = (width, height);
    }
}

/// A number of pixels.
struct Pixels(u32);

impl<'de> Deserialize<'de> for Pixels {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        integer_in_range(deserializer, 0, MAX_EDGE_PX, "pixels").map(Self)
    }
}

impl<'de> Deserialize<'de> for Region {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let [x, y, width, height] = <[Pixels; 4]>::deserialize(deserializer)?.map(|pixels| pixels.0);
        if width == 0 || height == 0 {
            return Err(D::Error::custom("has no pixels: write [x, y, width, height] with a width and height from 1"));
        }
        Ok(Self { x, y, width, height })
    }
}

impl JsonSchema for Region {
    fn schema_name() -> Cow<'static, str> {
        "Region".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "Part of a picture, in pixels: x, y, width and height, from the picture's top left.",
            "type": "array", "minItems": 4, "maxItems": 4,
            "items": { "type": "integer", "minimum": 0, "maximum": MAX_EDGE_PX }
        })
    }
}

impl Seek for Region {
    fn seek(&mut self, _: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        Ok(false)
    }
}
