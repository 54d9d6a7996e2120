//! Uses of shapes by their names.

use std::collections::BTreeMap;
use std::fmt;

use schemars::JsonSchema;
use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::{Node, Sdf, SdfValue};
use crate::bounds::Bounds;
use crate::real::{Real, Vec3};
use crate::seek::{FrameTime, Seek, SeekError};
use crate::values::NamedNumber;

/// A shape of the scene's `shapes`, by its name: `{ "use": "leg" }`, or with numbers of its own:
/// `{ "use": { "shape": "leg", "with": { "bend": 30 } } }`.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema, Seek)]
#[serde(untagged)]
#[schemars(extend("examples" = ["leg"]))]
pub enum Use {
    /// The name of a shape.
    Name(String),
    /// A shape with numbers of its own.
    With(UseWith),
}

/// A shape with numbers of its own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct UseWith {
    /// The name of the shape.
    shape: String,
    /// Its own numbers, which its formulas use instead of the scene's: each a number, a formula as text, or a track.
    with: NamedNumbers,
}

/// Numbers by name. They are in the shape's formulas already when a job is parsed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
struct NamedNumbers(BTreeMap<String, NamedNumber>);

impl Seek for NamedNumbers {
    fn seek(&mut self, _: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        Ok(false)
    }
}

struct UseVisitor;

impl<'de> Visitor<'de> for UseVisitor {
    type Value = Use;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the name of a shape, or {\"shape\": name, \"with\": numbers}")
    }

    fn visit_str<E: Error>(self, name: &str) -> Result<Use, E> {
        Ok(Use::Name(name.to_owned()))
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Use, A::Error> {
        UseWith::deserialize(MapAccessDeserializer::new(map)).map(Use::With)
    }
}

impl<'de> Deserialize<'de> for Use {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(UseVisitor)
    }
}

impl Node {
    /// Name of the shape that it stands for, if it is a `use`.
    pub fn used_shape(&self) -> Option<&str> {
        match self {
            Self::Use(Use::Name(name) | Use::With(UseWith { shape: name, .. })) => Some(name),
            _ => None,
        }
    }
}

/// It is replaced by its shape when a job is parsed. Until then it is empty.
impl Sdf for Use {
    const EXAMPLE: &'static str = r#""leg""#;

    /// None, because an example is tested and drawn alone, without a scene that defines its name.
    fn examples() -> Vec<String> {
        Vec::new()
    }

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, _: &impl Fn(usize, Vec3<R>) -> V) -> V {
        V::new(p.x.constant(1e9))
    }

    fn bounds(&self, _: f32) -> Bounds {
        Bounds::EMPTY
    }
}
