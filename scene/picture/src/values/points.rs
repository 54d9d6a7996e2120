//! Points, directions and rotations: three numbers each, which may have one track.

use std::borrow::Cow;

use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::{Coordinate, Degrees, triple};
use crate::limits::{MAX_LENGTH, MIN_LENGTH};
use crate::real::{Real, Uniform, Vec3, vec3};
use crate::seek::{FrameTime, Seek, SeekError};

/// A point or an offset, in scene units.
#[derive(Clone, Debug, PartialEq, Serialize, Seek)]
pub struct Point(pub Coordinate, pub Coordinate, pub Coordinate);

impl<'de> Deserialize<'de> for Point {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        triple::read(deserializer).map(|[x, y, z]| Self(x, y, z))
    }
}

impl JsonSchema for Point {
    fn schema_name() -> Cow<'static, str> {
        "Point".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let coordinate = generator.subschema_for::<Coordinate>();
        triple::schema("A point or an offset, in scene units.", &coordinate, generator)
    }
}

impl Point {
    /// Its coordinates, for a formula.
    pub fn get(&self) -> Vec3<Uniform> {
        vec3(self.0.get(), self.1.get(), self.2.get())
    }

    /// Its coordinates in this frame.
    pub fn in_frame(&self) -> Vec3<f32> {
        vec3(self.0.in_frame(), self.1.in_frame(), self.2.in_frame())
    }

    /// The nearest point whose coordinates are in range.
    pub fn clamped(p: Vec3<f32>) -> Self {
        let [x, y, z] = <[f32; 3]>::from(p);
        let coordinate = |c: f32| Coordinate { value: c.clamp(-MAX_LENGTH, MAX_LENGTH), motion: None };
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
    /// The direction of the y axis.
    pub fn up() -> Self {
        let up = vec3(0.0, 1.0, 0.0);
        Self { components: Point::clamped(up), unit: up }
    }

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
pub(crate) fn unit_of(given: &Point) -> Option<Vec3<f32>> {
    let numbers = <[f32; 3]>::from(given.in_frame());
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
            *derived = unit_of(given).ok_or_else(|| SeekError::new(NO_LENGTH))?;
        }
        Ok(is_animated)
    }
}

impl<'de> Deserialize<'de> for Direction {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let given = Point::deserialize(deserializer)?;
        let unit = unit_of(&given).ok_or_else(|| D::Error::custom(NO_LENGTH))?;
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
        triple::schema("A direction: three numbers, not all 0, of any length.", &coordinate, generator)
    }
}

/// A rotation about the fixed x, y and z axes, in this order, in degrees: the matrix Rz·Ry·Rx.
#[derive(Clone, Debug, PartialEq)]
pub struct Rotation {
    degrees: [Degrees; 3],
    rows: [Vec3<f32>; 3],
}

impl Rotation {
    /// The rotation by these angles.
    pub(super) fn new(degrees: [Degrees; 3]) -> Self {
        Self { rows: inverse_rows(&degrees), degrees }
    }

    /// Rows of the inverse rotation's matrix.
    pub(crate) fn inverse_rows(&self) -> [Vec3<f32>; 3] {
        self.rows
    }

    /// Whether any of its angles is animated.
    pub fn is_animated(&self) -> bool {
        self.degrees.iter().any(Degrees::is_animated)
    }
}

/// The columns of Rz·Ry·Rx, which are the rows of its inverse.
fn inverse_rows(degrees: &[Degrees; 3]) -> [Vec3<f32>; 3] {
    inverse_rows_of(degrees.each_ref().map(Degrees::in_frame))
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
    let remainder = degrees % 360.0;
    let quarter = (remainder / 90.0).round();
    let (s, c) = Real::sin_cos((remainder - quarter * 90.0) * (std::f32::consts::PI / 180.0));
    match (quarter as i32).rem_euclid(4) {
        0 => (s, c),
        1 => (c, -s),
        2 => (-s, -c),
        _ => (-c, s),
    }
}

impl<'de> Deserialize<'de> for Rotation {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        triple::read(deserializer).map(Self::new)
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
        let about = "Angles in degrees about the fixed x, y and z axes, rotated in this order.";
        triple::schema_without_path(about, &degrees, generator)
    }
}
