//! Colors: three channels of linear light, or a string in sRGB.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{Error, MapAccess, SeqAccess, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::Channel;
use crate::real::{Vec3, vec3};
use crate::seek::{FrameTime, Seek, SeekError};

/// A color in linear light; above 1 is allowed. Two are equal if their channels are.
#[derive(Clone, Debug)]
pub struct Color {
    linear: Vec3<f32>,
    /// Its channels, if one of them is animated.
    channels: Option<Box<[Channel; 3]>>,
}

impl Color {
    /// The color with these channels.
    pub const fn new(red: f32, green: f32, blue: f32) -> Self {
        Self { linear: vec3(red, green, blue), channels: None }
    }

    /// Red, green, blue, in linear light.
    pub fn get(&self) -> Vec3<f32> {
        self.linear
    }

    /// Whether any of its channels is animated.
    pub fn is_animated(&self) -> bool {
        self.channels.is_some()
    }

    /// Whether it is black in every frame, so that a formula may leave its term out.
    pub fn is_black(&self) -> bool {
        self.linear == vec3(0.0, 0.0, 0.0) && !self.is_animated()
    }
}

fn light_of(channels: &[Channel; 3]) -> Vec3<f32> {
    let [red, green, blue] = channels;
    vec3(red.get(), green.get(), blue.get())
}

impl Seek for Color {
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        let Self { linear: light, channels: Some(channels) } = self else { return Ok(false) };
        channels.seek(clock)?;
        *light = light_of(channels);
        Ok(true)
    }
}

impl PartialEq for Color {
    fn eq(&self, other: &Self) -> bool {
        self.linear == other.linear
    }
}

/// Deserializes `[r, g, b]` in linear light or `"#rrggbb"` in sRGB.
struct ColorVisitor;

impl<'de> Visitor<'de> for ColorVisitor {
    type Value = Color;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a color: [red, green, blue] in linear light, or \"#rrggbb\" in sRGB")
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Color, E> {
        let wrong = || E::invalid_value(Unexpected::Str(text), &self);
        let digits = text.strip_prefix('#').filter(|d| d.len() == 6 && d.bytes().all(|b| b.is_ascii_hexdigit()));
        let code = u32::from_str_radix(digits.ok_or_else(wrong)?, 16).map_err(|_| wrong())?;
        let channel = |shift: u32| crate::color::linear_from_srgb((code >> shift & 0xff) as f32 / 255.0);
        Ok(Color::new(channel(16), channel(8), channel(0)))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut channels: A) -> Result<Color, A::Error> {
        let mut next = |n: usize| channels.next_element::<Channel>()?.ok_or_else(|| A::Error::invalid_length(n, &self));
        let read = [next(0)?, next(1)?, next(2)?];
        let light = light_of(&read);
        let color = Color { linear: light, channels: read.iter().any(Channel::is_animated).then(|| Box::new(read)) };
        if channels.next_element::<serde::de::IgnoredAny>()?.is_some() {
            return Err(A::Error::invalid_length(4, &self));
        }
        Ok(color)
    }

    fn visit_map<A: MapAccess<'de>>(self, _: A) -> Result<Color, A::Error> {
        Err(A::Error::custom(
            "takes no texture: write [red, green, blue], where a channel may be a track; a material's colors take textures",
        ))
    }
}

impl<'de> Deserialize<'de> for Color {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ColorVisitor)
    }
}

impl Serialize for Color {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match &self.channels {
            Some(channels) => channels.serialize(serializer),
            None => <[f32; 3]>::from(self.linear).serialize(serializer),
        }
    }
}

impl JsonSchema for Color {
    fn schema_name() -> Cow<'static, str> {
        "Color".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let channel = generator.subschema_for::<Channel>();
        json_schema!({
            "description": "A color: red, green, blue in linear light, or \"#rrggbb\" in sRGB.",
            "anyOf": [
                { "type": "array", "items": channel, "minItems": 3, "maxItems": 3 },
                { "type": "string", "pattern": "^#[0-9a-fA-F]{6}$" }
            ]
        })
    }
}
