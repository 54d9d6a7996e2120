//! Angles of a rotation: three about the fixed axes, or one about an axis.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Error, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::one_or_three::{OneOrThree, Tracked, read_track};
use super::{Degrees, PeekedMap, Rotation, motion};
use crate::seek::Seek;

/// Angles of a rotation.
#[derive(Clone, Debug, PartialEq, Serialize, Seek)]
#[serde(untagged)]
pub enum Angles {
    /// About the fixed x, y and z axes, rotated in this order.
    Fixed(Rotation),
    /// About one axis.
    About(Degrees),
}

impl Angles {
    /// Whether any of the angles is animated.
    pub fn is_animated(&self) -> bool {
        match self {
            Self::Fixed(rotation) => rotation.is_animated(),
            Self::About(degrees) => degrees.is_animated(),
        }
    }
}

impl OneOrThree for Angles {
    type One = Degrees;
    type Three = Degrees;
    const KEY: &'static str = "[seconds, degrees] or [seconds, [x, y, z]]";
    const EXPECTED: &'static str = "an angle, or a list of 3";
    const KINDS: &'static str = "keys of one angle and keys of three";
}

struct AnglesVisitor;

impl<'de> Visitor<'de> for AnglesVisitor {
    type Value = Angles;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of 3 numbers, or one number with an axis")
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<Angles, E> {
        motion::number(value).map(Angles::About)
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<Angles, E> {
        self.visit_f64(value as f64)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<Angles, E> {
        self.visit_f64(value as f64)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<Angles, A::Error> {
        Rotation::deserialize(SeqAccessDeserializer::new(list)).map(Angles::Fixed)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Angles, A::Error> {
        let first = map.next_key::<String>()?;
        let is_formula = first.as_deref() == Some("expr");
        let map = PeekedMap::new(first, map);
        if is_formula {
            return Degrees::deserialize(MapAccessDeserializer::new(map)).map(Angles::About);
        }
        Ok(match read_track::<Angles, _>(map)? {
            Tracked::One(degrees) => Angles::About(degrees),
            Tracked::Three(degrees) => Angles::Fixed(Rotation::new(degrees)),
        })
    }
}

impl<'de> Deserialize<'de> for Angles {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(AnglesVisitor)
    }
}

impl JsonSchema for Angles {
    fn schema_name() -> Cow<'static, str> {
        "Angles".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let (fixed, about) = (generator.subschema_for::<Rotation>(), generator.subschema_for::<Degrees>());
        json_schema!({
            "description": "Angles in degrees: three about the fixed x, y and z axes, rotated in this order, or one about an axis.",
            "anyOf": [fixed, about]
        })
    }
}
