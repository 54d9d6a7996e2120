//! Region: the part of a picture that is rendered.

use std::borrow::Cow;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};

use super::Image;
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

/// A region, and the size of the whole picture that it is a part of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Crop {
    /// The region.
    pub region: Region,
    /// Width of the whole picture, in pixels.
    pub full_width: u32,
    /// Height of the whole picture, in pixels.
    pub full_height: u32,
}

impl Image {
    /// Renders only the region, if there is one: width and height become the region's.
    pub fn apply_region(&mut self) -> Result<(), String> {
        let Some(region) = self.region.take() else { return Ok(()) };
        let (full_width, full_height) = (self.width, self.height);
        let is_inside =
            |start: u32, length: u32, full: u32| length > 0 && u64::from(start) + u64::from(length) <= full.into();
        if !is_inside(region.x, region.width, full_width) || !is_inside(region.y, region.height, full_height) {
            return Err(format!(
                "is not within the picture of {full_width}×{full_height} pixels: write [x, y, width, height], counted from its top left"
            ));
        }
        (self.width, self.height) = (region.width, region.height);
        self.crop = Some(Crop { region, full_width, full_height });
        Ok(())
    }

    /// Width and height of the whole picture, in pixels; the picture's own if it has no region.
    pub fn full_size(&self) -> [u32; 2] {
        self.crop.map_or([self.width, self.height], |crop| [crop.full_width, crop.full_height])
    }

    /// Column and row of the picture's top left in the whole picture, in pixels.
    pub fn origin(&self) -> [u32; 2] {
        self.crop.map_or([0, 0], |crop| [crop.region.x, crop.region.y])
    }

    /// Scales the picture, and with it the whole picture, to this width and height.
    pub fn resize(&mut self, width: u32, height: u32) {
        if let Some(Crop { region, full_width, full_height }) = &mut self.crop {
            let scale = |length: u32, to: u32, from: u32| {
                u32::try_from(u64::from(length) * u64::from(to) / u64::from(from)).unwrap_or(MAX_EDGE_PX).max(1)
            };
            let start = |start: u32, to: u32, from: u32| (u64::from(start) * u64::from(to) / u64::from(from)) as u32;
            *full_width = scale(*full_width, width, region.width);
            *full_height = scale(*full_height, height, region.height);
            region.x = start(region.x, width, region.width);
            region.y = start(region.y, height, region.height);
            (region.width, region.height) = (width, height);
        }
        (self.width, self.height) = (width, height);
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

macro_rules! constant {
    ($Type:ty) => {
        impl Seek for $Type {
            fn seek(&mut self, _: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
                Ok(false)
            }
        }
    };
}

constant!(Region);
constant!(Crop);
