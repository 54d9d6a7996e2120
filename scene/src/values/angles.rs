//! Angles of a rotation: three about the fixed axes, or one about an axis.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Error, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::motion::{self, Motion, OfKind, RangedNumber};
use super::track::{KeyframeValue, WrittenTrack};
use super::{Degrees, PeekedMap, Rotation, triple};
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

/// A keyframe's angle, or its three.
enum KeyframeAngles {
    One(OfKind<Degrees>),
    Three([OfKind<Degrees>; 3]),
}

impl KeyframeValue for KeyframeAngles {
    const KEY: &'static str = "[seconds, degrees] or [seconds, [x, y, z]]";
}

struct KeyframeVisitor;

impl<'de> Visitor<'de> for KeyframeVisitor {
    type Value = KeyframeAngles;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an angle, or a list of 3")
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<KeyframeAngles, E> {
        motion::number(value).map(|angle| KeyframeAngles::One(OfKind(angle)))
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<KeyframeAngles, E> {
        self.visit_f64(value as f64)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<KeyframeAngles, E> {
        self.visit_f64(value as f64)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<KeyframeAngles, A::Error> {
        Deserialize::deserialize(SeqAccessDeserializer::new(list)).map(KeyframeAngles::Three)
    }
}

impl<'de> Deserialize<'de> for KeyframeAngles {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(KeyframeVisitor)
    }
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
        let map = MapAccessDeserializer::new(PeekedMap::new(first, map));
        if is_formula {
            return Degrees::deserialize(map).map(Angles::About);
        }
        let written = WrittenTrack::<KeyframeAngles>::deserialize(map)?;
        let is_one = |key: &KeyframeAngles| matches!(key, KeyframeAngles::One(_));
        if written.values().all(is_one) {
            let one = |key: &KeyframeAngles| match key {
                KeyframeAngles::One(angle) | KeyframeAngles::Three([angle, ..]) => angle.0.value(),
            };
            return Motion::Track(written.track(one)).start().map(Angles::About);
        }
        if written.values().any(is_one) {
            return Err(A::Error::custom("has keys of one angle and keys of three: write the same in all"));
        }
        let three = |key: &KeyframeAngles, axis: usize| match key {
            KeyframeAngles::One(angle) => angle.0.value(),
            KeyframeAngles::Three(angles) => angles[axis].0.value(),
        };
        triple::of_track(&written, three).map(|degrees| Angles::Fixed(Rotation::new(degrees)))
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
