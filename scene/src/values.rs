//! Numbers with a meaning: parsed once, right ever after.
//!
//! Each type is one kind of number of a job file, with its range in the type and in the schema.
//! A number may be a [`track`]: then it is read as it stands at one time, and knows that it moves.
//! What chooses code by a number must ask that too, since all frames share one compiled program.

mod replayed;
pub(crate) mod track;

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{Error, MapAccess, SeqAccess, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::limits::{MAX_LENGTH, MIN_LENGTH};
use crate::real::{Real, Vec3, vec3};

pub(crate) use replayed::Replayed;

/// A kind of number that may move.
macro_rules! numbers {
    ($($(#[$doc:meta])* $Name:ident: $holds:expr, $words:literal, $schema:tt;)*) => { $(
        number_type! { $(#[$doc])* $Name: $holds, $words }

        impl<'de> Deserialize<'de> for $Name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                track::read(deserializer)
            }
        }

        impl JsonSchema for $Name {
            fn schema_name() -> Cow<'static, str> {
                stringify!($Name).into()
            }

            fn json_schema(generator: &mut SchemaGenerator) -> Schema {
                track::or_track(json_schema!($schema), generator)
            }
        }
    )* };
}

/// A kind of number that is the same in all frames.
macro_rules! still_numbers {
    ($($(#[$doc:meta])* $Name:ident: $holds:expr, $words:literal, $schema:tt;)*) => { $(
        number_type! { $(#[$doc])* $Name: $holds, $words }

        impl<'de> Deserialize<'de> for $Name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                track::read_still(deserializer)
            }
        }

        impl JsonSchema for $Name {
            fn schema_name() -> Cow<'static, str> {
                stringify!($Name).into()
            }

            fn json_schema(_: &mut SchemaGenerator) -> Schema {
                json_schema!($schema)
            }
        }
    )* };
}

/// A number and whether it moves. Two are equal if the numbers are.
macro_rules! number_type {
    ($(#[$doc:meta])* $Name:ident: $holds:expr, $words:literal) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug)]
        pub struct $Name {
            value: f32,
            moves: bool,
        }

        impl $Name {
            /// The number, if it is in range.
            pub fn new(value: f32) -> Option<Self> {
                let holds: fn(f32) -> bool = $holds;
                holds(value).then_some(Self { value, moves: false })
            }

            /// The number.
            #[inline(always)]
            pub fn get(self) -> f32 {
                self.value
            }

            /// Whether it is another one in other frames: then no code may be chosen by it.
            #[inline(always)]
            pub fn is_moving(self) -> bool {
                self.moves
            }
        }

        impl track::Ranged for $Name {
            const WORDS: &'static str = $words;

            fn ranged(value: f32) -> Option<Self> {
                Self::new(value)
            }

            fn value(self) -> f32 {
                self.value
            }

            fn moving(self) -> Self {
                Self { moves: true, ..self }
            }
        }

        impl PartialEq for $Name {
            fn eq(&self, other: &Self) -> bool {
                self.value == other.value
            }
        }

        impl PartialOrd for $Name {
            fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
                self.value.partial_cmp(&other.value)
            }
        }

        impl Serialize for $Name {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                track::write(self.value, self.moves, serializer)
            }
        }
    };
}

numbers! {
    /// A coordinate or an offset, in scene units.
    Coordinate: |v| v.abs() <= MAX_LENGTH, "within ±1e6",
        { "type": "number", "minimum": -1e6, "maximum": 1e6, "description": "A coordinate or an offset, in scene units." };
    /// A size, in scene units.
    Length: |v| (MIN_LENGTH..=MAX_LENGTH).contains(&v), "a size from 1e-6 to 1e6",
        { "type": "number", "minimum": 1e-6, "maximum": 1e6, "description": "A size, in scene units." };
    /// A size that may be nothing, in scene units.
    Amount: |v| v == 0.0 || (MIN_LENGTH..=MAX_LENGTH).contains(&v), "0, or a size from 1e-6 to 1e6",
        { "type": "number", "minimum": 0, "maximum": 1e6, "description": "0, or a size from 1e-6 to 1e6, in scene units." };
    /// A uniform scale.
    Factor: |v| (1e-6..=1e6).contains(&v), "a factor from 1e-6 to 1e6",
        { "type": "number", "minimum": 1e-6, "maximum": 1e6, "description": "A uniform scale." };
    /// An angle, in degrees.
    Degrees: |v| v.abs() <= 36_000.0, "an angle within ±36000 degrees",
        { "type": "number", "minimum": -36000, "maximum": 36000, "description": "An angle, in degrees." };
    /// Turns of a turntable.
    Turns: |v| v.abs() <= 1000.0, "a number of turns within ±1000",
        { "type": "number", "minimum": -1000, "maximum": 1000, "description": "Turns, counter-clockwise from above." };
    /// Exposure: the power of 2 that light is multiplied by.
    Stops: |v| v.abs() <= 20.0, "an exposure within ±20 stops",
        { "type": "number", "minimum": -20, "maximum": 20, "description": "Exposure in stops: n more is 2ⁿ times as bright." };
    /// A vertical field of view, in degrees.
    FieldOfView: |v| (0.01..=179.0).contains(&v), "a field of view from 0.01 to 179 degrees",
        { "type": "number", "minimum": 0.01, "maximum": 179, "description": "A vertical field of view, in degrees." };
    /// How narrow a highlight is: the exponent of Phong's cosine.
    Shininess: |v| (1.0..=10_000.0).contains(&v), "an exponent from 1 to 10000",
        { "type": "number", "minimum": 1, "maximum": 10000, "description": "The exponent of Phong's cosine." };
    /// A share of something.
    Share: |v| (0.0..=1.0).contains(&v), "a share from 0 to 1",
        { "type": "number", "minimum": 0, "maximum": 1, "description": "A share of something." };
    /// How much slower light is inside than outside.
    RefractiveIndex: |v| (1.0..=4.0).contains(&v), "an index of refraction from 1 to 4",
        { "type": "number", "minimum": 1, "maximum": 4, "description": "An index of refraction: air 1, water 1.33, glass 1.5, diamond 2.42." };
    /// The power of a fractal.
    Power: |v| (2.0..=32.0).contains(&v), "a power from 2 to 32",
        { "type": "number", "minimum": 2, "maximum": 32, "description": "The power of a fractal." };
    /// One channel of a colour, in linear light.
    Channel: |v| (0.0..=1e6).contains(&v), "an intensity from 0 to 1e6",
        { "type": "number", "minimum": 0, "maximum": 1e6, "description": "One channel of a colour, in linear light." };
    /// How many times finer each octave of a noise is than the one before.
    Lacunarity: |v| (1.0..=4.0).contains(&v), "a lacunarity from 1 to 4",
        { "type": "number", "minimum": 1, "maximum": 4, "description": "How many times finer each octave of a noise is than the one before." };
    /// How many times as strong each octave of a noise is as the one before.
    Gain: |v| (0.0..=1.0).contains(&v), "a gain from 0 to 1",
        { "type": "number", "minimum": 0, "maximum": 1, "description": "How many times as strong each octave of a noise is as the one before." };
}

still_numbers! {
    /// Frames a second.
    FrameRate: |v| (0.001..=1000.0).contains(&v), "a rate from 0.001 to 1000 frames a second",
        { "type": "number", "minimum": 0.001, "maximum": 1000, "description": "Frames a second." };
}

impl Amount {
    /// Whether it is nothing in every frame: then what it would do may be left out.
    #[inline(always)]
    pub fn is_zero(self) -> bool {
        self.value == 0.0 && !self.moves
    }
}

/// Reads any whole number that JSON can hold.
struct Whole;

impl<'de> Visitor<'de> for Whole {
    type Value = i64;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a whole number")
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<i64, E> {
        Ok(value)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<i64, E> {
        // Whatever is larger is out of every range.
        Ok(i64::try_from(value).unwrap_or(i64::MAX))
    }

    fn visit_map<A: MapAccess<'de>>(self, _: A) -> Result<i64, A::Error> {
        Err(A::Error::custom("is a count, which can't be a track: write one whole number for all frames"))
    }
}

/// Reads a whole number.
pub(crate) fn integer<'de, D: Deserializer<'de>>(d: D) -> Result<i64, D::Error> {
    d.deserialize_any(Whole)
}

/// Reads a whole number of `what` from `low` to `high`.
pub(crate) fn whole<'de, D: Deserializer<'de>>(d: D, low: u32, high: u32, what: &str) -> Result<u32, D::Error> {
    let value = integer(d)?;
    u32::try_from(value)
        .ok()
        .filter(|value| (low..=high).contains(value))
        .ok_or_else(|| D::Error::custom(format_args!("must be {low} to {high} {what}, not {value}")))
}

/// A point or an offset, in scene units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Point(pub Coordinate, pub Coordinate, pub Coordinate);

impl Point {
    /// Its coordinates.
    #[inline(always)]
    pub fn get(self) -> Vec3<f32> {
        vec3(self.0.get(), self.1.get(), self.2.get())
    }

    /// The point in range that is nearest to another.
    pub(crate) fn nearest(p: Vec3<f32>) -> Self {
        let [x, y, z] = <[f32; 3]>::from(p);
        let coordinate = |c: f32| Coordinate { value: c.clamp(-MAX_LENGTH, MAX_LENGTH), moves: false };
        Self(coordinate(x), coordinate(y), coordinate(z))
    }

    /// Whether any of them moves.
    pub fn is_moving(self) -> bool {
        self.0.is_moving() || self.1.is_moving() || self.2.is_moving()
    }
}

/// A direction: three numbers, not all 0, of any length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Direction {
    given: Point,
    unit: Vec3<f32>,
}

impl Direction {
    /// The direction of length 1.
    #[inline(always)]
    pub fn unit(self) -> Vec3<f32> {
        self.unit
    }

    /// Whether any of its numbers moves.
    pub fn is_moving(self) -> bool {
        self.given.is_moving()
    }
}

impl<'de> Deserialize<'de> for Direction {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let given = Point::deserialize(deserializer)?;
        let numbers = <[f32; 3]>::from(given.get());
        let largest = numbers.iter().fold(0.0_f32, |largest, c| largest.max(c.abs()));
        if largest < MIN_LENGTH {
            return Err(D::Error::custom("has no length: a direction needs a coordinate that is not 0"));
        }
        // Scaled first, so that squares neither overflow nor vanish.
        let [x, y, z] = numbers.map(|c| c / largest);
        Ok(Self { given, unit: vec3(x, y, z).normalize() })
    }
}

impl Serialize for Direction {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.given.serialize(serializer)
    }
}

impl JsonSchema for Direction {
    fn schema_name() -> Cow<'static, str> {
        "Direction".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let coordinate = generator.subschema_for::<Coordinate>();
        json_schema!({
            "type": "array", "items": coordinate, "minItems": 3, "maxItems": 3,
            "description": "A direction: three numbers, not all 0, of any length."
        })
    }
}

/// A rotation about the fixed x, y and z axes, in this order, in degrees: the matrix Rz·Ry·Rx.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotation {
    degrees: [Degrees; 3],
    rows: [Vec3<f32>; 3],
}

impl Rotation {
    /// The rows of the inverse rotation's matrix: multiplied with a point they turn it back.
    #[inline(always)]
    pub fn inverse_rows(self) -> [Vec3<f32>; 3] {
        self.rows
    }

    /// Whether any of its angles moves.
    pub fn is_moving(self) -> bool {
        self.degrees.iter().any(|angle| angle.is_moving())
    }

    fn new(degrees: [Degrees; 3]) -> Self {
        let [(sx, cx), (sy, cy), (sz, cz)] = degrees.map(|angle| sin_cos_degrees(angle.get()));
        // The columns of Rz·Ry·Rx, which are the rows of its inverse.
        let rows = [
            vec3(cz * cy, sz * cy, -sy),
            vec3(cz * sy * sx - sz * cx, sz * sy * sx + cz * cx, cy * sx),
            vec3(cz * sy * cx + sz * sx, sz * sy * cx - cz * sx, cy * cx),
        ];
        Self { degrees, rows }
    }
}

/// Sine and cosine of an angle in degrees; exact at quarter turns.
pub(crate) fn sin_cos_degrees(degrees: f32) -> (f32, f32) {
    let turned = degrees % 360.0;
    let quarter = (turned / 90.0).round();
    let (s, c) = Real::sin_cos((turned - quarter * 90.0) * (std::f32::consts::PI / 180.0));
    match (quarter as i32).rem_euclid(4) {
        0 => (s, c),
        1 => (c, -s),
        2 => (-s, -c),
        _ => (-c, s),
    }
}

impl<'de> Deserialize<'de> for Rotation {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        <[Degrees; 3]>::deserialize(deserializer).map(Self::new)
    }
}

impl Serialize for Rotation {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.degrees.serialize(serializer)
    }
}

impl JsonSchema for Rotation {
    fn schema_name() -> Cow<'static, str> {
        "Rotation".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let degrees = generator.subschema_for::<Degrees>();
        json_schema!({
            "type": "array", "items": degrees, "minItems": 3, "maxItems": 3,
            "description": "Angles in degrees about the fixed x, y and z axes, turned in this order."
        })
    }
}

/// A colour in linear light; above 1 is allowed. Two are equal if their channels are.
#[derive(Clone, Copy, Debug)]
pub struct Color {
    light: Vec3<f32>,
    moves: bool,
}

impl Color {
    /// The colour with these channels.
    pub const fn new(red: f32, green: f32, blue: f32) -> Self {
        Self { light: vec3(red, green, blue), moves: false }
    }

    /// Red, green, blue, in linear light.
    #[inline(always)]
    pub fn get(self) -> Vec3<f32> {
        self.light
    }

    /// Whether any of its channels moves.
    #[inline(always)]
    pub fn is_moving(self) -> bool {
        self.moves
    }

    /// Whether it is black in every frame: then what it would colour may be left out.
    #[inline(always)]
    pub fn is_black(self) -> bool {
        self.light == vec3(0.0, 0.0, 0.0) && !self.moves
    }
}

impl PartialEq for Color {
    fn eq(&self, other: &Self) -> bool {
        self.light == other.light
    }
}

/// Reads `[r, g, b]` in linear light or `"#rrggbb"` in sRGB.
struct ColorVisitor;

impl<'de> Visitor<'de> for ColorVisitor {
    type Value = Color;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a colour: [red, green, blue] in linear light, or \"#rrggbb\" in sRGB")
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
        let [red, green, blue] = [next(0)?, next(1)?, next(2)?];
        let moves = red.is_moving() || green.is_moving() || blue.is_moving();
        let color = Color { moves, ..Color::new(red.get(), green.get(), blue.get()) };
        if channels.next_element::<serde::de::IgnoredAny>()?.is_some() {
            return Err(A::Error::invalid_length(4, &self));
        }
        Ok(color)
    }

    fn visit_map<A: MapAccess<'de>>(self, _: A) -> Result<Color, A::Error> {
        Err(A::Error::custom(
            "takes no texture: write [red, green, blue], where a channel may be a track; a material's colours take textures",
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
        let channel = |value| Channel { value, moves: self.moves };
        [channel(self.light.x), channel(self.light.y), channel(self.light.z)].serialize(serializer)
    }
}

impl JsonSchema for Color {
    fn schema_name() -> Cow<'static, str> {
        "Color".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let channel = generator.subschema_for::<Channel>();
        json_schema!({
            "description": "A colour: red, green, blue in linear light, or \"#rrggbb\" in sRGB.",
            "anyOf": [
                { "type": "array", "items": channel, "minItems": 3, "maxItems": 3 },
                { "type": "string", "pattern": "^#[0-9a-fA-F]{6}$" }
            ]
        })
    }
}
