//! Examples in the schema: a job, and one or more of each kind of every family.
//!
//! They are the ones that docs and tests use, so that each is known to be valid.

use serde_json::{Map, Value, json};

use super::{DEFINITIONS, pascal_case};
use crate::backgrounds::Background;
use crate::camera::Projection;
use crate::effects;
use crate::lights::Light;
use crate::materials::{Material, Texture};
use crate::nodes::Node;
use crate::profiles::Profile;

/// A small job, as a user would write it.
const JOB: &str = r#"{
    "name": "example",
    "scene": {
        "camera": { "position": [0, 1, 4], "look_at": [0, 0, 0] },
        "objects": [{ "shape": { "sphere": { "radius": 1 } } }]
    },
    "image": { "width": 320, "height": 180 }
}"#;

/// Levels of a kind's own keys: the key with its name, and its value's keys.
const OWN_KEYS: usize = 2;

/// Adds examples to the definitions of a job and of each kind of node, material, texture, light and so on.
pub(super) fn show(definitions: &mut Map<String, Value>) {
    for (name, example) in of_definitions() {
        let Some(definition) = definitions.get_mut(&name).and_then(Value::as_object_mut) else { continue };
        if let Value::Array(examples) = definition.entry("examples").or_insert_with(|| json!([])) {
            examples.push(example);
        }
    }
}

/// Examples, each with the name of its definition.
fn of_definitions() -> Vec<(String, Value)> {
    let mut all: Vec<(&str, String)> = vec![("", JOB.to_owned())];
    let families = [
        ("Node", Node::examples()),
        ("Profile", Profile::examples()),
        ("Material", Material::examples()),
        ("Texture", Texture::examples()),
        ("Light", Light::examples()),
        ("Background", Background::examples()),
        ("Projection", Projection::examples()),
    ];
    for (family, examples) in families {
        all.extend(examples.into_iter().map(|example| (family, example.json)));
    }
    let named = |(family, text): (&str, String)| {
        let example: Value = serde_json::from_str(&text).ok()?;
        if family.is_empty() {
            return Some(("Job".to_owned(), example));
        }
        let key = example.as_object()?.keys().next()?;
        Some((format!("{family}{}", pascal_case(key)), example))
    };
    all.into_iter().filter_map(named).collect()
}

/// Leaves one example to each definition, and gives one to each key without a default, so that an editor can write a
/// key with its value.
pub(super) fn show_at_keys(definitions: &mut Map<String, Value>) {
    for definition in definitions.values_mut().filter_map(Value::as_object_mut) {
        if let Some(Value::Array(examples)) = definition.get_mut("examples") {
            examples.truncate(1);
        }
    }
    let examples = of_definitions();
    for (name, example) in &examples {
        at_keys(definitions, name, example, OWN_KEYS);
    }
    let effects = effects::examples().into_iter();
    let effects = effects.filter_map(|effect| Some(("Scene".to_owned(), serde_json::from_str(&effect.json).ok()?)));
    for (name, example) in examples.iter().cloned().chain(effects) {
        at_keys(definitions, &name, &example, usize::MAX);
    }
}

/// Gives the keys of a definition the values that they have in an example, down to a number of levels.
fn at_keys(definitions: &mut Map<String, Value>, name: &str, example: &Value, levels: usize) {
    let (Some(definition), Some(deeper)) = (definitions.get_mut(name), levels.checked_sub(1)) else { return };
    let mut inside = Vec::new();
    if let Some(definition) = definition.as_object_mut() {
        at_own_keys(definition, example);
    }
    referred(definition, example, &mut inside);
    for (name, value) in inside {
        at_keys(definitions, &name, &value, deeper);
    }
}

/// Gives the keys of an object without a default and an example the values that they have in its own example.
pub(super) fn show_at_own_keys(schema: &mut Map<String, Value>) {
    if let Some(example) = schema.get("examples").and_then(|examples| examples.get(0)).cloned() {
        at_own_keys(schema, &example);
    }
}

/// Gives the keys of an object without a default and an example the values that they have in an example.
fn at_own_keys(schema: &mut Map<String, Value>, example: &Value) {
    let Some(Value::Object(properties)) = schema.get_mut("properties") else { return };
    for (key, value) in example.as_object().into_iter().flatten() {
        let Some(property) = properties.get_mut(key).and_then(Value::as_object_mut) else { continue };
        if !property.contains_key("default") {
            property.entry("examples").or_insert_with(|| json!([value]));
        }
    }
}

/// Collects the definitions that a schema refers to, each with the part of a value that it describes.
fn referred(schema: &Value, value: &Value, found: &mut Vec<(String, Value)>) {
    if let Some(name) = schema["$ref"].as_str().and_then(|target| target.strip_prefix(DEFINITIONS)) {
        found.push((name.to_owned(), value.clone()));
    }
    for choice in ["anyOf", "oneOf"].iter().filter_map(|keyword| schema[*keyword].as_array()).flatten() {
        referred(choice, value, found);
    }
    for (key, value) in value.as_object().into_iter().flatten() {
        let inside = schema["properties"].get(key).unwrap_or(&schema["additionalProperties"]);
        referred(inside, value, found);
    }
    for (index, value) in value.as_array().into_iter().flatten().enumerate() {
        let inside = schema["prefixItems"].get(index).unwrap_or(&schema["items"]);
        referred(inside, value, found);
    }
}
