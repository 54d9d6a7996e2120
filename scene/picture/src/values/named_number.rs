//! Numbers with a name, as they are written. They are in the formulas already when a job is parsed, so only their form is
//! checked here.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::PeekedMap;
use super::motion::FormulaSchema;
use super::track::{Track, TrackSchema};

/// A number with a name: a number, a formula as text, or a track.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum NamedNumber {
    /// A number.
    Number(f32),
    /// A formula.
    Formula(String),
    /// A track.
    Track(Track),
}

struct NamedNumberVisitor;

impl<'de> Visitor<'de> for NamedNumberVisitor {
    type Value = NamedNumber;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number, a formula as text, or a track")
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<NamedNumber, E> {
        let number = value as f32;
        if !number.is_finite() {
            return Err(E::custom(format_args!("{value:e} is too large: numbers go up to 3.4e38")));
        }
        Ok(NamedNumber::Number(number))
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<NamedNumber, E> {
        Ok(NamedNumber::Number(value as f32))
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<NamedNumber, E> {
        Ok(NamedNumber::Number(value as f32))
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<NamedNumber, E> {
        Ok(NamedNumber::Formula(text.to_owned()))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<NamedNumber, A::Error> {
        let first = map.next_key::<String>()?;
        if first.as_deref() == Some("expr") {
            let text = map.next_value::<String>()?;
            if let Some(other) = map.next_key::<String>()? {
                return Err(A::Error::custom(format_args!("has the key \"{other}\" beside \"expr\": remove it")));
            }
            return Ok(NamedNumber::Formula(text));
        }
        Track::deserialize(MapAccessDeserializer::new(PeekedMap::new(first, map))).map(NamedNumber::Track)
    }
}

impl<'de> Deserialize<'de> for NamedNumber {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(NamedNumberVisitor)
    }
}

impl JsonSchema for NamedNumber {
    fn schema_name() -> Cow<'static, str> {
        "NamedNumber".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let (track, formula) = (generator.subschema_for::<TrackSchema>(), generator.subschema_for::<FormulaSchema>());
        json_schema!({
            "description": "A number with a name: a number, a formula as text such as \"2 * r + 0.05\", or a track.",
            "anyOf": [{ "type": "number" }, { "type": "string" }, formula, track]
        })
    }
}
