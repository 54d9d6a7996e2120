//! Numbers with a meaning: validated once, when they are parsed.
//!
//! Each type is one kind of number of a job file, with its range in the type and in the schema. A number may have a
//! motion, a track or a formula. It then stores it next to its value at one time, and `Seek` evaluates it at another. All
//! frames share one compiled program, so code that branches on a number's value asks for its `constant()`.
//! `get` is for formulas, which take it as a [`Uniform`]; only `in_frame` tells host code the value in one frame.

mod angles;
mod color;
mod focus;
pub mod formula;
mod motion;
mod named_number;
mod one_or_three;
mod path;
mod peeked_map;
mod placement;
mod points;
pub mod track;
mod triple;

use std::borrow::Cow;
use std::fmt;
use std::sync::Arc;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

pub use angles::Angles;
pub use color::Color;
pub use focus::Focus;
pub use named_number::NamedNumber;
pub use points::{Direction, Point, Rotation};
pub(crate) use points::{inverse_rows_of, sin_cos_degrees, unit_of};

use self::motion::{Motion, RangedNumber};
use crate::limits::{MAX_LENGTH, MIN_LENGTH};
use crate::real::Uniform;
use crate::seek::{FrameTime, Seek, SeekError};

pub(crate) use peeked_map::PeekedMap;
pub use placement::Placement;
pub(crate) use placement::inverse_rows_about;

/// Kinds of number that may be animated.
macro_rules! animatable_numbers {
    ($($(#[$doc:meta])* $Name:ident: $is_in_range:expr, $words:literal, $schema:tt;)*) => { $(
        number_type! { $(#[$doc])* $Name: $is_in_range, $words }

        impl $Name {
            /// The number, for a formula.
            pub fn get(&self) -> Uniform {
                self.value.into()
            }

            /// The value in this frame: in another one it may differ.
            pub fn in_frame(&self) -> f32 {
                self.value
            }
        }

        impl<'de> Deserialize<'de> for $Name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                motion::read(deserializer)
            }
        }

        impl JsonSchema for $Name {
            fn schema_name() -> Cow<'static, str> {
                stringify!($Name).into()
            }

            fn json_schema(generator: &mut SchemaGenerator) -> Schema {
                motion::or_motion(json_schema!($schema), generator)
            }
        }
    )* };
}

/// Kinds of number that are the same in all frames.
macro_rules! constant_numbers {
    ($($(#[$doc:meta])* $Name:ident: $is_in_range:expr, $words:literal, $schema:tt;)*) => { $(
        number_type! { $(#[$doc])* $Name: $is_in_range, $words }

        impl $Name {
            /// The value.
            pub fn get(&self) -> f32 {
                self.value
            }
        }

        impl<'de> Deserialize<'de> for $Name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                motion::read_constant(deserializer)
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

/// A number and, if it is animated, its motion. Two are equal if their values are.
macro_rules! number_type {
    ($(#[$doc:meta])* $Name:ident: $is_in_range:expr, $words:literal) => {
        $(#[$doc])*
        #[derive(Clone, Debug)]
        pub struct $Name {
            value: f32,
            motion: Option<Arc<Motion>>,
        }

        impl $Name {
            /// The number, if it is in range.
            pub fn new(value: f32) -> Option<Self> {
                <Self as RangedNumber>::is_in_range(value).then_some(Self { value, motion: None })
            }

            /// The value, if it is the same in all frames: they share one compiled program.
            pub fn constant(&self) -> Option<f32> {
                self.motion.is_none().then_some(self.value)
            }

            /// Whether a motion gives this number a different value in other frames.
            pub fn is_animated(&self) -> bool {
                self.motion.is_some()
            }

            /// Whether it is 0 in every frame, so that a formula may leave it out.
            pub fn is_zero(&self) -> bool {
                self.constant() == Some(0.0)
            }
        }

        impl RangedNumber for $Name {
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

            fn moving(value: f32, motion: Motion) -> Self {
                Self { value, motion: Some(Arc::new(motion)) }
            }
        }

        impl Seek for $Name {
            #[inline]
            fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, std::boxed::Box<SeekError>> {
                let Some(motion) = &self.motion else { return Ok(false) };
                self.value = motion.at::<Self>(clock).map_err(SeekError::new)?;
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
                motion::write(self.value, self.is_animated(), serializer)
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
    /// Seconds that a camera looks ahead.
    LookAheadSeconds: |v| (0.01..=1000.0).contains(&v), "a time from 0.01 to 1000 seconds",
        { "type": "number", "minimum": 0.01, "maximum": 1000, "description": "A time, in seconds." };
    /// Degrees that a camera leans for each degree per second that its view turns.
    RollFactor: |v| v.abs() <= 100.0, "a factor within ±100",
        { "type": "number", "minimum": -100, "maximum": 100, "description": "Degrees of roll for each degree per second of turning." };
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
    /// The distance of the plane of focus, in scene units.
    FocusDistance: |v| (MIN_LENGTH..=MAX_LENGTH).contains(&v), "a distance ahead of the camera from 1e-6 to 1e6",
        { "type": "number", "minimum": 1e-6, "maximum": 1e6, "description": "A distance ahead of the camera, in scene units." };
    /// An f-number: the focal length over the diameter of the aperture.
    FNumber: |v| (0.1..=1000.0).contains(&v), "an f-number from 0.1 to 1000",
        { "type": "number", "minimum": 0.1, "maximum": 1000, "description": "An f-number: 1.4 is a wide aperture with much blur, 16 is a narrow one." };
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
    /// A color temperature, in kelvin.
    ColorTemperature: |v| (1_700.0..=25_000.0).contains(&v), "a color temperature from 1700 to 25000 kelvin",
        { "type": "number", "minimum": 1700, "maximum": 25000, "description": "A color temperature, in kelvin: a candle 1900, a lamp 2700, noon 5500, shade 8000." };
    /// Turbidity of the air.
    Turbidity: |v| (2.0..=10.0).contains(&v), "a turbidity from 2 to 10",
        { "type": "number", "minimum": 2, "maximum": 10, "description": "Turbidity of the air: 2 is clear, 10 is thick haze." };
}

constant_numbers! {
    /// Frames per second.
    FrameRate: |v| (0.001..=1000.0).contains(&v), "a rate from 0.001 to 1000 frames a second",
        { "type": "number", "minimum": 0.001, "maximum": 1000, "description": "Frames a second." };
    /// The time that a shutter is open, as a fraction of a frame.
    Shutter: |v| (0.0..=1.0).contains(&v), "a fraction of a frame from 0 to 1",
        { "type": "number", "minimum": 0, "maximum": 1, "description": "The time that the shutter is open, as a fraction of a frame." };
    /// Error of a pixel, on the scale of a display from 0 to 1.
    ErrorGoal: |v| (0.0001..=1.0).contains(&v), "an error from 0.0001 to 1",
        { "type": "number", "minimum": 0.0001, "maximum": 1, "description": "Error of a pixel, on the scale of a display from 0 to 1." };
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

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<i64, A::Error> {
        Err(A::Error::custom(match map.next_key::<String>()?.as_deref() {
            Some("expr") => motion::CONSTANT_FORMULA,
            _ => "is a count, which cannot be a track: write one whole number for all frames",
        }))
    }
}

/// Deserializes an integer.
pub fn integer<'de, D: Deserializer<'de>>(d: D) -> Result<i64, D::Error> {
    d.deserialize_any(IntegerVisitor)
}

/// Deserializes an integer `what` from `low` to `high`.
pub(crate) fn integer_in_range<'de, D: Deserializer<'de>>(
    d: D,
    low: u32,
    high: u32,
    what: &str,
) -> Result<u32, D::Error> {
    in_range(integer(d)?, low, high, what)
}

/// An integer `what`, if it is from `low` to `high`.
pub(crate) fn in_range<E: Error>(value: i64, low: u32, high: u32, what: &str) -> Result<u32, E> {
    u32::try_from(value)
        .ok()
        .filter(|value| (low..=high).contains(value))
        .ok_or_else(|| E::custom(format_args!("must be {low} to {high} {what}, not {value}")))
}
