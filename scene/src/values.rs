//! Numbers with a meaning: validated once, when they are parsed.
//!
//! Each type is one kind of number of a job file, with its range in the type and in the schema. A number may have a
//! `track`. It then stores the track next to its value at one time, and `Seek` evaluates it at another. Code that
//! branches on a number's value must check `is_animated` first, because all frames share one compiled program.

mod color;
mod peeked_map;
pub(crate) mod track;

use std::borrow::Cow;
use std::fmt;
use std::sync::Arc;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

pub use color::Color;

use self::track::Track;
use crate::limits::{MAX_LENGTH, MIN_LENGTH};
use crate::real::{Real, Vec3, vec3};
use crate::seek::{FrameTime, Seek, SeekError};

pub(crate) use peeked_map::PeekedMap;

/// Kinds of number that may be animated.
macro_rules! animatable_numbers {
    ($($(#[$doc:meta])* $Name:ident: $is_in_range:expr, $words:literal, $schema:tt;)*) => { $(
        number_type! { $(#[$doc])* $Name: $is_in_range, $words }

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

/// Kinds of number that are the same in all frames.
macro_rules! constant_numbers {
    ($($(#[$doc:meta])* $Name:ident: $is_in_range:expr, $words:literal, $schema:tt;)*) => { $(
        number_type! { $(#[$doc])* $Name: $is_in_range, $words }

        impl<'de> Deserialize<'de> for $Name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                track::read_constant(deserializer)
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

/// A number and, if it is animated, its track. Two are equal if their values are.
macro_rules! number_type {
    ($(#[$doc:meta])* $Name:ident: $is_in_range:expr, $words:literal) => {
        $(#[$doc])*
        #[derive(Clone, Debug)]
        pub struct $Name {
            value: f32,
            track: Option<Arc<Track>>,
        }

        impl $Name {
            /// The number, if it is in range.
            pub fn new(value: f32) -> Option<Self> {
                <Self as track::RangedNumber>::is_in_range(value).then_some(Self { value, track: None })
            }

            /// The value.
            pub fn get(&self) -> f32 {
                self.value
            }

            /// Whether a track gives this number a different value in other frames. If so, code must not branch on it:
            /// all frames share one compiled program.
            pub fn is_animated(&self) -> bool {
                self.track.is_some()
            }

            /// Whether it is 0 in every frame, so that a formula may leave it out.
            pub fn is_zero(&self) -> bool {
                self.value == 0.0 && self.track.is_none()
            }
        }

        impl track::RangedNumber for $Name {
            const EXPECTED: &'static str = $words;

            fn is_in_range(value: f32) -> bool {
                let is_in_range: fn(f32) -> bool = $is_in_range;
                is_in_range(value)
            }

            fn in_range(value: f32) -> Option<Self> {
                Self::new(value)
            }

            fn value(&self) -> f32 {
                self.value
            }

            fn on_track(track: Track) -> Self {
                Self { value: track.at(0.0, Self::is_in_range), track: Some(Arc::new(track)) }
            }
        }

        impl Seek for $Name {
            #[inline]
            fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, std::boxed::Box<SeekError>> {
                let Some(track) = &self.track else { return Ok(false) };
                clock.record_keyframes(track.keyframe_times());
                self.value = track.at(clock.seconds, <Self as track::RangedNumber>::is_in_range);
                Ok(true)
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
                track::write(self.value, self.is_animated(), serializer)
            }
        }
    };
}

animatable_numbers! {
    /// A coordinate or an offset, in scene units.
    Coordinate: |v| v.abs() <= MAX_LENGTH, "within ±1e6",
        { "type": "number", "minimum": -1e6, "maximum": 1e6, "description": "A coordinate or an offset, in scene units." };
    /// A size, in scene units.
    Length: |v| (MIN_LENGTH..=MAX_LENGTH).contains(&v), "a size from 1e-6 to 1e6",
        { "type": "number", "minimum": 1e-6, "maximum": 1e6, "description": "A size, in scene units." };
    /// A length that may be 0, in scene units.
    LengthOrZero: |v| v == 0.0 || (MIN_LENGTH..=MAX_LENGTH).contains(&v), "0, or a size from 1e-6 to 1e6",
        { "type": "number", "minimum": 0, "maximum": 1e6, "description": "0, or a size from 1e-6 to 1e6, in scene units." };
    /// The distance between copies, in scene units.
    Spacing: |v| (MIN_LENGTH..=MAX_LENGTH).contains(&v), "a distance from 1e-6 to 1e6, or null along an axis without copies",
        { "type": "number", "minimum": 1e-6, "maximum": 1e6, "description": "The distance between copies, in scene units." };
    /// A fraction from 0 to 1.
    Fraction: |v| (0.0..=1.0).contains(&v), "a fraction from 0 to 1",
        { "type": "number", "minimum": 0, "maximum": 1, "description": "A fraction from 0 to 1." };
    /// A uniform scale.
    ScaleFactor: |v| (1e-6..=1e6).contains(&v), "a factor from 1e-6 to 1e6",
        { "type": "number", "minimum": 1e-6, "maximum": 1e6, "description": "A uniform scale." };
    /// An angle, in degrees.
    Degrees: |v| v.abs() <= 36_000.0, "an angle within ±36000 degrees",
        { "type": "number", "minimum": -36000, "maximum": 36000, "description": "An angle, in degrees." };
    /// Revolutions of a turntable.
    Revolutions: |v| v.abs() <= 1000.0, "a number of revolutions within ±1000",
        { "type": "number", "minimum": -1000, "maximum": 1000, "description": "Revolutions, counter-clockwise from above." };
    /// Exposure: the power of 2 that light is multiplied by.
    ExposureStops: |v| v.abs() <= 20.0, "an exposure within ±20 stops",
        { "type": "number", "minimum": -20, "maximum": 20, "description": "Exposure in stops: n more is 2ⁿ times as bright." };
    /// The angle between the axis of a cone and its side, in degrees.
    AcuteHalfAngle: |v| (0.1..=89.9).contains(&v), "an angle from 0.1 to 89.9 degrees",
        { "type": "number", "minimum": 0.1, "maximum": 89.9, "description": "The angle between the axis of a cone and its side, in degrees." };
    /// Half an opening angle, in degrees.
    HalfAngle: |v| (0.1..=179.9).contains(&v), "half an opening angle from 0.1 to 179.9 degrees",
        { "type": "number", "minimum": 0.1, "maximum": 179.9, "description": "Half an opening angle, in degrees." };
    /// The angle of an arc, in degrees.
    ArcAngle: |v| (0.1..=360.0).contains(&v), "an arc from 0.1 to 360 degrees",
        { "type": "number", "minimum": 0.1, "maximum": 360, "description": "The angle of an arc, in degrees." };
    /// A sweep angle, in degrees.
    SweepAngle: |v| (0.01..=360.0).contains(&v), "an angle from 0.01 to 360 degrees",
        { "type": "number", "minimum": 0.01, "maximum": 360, "description": "A sweep angle, in degrees." };
    /// A vertical field of view, in degrees.
    FieldOfView: |v| (0.01..=179.0).contains(&v), "a field of view from 0.01 to 179 degrees",
        { "type": "number", "minimum": 0.01, "maximum": 179, "description": "A vertical field of view, in degrees." };
    /// Exponent of Phong's cosine: larger gives a narrower highlight.
    Shininess: |v| (1.0..=10_000.0).contains(&v), "an exponent from 1 to 10000",
        { "type": "number", "minimum": 1, "maximum": 10000, "description": "The exponent of Phong's cosine." };
    /// Index of refraction: ratio of the speeds of light outside and inside.
    RefractiveIndex: |v| (1.0..=4.0).contains(&v), "an index of refraction from 1 to 4",
        { "type": "number", "minimum": 1, "maximum": 4, "description": "An index of refraction: air 1, water 1.33, glass 1.5, diamond 2.42." };
    /// The power of a fractal.
    Power: |v| (2.0..=32.0).contains(&v), "a power from 2 to 32",
        { "type": "number", "minimum": 2, "maximum": 32, "description": "The power of a fractal." };
    /// Growth of an iteration of a kaleidoscopic system.
    GrowthFactor: |v| (1.05..=8.0).contains(&v), "a factor from 1.05 to 8",
        { "type": "number", "minimum": 1.05, "maximum": 8, "description": "Growth factor of each iteration." };
    /// The scale of a Mandelbox.
    MandelboxScale: |v| (1.05..=4.0).contains(&v.abs()), "a scale from 1.05 to 4 or from -4 to -1.05",
        { "type": "number", "minimum": -4, "maximum": 4, "not": { "type": "number", "exclusiveMinimum": -1.05, "exclusiveMaximum": 1.05 }, "description": "The scale of a Mandelbox." };
    /// One channel of a color, in linear light.
    Channel: |v| (0.0..=1e6).contains(&v), "an intensity from 0 to 1e6",
        { "type": "number", "minimum": 0, "maximum": 1e6, "description": "One channel of a color, in linear light." };
    /// Ratio of the frequencies of successive octaves of a noise.
    Lacunarity: |v| (1.0..=4.0).contains(&v), "a lacunarity from 1 to 4",
        { "type": "number", "minimum": 1, "maximum": 4, "description": "Ratio of the frequencies of successive octaves of a noise." };
    /// Ratio of the weights of successive octaves of a noise.
    Gain: |v| (0.0..=1.0).contains(&v), "a gain from 0 to 1",
        { "type": "number", "minimum": 0, "maximum": 1, "description": "Ratio of the weights of successive octaves of a noise." };
    /// Factor of a light's brightness.
    Strength: |v| (0.0..=1e6).contains(&v), "a strength from 0 to 1e6",
        { "type": "number", "minimum": 0, "maximum": 1e6, "description": "Factor of a brightness." };
    /// Extinction coefficient: the fraction of the light lost per scene unit.
    Density: |v| (0.0..=1e6).contains(&v), "a density from 0 to 1e6",
        { "type": "number", "minimum": 0, "maximum": 1e6, "description": "The extinction coefficient, per scene unit." };
    /// Anisotropy g, the mean cosine of scattered light: above 0 forward, below 0 back.
    Anisotropy: |v| (-0.95..=0.95).contains(&v), "a mean cosine from -0.95 to 0.95",
        { "type": "number", "minimum": -0.95, "maximum": 0.95, "description": "The mean cosine g of scattered light: above 0 forward, below 0 back." };
    /// The full angle of a cone, in degrees.
    FullAngle: |v| (0.0..=180.0).contains(&v), "an angle from 0 to 180 degrees",
        { "type": "number", "minimum": 0, "maximum": 180, "description": "The full angle of a cone, in degrees." };
    /// Turbidity of the air.
    Turbidity: |v| (2.0..=10.0).contains(&v), "a turbidity from 2 to 10",
        { "type": "number", "minimum": 2, "maximum": 10, "description": "Turbidity of the air: 2 is clear, 10 is thick haze." };
}

constant_numbers! {
    /// Frames per second.
    FrameRate: |v| (0.001..=1000.0).contains(&v), "a rate from 0.001 to 1000 frames a second",
        { "type": "number", "minimum": 0.001, "maximum": 1000, "description": "Frames a second." };
    /// A coordinate or an offset that is the same in all frames, in scene units.
    ConstantCoordinate: |v| v.abs() <= MAX_LENGTH, "within ±1e6",
        { "type": "number", "minimum": -1e6, "maximum": 1e6, "description": "A coordinate or an offset, in scene units, the same in all frames." };
    /// A size that is the same in all frames, in scene units.
    ConstantLength: |v| (MIN_LENGTH..=MAX_LENGTH).contains(&v), "a size from 1e-6 to 1e6",
        { "type": "number", "minimum": 1e-6, "maximum": 1e6, "description": "A size, in scene units, the same in all frames." };
    /// A length that may be 0 and is the same in all frames, in scene units.
    ConstantLengthOrZero: |v| v == 0.0 || (MIN_LENGTH..=MAX_LENGTH).contains(&v), "0, or a size from 1e-6 to 1e6",
        { "type": "number", "minimum": 0, "maximum": 1e6, "description": "0, or a size from 1e-6 to 1e6, in scene units, the same in all frames." };
    /// An angle that is the same in all frames, in degrees.
    ConstantDegrees: |v| v.abs() <= 36_000.0, "an angle within ±36000 degrees",
        { "type": "number", "minimum": -36000, "maximum": 36000, "description": "An angle, in degrees, the same in all frames." };
    /// A uniform scale that is the same in all frames.
    ConstantScale: |v| (1e-6..=1e6).contains(&v), "a factor from 1e-6 to 1e6",
        { "type": "number", "minimum": 1e-6, "maximum": 1e6, "description": "A uniform scale, the same in all frames." };
}

/// Deserializes any integer that JSON can hold.
struct IntegerVisitor;

impl<'de> Visitor<'de> for IntegerVisitor {
    type Value = i64;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a whole number")
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<i64, E> {
        Ok(value)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<i64, E> {
        // A larger value is out of every range.
        Ok(i64::try_from(value).unwrap_or(i64::MAX))
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<i64, E> {
        if value.fract() == 0.0 {
            return Ok(value as i64);
        }
        Err(E::custom(format_args!("must be a whole number, not {value}")))
    }

    fn visit_map<A: MapAccess<'de>>(self, _: A) -> Result<i64, A::Error> {
        Err(A::Error::custom("is a count, which cannot be a track: write one whole number for all frames"))
    }
}

/// Deserializes an integer.
pub(crate) fn integer<'de, D: Deserializer<'de>>(d: D) -> Result<i64, D::Error> {
    d.deserialize_any(IntegerVisitor)
}

/// Deserializes an integer `what` from `low` to `high`.
pub(crate) fn integer_in_range<'de, D: Deserializer<'de>>(
    d: D,
    low: u32,
    high: u32,
    what: &str,
) -> Result<u32, D::Error> {
    let value = integer(d)?;
    u32::try_from(value)
        .ok()
        .filter(|value| (low..=high).contains(value))
        .ok_or_else(|| D::Error::custom(format_args!("must be {low} to {high} {what}, not {value}")))
}

/// A point or an offset, in scene units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
pub struct Point(pub Coordinate, pub Coordinate, pub Coordinate);

impl Point {
    /// Its coordinates.
    pub fn get(&self) -> Vec3<f32> {
        vec3(self.0.get(), self.1.get(), self.2.get())
    }

    /// The nearest point whose coordinates are in range.
    pub(crate) fn clamped(p: Vec3<f32>) -> Self {
        let [x, y, z] = <[f32; 3]>::from(p);
        let coordinate = |c: f32| Coordinate { value: c.clamp(-MAX_LENGTH, MAX_LENGTH), track: None };
        Self(coordinate(x), coordinate(y), coordinate(z))
    }

    /// Whether any of its coordinates is animated.
    pub fn is_animated(&self) -> bool {
        self.0.is_animated() || self.1.is_animated() || self.2.is_animated()
    }
}

/// A direction: three numbers, not all 0, of any length.
#[derive(Clone, Debug, PartialEq)]
pub struct Direction {
    components: Point,
    unit: Vec3<f32>,
}

impl Direction {
    /// The direction of length 1.
    pub fn unit(&self) -> Vec3<f32> {
        self.unit
    }

    /// Whether any of its numbers is animated.
    pub fn is_animated(&self) -> bool {
        self.components.is_animated()
    }
}

/// A point as a direction of length 1; `None` if it is the origin.
fn unit(given: &Point) -> Option<Vec3<f32>> {
    let numbers = <[f32; 3]>::from(given.get());
    let largest = numbers.iter().fold(0.0_f32, |largest, c| largest.max(c.abs()));
    // Scaled first, so that squares neither overflow nor underflow.
    let [x, y, z] = numbers.map(|c| c / largest);
    (largest >= MIN_LENGTH).then(|| vec3(x, y, z).normalize())
}

const NO_LENGTH: &str = "has no length: a direction needs a coordinate that is not 0";

impl Seek for Direction {
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        let Self { components: given, unit: derived } = self;
        let is_animated = given.seek(clock)?;
        if is_animated {
            *derived = unit(given).ok_or_else(|| SeekError::new(NO_LENGTH))?;
        }
        Ok(is_animated)
    }
}

impl<'de> Deserialize<'de> for Direction {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let given = Point::deserialize(deserializer)?;
        let unit = unit(&given).ok_or_else(|| D::Error::custom(NO_LENGTH))?;
        Ok(Self { components: given, unit })
    }
}

impl Serialize for Direction {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.components.serialize(serializer)
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
#[derive(Clone, Debug, PartialEq)]
pub struct Rotation {
    degrees: [Degrees; 3],
    rows: [Vec3<f32>; 3],
}

impl Rotation {
    /// Rows of the inverse rotation's matrix.
    pub fn inverse_rows(&self) -> [Vec3<f32>; 3] {
        self.rows
    }

    /// Whether any of its angles is animated.
    pub fn is_animated(&self) -> bool {
        self.degrees.iter().any(Degrees::is_animated)
    }
}

/// The columns of Rz·Ry·Rx, which are the rows of its inverse.
fn inverse_rows(degrees: &[Degrees; 3]) -> [Vec3<f32>; 3] {
    inverse_rows_of(degrees.each_ref().map(Degrees::get))
}

/// Rows of the inverse of a rotation by these angles in degrees about the fixed x, y and z axes.
pub(crate) fn inverse_rows_of(degrees: [f32; 3]) -> [Vec3<f32>; 3] {
    let [(sx, cx), (sy, cy), (sz, cz)] = degrees.map(sin_cos_degrees);
    [
        vec3(cz * cy, sz * cy, -sy),
        vec3(cz * sy * sx - sz * cx, sz * sy * sx + cz * cx, cy * sx),
        vec3(cz * sy * cx + sz * sx, sz * sy * cx - cz * sx, cy * cx),
    ]
}

impl Seek for Rotation {
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        let Self { degrees, rows } = self;
        let is_animated = degrees.seek(clock)?;
        if is_animated {
            *rows = inverse_rows(degrees);
        }
        Ok(is_animated)
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
        let degrees = <[Degrees; 3]>::deserialize(deserializer)?;
        Ok(Self { rows: inverse_rows(&degrees), degrees })
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
            "description": "Angles in degrees about the fixed x, y and z axes, rotated in this order."
        })
    }
}
