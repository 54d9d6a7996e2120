//! Table of everything that a job file is written with, for completion and help in an editor: flat, and made from the
//! schema in its form for editors. It must not say anything that the schema does not say.

mod values;

use std::collections::{BTreeMap, BTreeSet};

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Map, Value};

use super::only_key;
use crate::effects;
use crate::kinds::snake_case;
use values::{Shape, about, shape_of, target, unit};

/// Families, with the names of their definitions.
const FAMILIES: [(Family, &str); 7] = [
    (Family::Node, "Node"),
    (Family::Profile, "Profile"),
    (Family::Material, "Material"),
    (Family::Texture, "Texture"),
    (Family::Light, "Light"),
    (Family::Background, "Background"),
    (Family::Projection, "Projection"),
];

/// Everything that a job file is written with.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct NodeTable {
    /// Kinds of every family, in the order of the docs; then the objects of a job file, in alphabetical order.
    pub kinds: Vec<KindView>,
}

/// A kind of a family, or an object of a job file.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct KindView {
    /// Its name in JSON; of an object of a job file, the name by which `of` refers to it.
    pub name: String,
    /// The family.
    pub family: Family,
    /// One line about it.
    pub title: String,
    /// All about it, as Markdown.
    pub documentation: String,
    /// Keys of its object.
    pub keys: Vec<KeyView>,
    /// Whether an object has exactly one of the keys.
    pub is_choice: bool,
    /// Its value, if that is no object: `{ "color": "#8fb3c9" }`. Null for a kind that is only a word.
    pub value: Option<Shape>,
    /// JSON that can stand where a kind of the family can; null if it depends on the rest of the job.
    pub example: Value,
    /// Path of a picture of the example.
    pub picture: Option<String>,
}

/// Family of a kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Family {
    /// A node: a shape, or an operator on shapes.
    Node,
    /// A profile: a shape in the plane.
    Profile,
    /// A material.
    Material,
    /// A texture.
    Texture,
    /// A light.
    Light,
    /// A background.
    Background,
    /// A projection of the camera.
    Projection,
    /// An effect: a key of the scene.
    Effect,
    /// An object of a job file.
    Document,
}

impl Family {
    /// Its name in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Node => "node",
            Self::Profile => "profile",
            Self::Material => "material",
            Self::Texture => "texture",
            Self::Light => "light",
            Self::Background => "background",
            Self::Projection => "projection",
            Self::Effect => "effect",
            Self::Document => "document",
        }
    }
}

/// Key of an object.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct KeyView {
    /// The key.
    pub name: String,
    /// Values that it can have.
    #[serde(flatten)]
    pub shape: Shape,
    /// Whether it must be there.
    pub required: bool,
    /// Value when it is absent; null if that depends on the rest of the job, or there is none.
    pub default: Value,
    /// A value that it could have; null if there is none.
    pub example: Value,
    /// Unit of its numbers.
    pub unit: Option<String>,
    /// All about it, as Markdown.
    pub documentation: String,
}

/// The table.
pub fn node_table() -> NodeTable {
    let schema = super::editor_schema();
    let mut definitions = schema["$defs"].as_object().cloned().unwrap_or_default();
    let mut job = schema;
    if let Some(job) = job.as_object_mut() {
        job.remove("$defs");
    }
    definitions.insert("Job".to_owned(), job);
    let mut writer = Writer { definitions: &definitions, inline: BTreeMap::new(), own: BTreeSet::new() };
    let mut kinds = Vec::new();
    for (family, name) in FAMILIES {
        for choice in choices(&definitions[name]) {
            kinds.extend(writer.kinds_of(family, choice));
        }
    }
    kinds.extend(effects::examples().iter().filter(|example| example.index == 0).map(|effect| {
        let example = serde_json::from_str::<Value>(&effect.json).unwrap_or_default();
        let schema = &definitions[effect.kind];
        writer.own.insert(effect.kind.to_owned());
        writer.kind(Family::Effect, &effect.name, schema, about(schema), example)
    }));
    let mut objects = writer.objects();
    objects.sort_by(|a, b| a.name.cmp(&b.name));
    kinds.extend(objects);
    NodeTable { kinds }
}

/// Alternatives of a definition.
fn choices(definition: &Value) -> impl Iterator<Item = &str> {
    definition["oneOf"].as_array().into_iter().flatten().filter_map(target)
}

struct Writer<'a> {
    definitions: &'a Map<String, Value>,
    /// Objects that are described in place, by the names that they get.
    inline: BTreeMap<String, &'a Value>,
    /// Definitions that belong to a kind, or only give one its name.
    own: BTreeSet<String>,
}

impl<'a> Writer<'a> {
    /// The kinds of an alternative of a family: one with its name as the only key, or words.
    fn kinds_of(&mut self, family: Family, choice: &str) -> Vec<KindView> {
        let definition = &self.definitions[choice];
        self.own.insert(choice.to_owned());
        let Some(key) = only_key(definition) else {
            let words = shape_of(definition, self.definitions, choice, &mut BTreeMap::new()).words;
            let kinds = words.into_iter().map(|word| {
                let text = word.documentation;
                self.kind(family, word.word.as_str().unwrap_or_default(), &Value::Null, text, word.word.clone())
            });
            return kinds.collect();
        };
        let inner = &definition["properties"][&key];
        let payload = target(inner).map_or(inner, |name| {
            self.own.insert(name.to_owned());
            &self.definitions[name]
        });
        let text = [about(inner), about(payload), about(definition)].into_iter().find(|text| !text.is_empty());
        let example = definition["examples"][0].clone();
        vec![self.kind(family, &key, payload, text.unwrap_or_default(), example)]
    }

    /// The entry of a kind, given the schema of its value.
    fn kind(&mut self, family: Family, name: &str, schema: &'a Value, text: String, example: Value) -> KindView {
        let value = (!schema.is_null() && !schema["properties"].is_object())
            .then(|| shape_of(schema, self.definitions, name, &mut self.inline));
        let has_picture = family != Family::Document && !example.is_null();
        KindView {
            name: name.to_owned(),
            family,
            title: first_sentence(&text),
            documentation: text,
            keys: self.keys(name, schema),
            is_choice: false,
            value,
            example,
            picture: has_picture.then(|| format!("/ui/pictures/{}-{name}.webp", family.name())),
        }
    }

    /// Keys of an object; `place` names it.
    fn keys(&mut self, place: &str, schema: &'a Value) -> Vec<KeyView> {
        let required = schema["required"].as_array().cloned().unwrap_or_default();
        let properties = schema["properties"].as_object().into_iter().flatten();
        let key = |(name, property): (&String, &'a Value)| {
            let definition = target(property).and_then(|name| self.definitions.get(name));
            let texts = [about(property), definition.map(about).unwrap_or_default()];
            let [own, other] = &texts;
            KeyView {
                name: name.clone(),
                shape: shape_of(property, self.definitions, &format!("{place}_{name}"), &mut self.inline),
                required: required.iter().any(|key| key == name),
                default: property["default"].clone(),
                example: property["examples"][0].clone(),
                unit: unit(&texts),
                documentation: if own.is_empty() { other.clone() } else { own.clone() },
            }
        };
        let mut keys: Vec<KeyView> = properties.map(key).collect();
        // Required keys come first.
        keys.sort_by_key(|key| !key.required);
        keys
    }

    /// Entries of the objects that belong to no kind.
    fn objects(&mut self) -> Vec<KindView> {
        let families: Vec<&str> = FAMILIES.iter().map(|(_, name)| *name).collect();
        let mut entries = Vec::new();
        // Alternatives whose names are keys are the keys of one object.
        for (name, definition) in self.definitions {
            let wrappers: Vec<&str> =
                choices(definition).filter(|choice| only_key(&self.definitions[*choice]).is_some()).collect();
            if wrappers.is_empty() || families.contains(&name.as_str()) {
                continue;
            }
            let place = snake_case(name);
            let mut entry = self.kind(Family::Document, &place, &Value::Null, about(definition), Value::Null);
            for wrapper in wrappers {
                self.own.insert(wrapper.to_owned());
                let mut keys = self.keys(&place, &self.definitions[wrapper]);
                for key in keys.iter_mut().filter(|key| key.documentation.is_empty()) {
                    key.documentation = about(&self.definitions[wrapper]);
                }
                entry.keys.extend(keys);
            }
            entry.keys.iter_mut().for_each(|key| key.required = false);
            entry.is_choice = true;
            entries.push(entry);
        }
        for (name, definition) in self.definitions {
            if definition["properties"].is_object() && !self.own.contains(name) {
                entries.push(self.object(&snake_case(name), definition));
            }
        }
        for (name, definition) in
            self.definitions.iter().filter(|(_, definition)| !definition["properties"].is_object())
        {
            shape_of(definition, self.definitions, &snake_case(name), &mut self.inline);
        }
        // Objects in place may have others in them.
        let mut written = BTreeSet::new();
        while let Some((name, schema)) = self.inline.iter().find(|(name, _)| !written.contains(*name)) {
            let (name, schema) = (name.clone(), *schema);
            let mut entry = self.object(&name, schema);
            if entry.documentation.is_empty() {
                let mut definitions = self.definitions.iter().filter(|(known, _)| snake_case(known) == name);
                let of_definition = definitions.next().map(|(_, definition)| about(definition));
                let of_key = || entry.keys.first().map(|key| key.documentation.clone());
                entry.documentation = of_definition.or_else(of_key).unwrap_or_default();
                entry.title = first_sentence(&entry.documentation);
            }
            entries.push(entry);
            written.insert(name);
        }
        entries
    }

    fn object(&mut self, name: &str, schema: &'a Value) -> KindView {
        let mut entry = self.kind(Family::Document, name, schema, about(schema), schema["examples"][0].clone());
        if entry.example.is_null() {
            let required = entry.keys.iter().filter(|key| key.required);
            let values: Map<String, Value> = required.map(|key| (key.name.clone(), key.example.clone())).collect();
            if !values.is_empty() && !values.values().any(Value::is_null) {
                entry.example = values.into();
            }
        }
        entry
    }
}

/// The first sentence of a text, in one line.
fn first_sentence(text: &str) -> String {
    let paragraph = text.split("\n\n").next().unwrap_or_default().replace('\n', " ");
    let end = paragraph.find(". ").map_or(paragraph.len(), |end| end + 1);
    paragraph[..end].to_owned()
}

#[cfg(test)]
mod tests;
