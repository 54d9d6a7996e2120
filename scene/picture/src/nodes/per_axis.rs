//! One number for each axis; a single number in JSON sets all three.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Error, IntoDeserializer, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use crate::real::Vec3;
use crate::seek::Seek;
use crate::values::{Coordinate, Point};

/// A number for each axis, written as three or as one for all.
#[derive(Clone, Debug, PartialEq, Serialize, Seek)]
pub struct PerAxis(Point);

impl PerAxis {
    /// The numbers in this frame.
    pub fn in_frame(&self) -> Vec3<f32> {
        self.0.in_frame()
    }

    fn all(number: Coordinate) -> Self {
        Self(Point(number.clone(), number.clone(), number))
    }
}

/// Deserializes one number or three.
struct PerAxisVisitor;

impl<'de> Visitor<'de> for PerAxisVisitor {
    type Value = PerAxis;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number for all axes, or three: [x, y, z]")
    }

    fn visit_f64<E: Error>(self, number: f64) -> Result<PerAxis, E> {
        Coordinate::deserialize(number.into_deserializer()).map(PerAxis::all)
    }

    fn visit_i64<E: Error>(self, number: i64) -> Result<PerAxis, E> {
        self.visit_f64(number as f64)
    }

    fn visit_u64<E: Error>(self, number: u64) -> Result<PerAxis, E> {
        self.visit_f64(number as f64)
    }

    fn visit_map<A: MapAccess<'de>>(self, track: A) -> Result<PerAxis, A::Error> {
        Coordinate::deserialize(MapAccessDeserializer::new(track)).map(PerAxis::all)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, numbers: A) -> Result<PerAxis, A::Error> {
        Point::deserialize(SeqAccessDeserializer::new(numbers)).map(PerAxis)
    }
}

impl<'de> Deserialize<'de> for PerAxis {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(PerAxisVisitor)
    }
}

impl JsonSchema for PerAxis {
    fn schema_name() -> Cow<'static, str> {
        "PerAxis".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let number = generator.subschema_for::<Coordinate>();
        json_schema!({
            "description": "A number for all axes, or three: [x, y, z].",
            "anyOf": [number, { "type": "array", "items": number, "minItems": 3, "maxItems": 3 }]
        })
    }
}
