//! Values that a schema allows, in few words: what an editor offers for a key.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Map, Value};

use super::super::DEFINITIONS;
use crate::kinds::snake_case;

/// Definitions that are kinds of values of their own.
const KINDS: [(&str, &str); 9] = [
    ("Node", "node"),
    ("Profile", "profile"),
    ("Material", "material"),
    ("MaterialRef", "material"),
    ("Texture", "texture"),
    ("Light", "light"),
    ("Background", "background"),
    ("Projection", "projection"),
    ("Color", "color"),
];
/// Units as descriptions name them.
const UNITS: [&str; 8] =
    ["degrees", "scene units", "pixels", "frames per second", "seconds", "stops", "kelvin", "revolutions"];

/// Values that a key can have.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Shape {
    /// Kind of the values: number, integer, boolean, text, word, vec2, vec3, color, a family (node, material and so on),
    /// object or map; with an s for a list of them.
    pub kind: String,
    /// Families, effects and objects of a job file that it can be, or that a list or a map has.
    pub of: Vec<String>,
    /// Words that it can be.
    pub words: Vec<Word>,
    /// Least number.
    pub minimum: Option<f64>,
    /// Largest number.
    pub maximum: Option<f64>,
}

/// A word that stands for itself.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Word {
    /// The word, or the number.
    pub word: Value,
    /// Its meaning, as Markdown.
    pub documentation: String,
}

/// Description of a schema.
pub(super) fn about(schema: &Value) -> String {
    schema["description"].as_str().or_else(|| schema["$comment"].as_str()).unwrap_or_default().to_owned()
}

/// Name of the definition that a schema refers to.
pub(super) fn target(schema: &Value) -> Option<&str> {
    schema["$ref"].as_str()?.strip_prefix(DEFINITIONS)
}

/// Unit that the first of some texts names.
pub(super) fn unit(texts: &[String]) -> Option<String> {
    let named = |text: &String| UNITS.into_iter().find(|unit| text.contains(&format!("in {unit}")));
    texts.iter().find_map(named).map(str::to_owned)
}

/// Values of a schema. Objects that are described in place are added to `inline`, under the name `place`.
pub(super) fn shape_of<'a>(
    schema: &'a Value,
    definitions: &'a Map<String, Value>,
    place: &str,
    inline: &mut BTreeMap<String, &'a Value>,
) -> Shape {
    let mut shape = Shape::default();
    ShapeReader { definitions, inline, shape: &mut shape }.read(schema, place);
    if shape.kind.is_empty() {
        if shape.words.is_empty() { "object" } else { "word" }.clone_into(&mut shape.kind);
    }
    shape
}

struct ShapeReader<'a, 'r> {
    definitions: &'a Map<String, Value>,
    inline: &'r mut BTreeMap<String, &'a Value>,
    shape: &'r mut Shape,
}

impl<'a> ShapeReader<'a, '_> {
    fn read(&mut self, schema: &'a Value, place: &str) {
        if let Some(name) = target(schema) {
            self.definition(name);
        }
        for alternatives in ["anyOf", "oneOf"] {
            for choice in schema[alternatives].as_array().into_iter().flatten() {
                self.read(choice, place);
            }
        }
        if !schema["const"].is_null() {
            self.shape.words.push(Word { word: schema["const"].clone(), documentation: about(schema) });
            return;
        }
        if let Some(words) = schema["enum"].as_array() {
            let word = |word: &Value| Word { word: word.clone(), documentation: String::new() };
            self.shape.words.extend(words.iter().map(word));
            return;
        }
        match schema["type"].as_str() {
            Some(kind @ ("number" | "integer")) => {
                self.kind(kind);
                let bound = |names: [&str; 2]| names.into_iter().find_map(|name| schema[name].as_f64());
                self.shape.minimum = self.shape.minimum.or_else(|| bound(["minimum", "exclusiveMinimum"]));
                self.shape.maximum = self.shape.maximum.or_else(|| bound(["maximum", "exclusiveMaximum"]));
            }
            Some("boolean") => self.kind("boolean"),
            // Words of an alternative are strings, too.
            Some("string") if !schema["oneOf"].is_array() => self.kind("text"),
            Some("array") => self.array(schema, place),
            Some("object") if schema["properties"].is_object() => {
                self.inline.insert(place.to_owned(), schema);
                self.of(place);
            }
            Some("object") if schema["additionalProperties"].is_object() => {
                self.kind("map");
                self.inner(&schema["additionalProperties"], place);
            }
            _ => {}
        }
    }

    fn definition(&mut self, name: &str) {
        if let Some((_, kind)) = KINDS.iter().find(|(definition, _)| *definition == name) {
            self.kind(kind);
            return;
        }
        let Some(definition) = self.definitions.get(name) else { return };
        let is_choice = super::choices(definition).any(|choice| super::only_key(&self.definitions[choice]).is_some());
        if definition["properties"].is_object() || is_choice {
            self.of(&snake_case(name));
        } else {
            self.read(definition, &snake_case(name));
        }
    }

    fn array(&mut self, schema: &'a Value, place: &str) {
        let prefix = schema["prefixItems"].as_array().into_iter().flatten();
        let mut items = prefix.chain(Some(&schema["items"])).filter(|items| items.is_object());
        let Some(first) = items.next() else { return };
        let inner = self.inner(first, place);
        for items in items {
            self.inner(items, place);
        }
        let is_number = ["number", "integer"].contains(&inner.kind.as_str());
        match (schema["minItems"].as_u64(), schema["maxItems"].as_u64()) {
            (Some(2), Some(2)) if is_number => self.kind("vec2"),
            (Some(3), Some(3)) if is_number => self.kind("vec3"),
            _ => self.kind(&format!("{}s", inner.kind)),
        }
        if is_number || inner.kind == "word" {
            self.shape.minimum = self.shape.minimum.or(inner.minimum);
            self.shape.maximum = self.shape.maximum.or(inner.maximum);
            self.shape.words.extend(inner.words);
        }
    }

    /// Values in a list or a map; families and objects are noted.
    fn inner(&mut self, schema: &'a Value, place: &str) -> Shape {
        let inner = shape_of(schema, self.definitions, place, self.inline);
        if KINDS.iter().any(|(_, kind)| *kind == inner.kind) {
            self.of(&inner.kind);
        }
        inner.of.iter().for_each(|name| self.of(name));
        inner
    }

    /// Notes a kind: the first one is that of the value.
    fn kind(&mut self, kind: &str) {
        if self.shape.kind.is_empty() {
            kind.clone_into(&mut self.shape.kind);
        } else if self.shape.kind != kind && KINDS.iter().any(|(_, family)| *family == kind) {
            self.of(kind);
        }
    }

    fn of(&mut self, name: &str) {
        if !self.shape.of.iter().any(|known| known == name) {
            self.shape.of.push(name.to_owned());
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    /// Names of the kinds that are no objects of a job file.
    pub(in super::super) const KIND_NAMES: [&str; 8] =
        ["node", "profile", "material", "texture", "light", "background", "projection", "color"];
}
