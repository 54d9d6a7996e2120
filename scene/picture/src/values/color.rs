//! Colors: three channels of linear light, a string in sRGB, or a color temperature.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, SeqAccess, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::track::{self, KeyframeValue, WrittenTrack};
use super::{Channel, ColorTemperature, PeekedMap, triple};
use crate::color::{linear_from_srgb, of_temperature};
use crate::real::{Uniform, Vec3, vec3};
use crate::seek::{FrameTime, Seek, SeekError};

/// A color in linear light; above 1 is allowed. Two are equal if their channels are.
#[derive(Clone, Debug)]
pub struct Color {
    linear: Vec3<f32>,
    /// The numbers that it follows from, if one of them is animated.
    moving: Option<Box<MovingColor>>,
}

/// The numbers of an animated color.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
enum MovingColor {
    Channels([Channel; 3]),
    Temperature { kelvin: ColorTemperature },
}

impl MovingColor {
    fn light(&self) -> Vec3<f32> {
        match self {
            Self::Channels(channels) => light_of(channels),
            Self::Temperature { kelvin } => of_temperature(kelvin.in_frame()),
        }
    }
}

impl Color {
    /// The color with these channels.
    pub const fn new(red: f32, green: f32, blue: f32) -> Self {
        Self { linear: vec3(red, green, blue), moving: None }
    }

    /// Red, green, blue, in linear light, for a formula.
    pub fn get(&self) -> Vec3<Uniform> {
        self.linear.into()
    }

    /// Red, green, blue, in linear light, in this frame.
    pub fn in_frame(&self) -> Vec3<f32> {
        self.linear
    }

    /// Whether any of its numbers is animated.
    pub fn is_animated(&self) -> bool {
        self.moving.is_some()
    }

    /// Red, green, blue, in linear light; `None` if any of its numbers is animated.
    pub fn constant(&self) -> Option<Vec3<f32>> {
        self.moving.is_none().then_some(self.linear)
    }

    /// Whether it is black in every frame, so that a formula may leave its term out.
    pub(crate) fn is_black(&self) -> bool {
        self.constant() == Some(vec3(0.0, 0.0, 0.0))
    }
}

fn light_of(channels: &[Channel; 3]) -> Vec3<f32> {
    let [red, green, blue] = channels;
    vec3(red.in_frame(), green.in_frame(), blue.in_frame())
}

impl Seek for Color {
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        let Self { linear, moving: Some(moving) } = self else { return Ok(false) };
        match &mut **moving {
            MovingColor::Channels(channels) => channels.seek(clock)?,
            MovingColor::Temperature { kelvin } => kelvin.seek(clock).map_err(|error| error.inside("kelvin"))?,
        };
        *linear = moving.light();
        Ok(true)
    }
}

impl PartialEq for Color {
    fn eq(&self, other: &Self) -> bool {
        self.linear == other.linear
    }
}

/// The color of channels.
fn of_channels(channels: [Channel; 3]) -> Color {
    let linear = light_of(&channels);
    let is_animated = channels.iter().any(Channel::is_animated);
    Color { linear, moving: is_animated.then(|| Box::new(MovingColor::Channels(channels))) }
}

/// The color of a string: `#rrggbb`, `#rgb` or `rgb(red, green, blue)`, each 0 to 255 or a percentage; all in sRGB.
fn of_text(text: &str) -> Option<Color> {
    let srgb = if let Some(digits) = text.strip_prefix('#') {
        let code = u32::from_str_radix(digits, 16).ok().filter(|_| digits.bytes().all(|b| b.is_ascii_hexdigit()))?;
        match digits.len() {
            6 => [16, 8, 0].map(|shift| (code >> shift & 0xff) as f32 / 255.0),
            3 => [8, 4, 0].map(|shift| (code >> shift & 0xf) as f32 / 15.0),
            _ => return None,
        }
    } else {
        let numbers = text.strip_prefix("rgb(")?.strip_suffix(')')?;
        let mut numbers = numbers.split([',', ' ']).filter(|number| !number.is_empty()).map(|number| {
            let (digits, most) = number.strip_suffix('%').map_or((number, 255.0), |digits| (digits, 100.0));
            digits.parse::<f32>().ok().filter(|value| (0.0..=most).contains(value)).map(|value| value / most)
        });
        let srgb = [numbers.next()??, numbers.next()??, numbers.next()??];
        if numbers.next().is_some() {
            return None;
        }
        srgb
    };
    let [red, green, blue] = srgb.map(linear_from_srgb);
    Some(Color::new(red, green, blue))
}

/// Deserializes a color: a list, a string, or an object.
struct ColorVisitor;

impl<'de> Visitor<'de> for ColorVisitor {
    type Value = Color;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(
            "a color: [red, green, blue] in linear light, or \"#rrggbb\", \"#rgb\" or \"rgb(255, 128, 0)\" in sRGB",
        )
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Color, E> {
        of_text(text).ok_or_else(|| E::invalid_value(Unexpected::Str(text), &self))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut channels: A) -> Result<Color, A::Error> {
        let mut next = |n: usize| channels.next_element::<Channel>()?.ok_or_else(|| A::Error::invalid_length(n, &self));
        let color = of_channels([next(0)?, next(1)?, next(2)?]);
        if channels.next_element::<serde::de::IgnoredAny>()?.is_some() {
            return Err(A::Error::invalid_length(4, &self));
        }
        Ok(color)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Color, A::Error> {
        let first = map.next_key::<String>()?;
        let key = first.clone().unwrap_or_default();
        let map = MapAccessDeserializer::new(PeekedMap::new(first, map));
        match key.as_str() {
            "keys" | "ease" | "loop" => {
                let written = WrittenTrack::<KeyframeColor>::deserialize(map)?;
                triple::of_track(&written, |key, axis| <[f32; 3]>::from(key.0.in_frame())[axis]).map(of_channels)
            }
            "kelvin" => {
                let WrittenTemperature { kelvin } = WrittenTemperature::deserialize(map)?;
                let linear = of_temperature(kelvin.in_frame());
                let moving = kelvin.is_animated().then(|| Box::new(MovingColor::Temperature { kelvin }));
                Ok(Color { linear, moving })
            }
            "expr" => Err(A::Error::custom("must be [red, green, blue], each of which may be a formula")),
            other => Err(A::Error::custom(format_args!(
                "must be a color: [red, green, blue], \"#rrggbb\", {{\"kelvin\": number}}, or a track: {{\"keys\": [[seconds, color], …]}}, not an object with the key \"{other}\""
            ))),
        }
    }
}

/// A color temperature as it is parsed.
#[derive(Deserialize)]
#[serde(rename = "Temperature", deny_unknown_fields)]
struct WrittenTemperature {
    kelvin: ColorTemperature,
}

/// A keyframe's color, which cannot be a track.
struct KeyframeColor(Color);

impl KeyframeValue for KeyframeColor {
    const KEY: &'static str = "[seconds, color]";
}

impl<'de> Deserialize<'de> for KeyframeColor {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let color = Color::deserialize(deserializer)?;
        if color.is_animated() {
            return Err(D::Error::custom("is a keyframe's color, and cannot be a track: write one color"));
        }
        Ok(Self(color))
    }
}

impl<'de> Deserialize<'de> for Color {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ColorVisitor)
    }
}

impl Serialize for Color {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match &self.moving {
            Some(moving) => moving.serialize(serializer),
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
        let track = generator.subschema_for::<ColorTrack>();
        let kelvin = generator.subschema_for::<ColorTemperature>();
        json_schema!({
            "description": "A color: red, green, blue in linear light; \"#rrggbb\", \"#rgb\" or \"rgb(255, 128, 0)\" in sRGB; a color temperature; or a track of colors.",
            "anyOf": [
                { "type": "array", "items": channel, "minItems": 3, "maxItems": 3 },
                plain_text(),
                {
                    "type": "object", "properties": { "kelvin": kelvin }, "required": ["kelvin"], "additionalProperties": false,
                    "description": "The color of a black body, its brightest channel 1.", "examples": [{ "kelvin": 3200 }]
                },
                track
            ]
        })
    }
}

fn plain_text() -> Schema {
    json_schema!({
        "type": "string", "pattern": "^(#[0-9a-fA-F]{6}|#[0-9a-fA-F]{3}|rgb\\([0-9., %]+\\))$", "examples": ["#e07a3c"]
    })
}

/// Schema of a color over time.
struct ColorTrack;

impl JsonSchema for ColorTrack {
    fn schema_name() -> Cow<'static, str> {
        "ColorTrack".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let value = json_schema!({ "anyOf": [
            { "type": "array", "items": { "type": "number" }, "minItems": 3, "maxItems": 3 },
            plain_text(),
            {
                "type": "object", "properties": { "kelvin": { "type": "number" } }, "required": ["kelvin"],
                "description": "The color of a black body, its brightest channel 1.", "examples": [{ "kelvin": 3200 }]
            }
        ] });
        let example = ["#e07a3c".into(), "#3c7ae0".into()];
        track::schema("A color over time, interpolated in linear light.", &value, example, generator)
    }
}
