//! Reference to a material: by name or in place in a job file, by slot in a scene.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, LazyLock};

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{MapAccess, Visitor, value::MapAccessDeserializer};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::Material;
use crate::limits::MAX_MATERIALS;
use crate::seek::{FrameTime, Seek, SeekError};

/// Reference to a material: a name from the scene's `materials`, or a material in place.
#[derive(Clone, Debug, PartialEq)]
pub enum MaterialRef {
    /// In a job file: by name.
    Name(String),
    /// In a job file: in place. Copies of a named shape share it.
    InPlace(Arc<Material>),
    /// In a scene: index among the materials in use.
    Slot(u32),
}

/// The material of objects that have none, which they share in memory.
static DEFAULT: LazyLock<Arc<Material>> =
    LazyLock::new(|| Arc::new(serde_json::from_str(r#"{ "diffuse": {} }"#).expect("a material")));

impl MaterialRef {
    /// The material of an object that has none.
    pub(crate) fn default_of_objects() -> Self {
        Self::InPlace(Arc::clone(&DEFAULT))
    }

    /// Its index among the scene's materials in use; 0 until it is resolved.
    pub fn slot(&self) -> u32 {
        match self {
            Self::Name(_) | Self::InPlace(_) => 0,
            Self::Slot(slot) => *slot,
        }
    }

    /// Assigns the material a slot. Returns the name if there is no such material.
    pub fn resolve(&mut self, named: &BTreeMap<String, Material>, slots: &mut MaterialSlots) -> Result<(), String> {
        let MaterialSlots { used, count, by_name, in_place } = slots;
        let mut add_slot = |material: &Material| {
            if *count < MAX_MATERIALS {
                used.push(material.clone());
            }
            *count += 1;
            *count as u32 - 1
        };
        let slot = match std::mem::replace(self, Self::Slot(0)) {
            Self::Name(name) => {
                let Some(material) = named.get(&name) else { return Err(name) };
                *by_name.entry(name).or_insert_with(|| add_slot(material))
            }
            // Slots are part of a scene's hash: each object without a material has its own, as if it were written there.
            Self::InPlace(material) if Arc::ptr_eq(&material, &DEFAULT) => add_slot(&material),
            Self::InPlace(material) => {
                let add = || (add_slot(&material), Arc::clone(&material));
                in_place.entry(Arc::as_ptr(&material)).or_insert_with(add).0
            }
            Self::Slot(slot) => slot,
        };
        *self = Self::Slot(slot);
        Ok(())
    }
}

/// Slots of the materials in use so far.
#[derive(Debug, Default)]
pub struct MaterialSlots {
    /// The materials, by slot; the ones above [`MAX_MATERIALS`] are only counted, because the scene is rejected.
    pub used: Vec<Material>,
    /// Number of materials.
    pub count: usize,
    /// Slots of the named materials.
    pub by_name: BTreeMap<String, u32>,
    /// Slots of the materials in place, by address; each is held, so that no other one gets its address.
    in_place: HashMap<*const Material, (u32, Arc<Material>)>,
}

impl Seek for MaterialRef {
    fn seek(&mut self, clock: &mut FrameTime<'_>) -> Result<bool, Box<SeekError>> {
        match self {
            // The materials in slots are sought once, in the list of used materials.
            Self::Name(_) | Self::Slot(_) => Ok(false),
            Self::InPlace(material) => Arc::make_mut(material).seek(clock),
        }
    }
}

/// Deserializes a name or a material; errors inside a material keep their place.
struct MaterialUseVisitor;

impl<'de> Visitor<'de> for MaterialUseVisitor {
    type Value = MaterialRef;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("the name of a material, or a material in place")
    }

    fn visit_str<E>(self, name: &str) -> Result<MaterialRef, E> {
        Ok(MaterialRef::Name(name.to_owned()))
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<MaterialRef, A::Error> {
        Material::deserialize(MapAccessDeserializer::new(map)).map(|material| MaterialRef::InPlace(Arc::new(material)))
    }
}

impl<'de> Deserialize<'de> for MaterialRef {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(MaterialUseVisitor)
    }
}

impl Serialize for MaterialRef {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Name(name) => name.serialize(serializer),
            Self::InPlace(material) => material.serialize(serializer),
            // Serialized like a name: a scene has no other names, and its hash is stored in pictures.
            Self::Slot(slot) => serializer.collect_str(slot),
        }
    }
}

impl JsonSchema for MaterialRef {
    fn schema_name() -> Cow<'static, str> {
        "MaterialRef".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let material = generator.subschema_for::<Material>();
        json_schema!({
            "description": "The name of an entry of `materials`, or a material in place.",
            "anyOf": [{ "type": "string" }, material]
        })
    }
}
