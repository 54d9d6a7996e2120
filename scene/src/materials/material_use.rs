//! Where a material is used: by its name, or in place.

use std::borrow::Cow;
use std::collections::BTreeMap;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{MapAccess, Visitor, value::MapAccessDeserializer};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::Material;

/// A material where it is used: a name from the scene's `materials`, or one in place.
#[derive(Clone, Debug, PartialEq)]
pub struct MaterialUse {
    given: Given,
    slot: u32,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
enum Given {
    Name(String),
    InPlace(Material),
}

impl MaterialUse {
    /// Which of the scene's materials in use it is.
    #[inline(always)]
    pub fn slot(&self) -> u32 {
        self.slot
    }

    /// Gives it a slot in `used`, the materials in use so far; the name if there is no such material.
    pub(crate) fn resolve(
        &mut self,
        named: &BTreeMap<String, Material>,
        used: &mut Vec<Material>,
        slots: &mut BTreeMap<String, u32>,
    ) -> Result<(), String> {
        self.slot = match &self.given {
            Given::Name(name) => {
                let material = named.get(name).ok_or_else(|| name.clone())?;
                *slots.entry(name.clone()).or_insert_with(|| new_slot(used, material))
            }
            Given::InPlace(material) => new_slot(used, material),
        };
        Ok(())
    }

    /// The same use, named by its slot: what a scene's key is made of.
    pub(crate) fn canonical(&self) -> Self {
        Self { given: Given::Name(self.slot.to_string()), slot: self.slot }
    }
}

fn new_slot(used: &mut Vec<Material>, material: &Material) -> u32 {
    used.push(material.clone());
    used.len() as u32 - 1
}

/// Reads a name or a material; faults inside a material keep their place.
struct MaterialUseVisitor;

impl<'de> Visitor<'de> for MaterialUseVisitor {
    type Value = MaterialUse;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("the name of a material, or a material in place")
    }

    fn visit_str<E>(self, name: &str) -> Result<MaterialUse, E> {
        Ok(MaterialUse { given: Given::Name(name.to_owned()), slot: 0 })
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<MaterialUse, A::Error> {
        let material = Material::deserialize(MapAccessDeserializer::new(map))?;
        Ok(MaterialUse { given: Given::InPlace(material), slot: 0 })
    }
}

impl<'de> Deserialize<'de> for MaterialUse {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(MaterialUseVisitor)
    }
}

impl Serialize for MaterialUse {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.given.serialize(serializer)
    }
}

impl JsonSchema for MaterialUse {
    fn schema_name() -> Cow<'static, str> {
        "MaterialUse".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let material = generator.subschema_for::<Material>();
        json_schema!({
            "description": "The name of an entry of `materials`, or a material in place.",
            "anyOf": [{ "type": "string" }, material]
        })
    }
}
