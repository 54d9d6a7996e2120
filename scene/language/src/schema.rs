//! The JSON Schema of a job file, in a form from which client generators create named types.
//!
//! Schemas made by the derive macros describe each choice in place. Generators number such types (`Node17`), so
//! [`tidy`] gives each a definition of its own. It does not change which texts are valid, except that an optional key
//! may no longer be null, which the parser still accepts. `schema/editor.rs` has the form for editors.

mod editor;
mod examples;
mod shortest;
mod table;

use std::collections::BTreeMap;

use schemars::generate::SchemaSettings;
use serde_json::{Map, Value, json};

use crate::document::JobDocument;
pub use editor::editor_schema;
pub use table::{Family, KeyView, KindView, NodeTable, node_table};

/// Prefix of references to definitions in a JSON Schema.
const DEFINITIONS: &str = "#/$defs/";
/// Keywords that bound a number.
const RANGE: [&str; 6] = ["minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum", "multipleOf", "not"];
/// Definitions with numbers that cannot be formulas.
const WITHOUT_FORMULAS: [&str; 6] = ["ColorTrack", "Ease", "Formula", "NamedNumber", "PointTrack", "Track"];

/// The JSON Schema (draft 2020-12) of a job file, for client generators.
pub fn schema() -> Value {
    let mut definitions = written();
    tidy(&mut definitions, DEFINITIONS);
    examples::show(&mut definitions);
    let mut schema = match definitions.remove("Job") {
        Some(Value::Object(job)) => job,
        _ => Map::new(),
    };
    schema.insert("$schema".into(), "https://json-schema.org/draft/2020-12/schema".into());
    schema.insert("$defs".into(), definitions.into());
    schema.into()
}

/// The definitions as the derive macros write them.
fn written() -> Map<String, Value> {
    let mut generator = SchemaSettings::draft2020_12().into_generator();
    generator.subschema_for::<JobDocument>();
    generator.take_definitions(true)
}

/// Rewrites definitions, which are referenced by `references`, for client generators:
///
/// - a choice of objects with one key each refers to a definition for each: `NodeSphere` is `{ "sphere": Sphere }`;
/// - words are an `enum`, with a description of each;
/// - an optional key is not nullable;
/// - the range of a number is next to its type;
/// - every definition has its name as its title, no integer has a Rust-specific format, and defaults have only the
///   digits that they need.
pub fn tidy(definitions: &mut Map<String, Value>, references: &str) {
    let mut parts = BTreeMap::new();
    for (name, definition) in definitions.iter_mut() {
        if let Some(schema) = definition.as_object_mut() {
            choices(name, schema, references, &mut parts);
        }
    }
    describe(&mut parts, definitions, references);
    definitions.extend(parts);
    for (name, definition) in definitions {
        plain(definition);
        if !WITHOUT_FORMULAS.contains(&name.as_str()) {
            formula_beside_number(definition, &json!({ "$ref": format!("{references}Formula") }));
        }
        shortest::shorten(definition);
        if let Some(schema) = definition.as_object_mut() {
            schema.insert("title".into(), name.as_str().into());
        }
    }
}

/// Moves the alternatives of a choice out of it, into `parts`; a choice of words becomes an `enum`.
fn choices(name: &str, schema: &mut Map<String, Value>, references: &str, parts: &mut BTreeMap<String, Value>) {
    let Some(Value::Array(choices)) = schema.get("oneOf") else { return };
    let (words, others): (Vec<Value>, Vec<Value>) =
        choices.iter().cloned().partition(|choice| choice["const"].is_string());
    if others.is_empty() {
        schema.remove("oneOf");
        let words = enumeration(schema.get("description").and_then(Value::as_str), &words);
        schema.extend(words);
        return;
    }
    let mut kept: Vec<Value> = others
        .into_iter()
        .map(|mut choice| {
            let Some(key) = only_key(&choice) else { return choice };
            let part = format!("{name}{}", pascal_case(&key));
            // A type written in place after the key gets a name, too.
            let about = choice["description"].clone();
            let inner = &mut choice["properties"][&key];
            if inner["type"] == "object" && inner["properties"].is_object() {
                let inner_name = format!("{}{name}", pascal_case(&key));
                let reference = json!({ "$ref": format!("{references}{inner_name}") });
                if inner["description"].is_null() {
                    inner["description"] = about;
                }
                parts.insert(inner_name, std::mem::replace(inner, reference));
            }
            let reference = json!({ "$ref": format!("{references}{part}") });
            parts.insert(part, choice);
            reference
        })
        .collect();
    if !words.is_empty() {
        let part = format!("{name}Word");
        kept.push(json!({ "$ref": format!("{references}{part}") }));
        parts.insert(part, enumeration(None, &words).into());
    }
    schema.insert("oneOf".into(), kept.into());
}

/// The only key of an object with one required key.
fn only_key(choice: &Value) -> Option<String> {
    let properties = choice["properties"].as_object().filter(|properties| properties.len() == 1)?;
    let key = properties.keys().next()?;
    (choice["required"] == json!([key])).then(|| key.clone())
}

/// Words as an `enum`.
fn enumeration(about: Option<&str>, words: &[Value]) -> Map<String, Value> {
    let lines =
        words.iter().map(|word| format!("- `{}`: {}", word["const"], word["description"].as_str().unwrap_or_default()));
    let lines: Vec<String> = lines.collect();
    let about = about.map(|about| format!("{about}\n\n")).unwrap_or_default();
    let values: Vec<&Value> = words.iter().map(|word| &word["const"]).collect();
    let mut schema = Map::new();
    schema.insert("type".into(), "string".into());
    schema.insert("enum".into(), json!(values));
    schema.insert("description".into(), format!("{about}{}", lines.join("\n")).into());
    schema
}

/// A part that only names a definition gets the first paragraph of that definition's description.
fn describe(parts: &mut BTreeMap<String, Value>, definitions: &Map<String, Value>, references: &str) {
    for part in parts.values_mut() {
        let inner = only_key(part).and_then(|key| part["properties"][key]["$ref"].as_str().map(ToOwned::to_owned));
        let inner = inner.as_deref().and_then(|target| target.strip_prefix(references));
        let about = inner.and_then(|name| definitions.get(name)).and_then(|inner| inner["description"].as_str());
        if let (Some(about), Some(part)) = (about, part.as_object_mut()) {
            part.insert("description".into(), about.split("\n\n").next().unwrap_or_default().into());
        }
    }
}

/// Simplifies a schema and everything in it.
fn plain(value: &mut Value) {
    match value {
        Value::Object(schema) => {
            required_or_not_null(schema);
            range_beside_type(schema);
            portable_integer(schema);
            schema.values_mut().for_each(plain);
        }
        Value::Array(members) => members.iter_mut().for_each(plain),
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => {}
    }
}

/// Removes null from optional members.
fn required_or_not_null(schema: &mut Map<String, Value>) {
    let required = schema.get("required").cloned().unwrap_or_default();
    let Some(Value::Object(properties)) = schema.get_mut("properties") else { return };
    let is_required = |key: &str| required.as_array().is_some_and(|keys| keys.iter().any(|named| named == key));
    for (key, property) in properties {
        if let (false, Some(property)) = (is_required(key), property.as_object_mut()) {
            not_null(property);
        }
    }
}

/// Removes null from the values that a schema allows.
pub fn not_null(schema: &mut Map<String, Value>) {
    if schema.get("default") == Some(&Value::Null) {
        schema.remove("default");
    }
    if let Some(Value::Array(types)) = schema.get_mut("type") {
        types.retain(|name| name != "null");
        if let [only] = &types[..] {
            let only = only.clone();
            schema.insert("type".into(), only);
        }
    }
    let Some(Value::Array(choices)) = schema.get_mut("anyOf") else { return };
    choices.retain(|choice| choice["type"] != "null");
    if let [Value::Object(only)] = &choices[..] {
        let only = only.clone();
        schema.remove("anyOf");
        for (keyword, value) in only {
            schema.entry(keyword).or_insert(value);
        }
    }
}

/// Moves the range into the number alternative of a number or something else.
fn range_beside_type(schema: &mut Map<String, Value>) {
    let is_number = |choice: &&mut Value| choice["type"] == "number" || choice["type"] == "integer";
    let mut range = Map::new();
    if let Some(Value::Array(_)) = schema.get("anyOf") {
        range.extend(RANGE.into_iter().filter_map(|keyword| schema.remove_entry(keyword)));
    }
    let Some(Value::Array(choices)) = schema.get_mut("anyOf") else { return };
    if let Some(Value::Object(number)) = choices.iter_mut().find(is_number) {
        number.extend(range);
    } else {
        schema.extend(range);
    }
}

/// Allows a formula wherever a number is allowed.
fn formula_beside_number(value: &mut Value, formula: &Value) {
    let is_number = |schema: &Value| {
        let is_number = |name: &Value| name == "number" || name == "integer";
        schema["type"].as_array().map_or_else(|| is_number(&schema["type"]), |all| all.iter().any(is_number))
    };
    match value {
        Value::Array(members) => members.iter_mut().for_each(|member| formula_beside_number(member, formula)),
        Value::Object(schema) => {
            if let Some(Value::Array(choices)) = schema.get_mut("anyOf")
                && choices.iter().any(is_number)
            {
                if !choices.contains(formula) {
                    choices.push(formula.clone());
                }
                return;
            }
            if is_number(&Value::Object(schema.clone())) {
                let outside = ["description", "default", "title", "examples"];
                let number: Map<String, Value> = schema
                    .iter()
                    .filter(|(key, _)| !outside.contains(&key.as_str()))
                    .map(|(k, v)| (k.clone(), v.clone()))
                    .collect();
                schema.retain(|key, _| outside.contains(&key.as_str()));
                schema.insert("anyOf".into(), json!([number, formula]));
                return;
            }
            // Values that are no schemas stay as they are.
            schema
                .iter_mut()
                .filter(|(key, _)| !["default", "examples"].contains(&key.as_str()))
                .for_each(|(_, inside)| formula_beside_number(inside, formula));
        }
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => {}
    }
}

/// Replaces an integer format that generators do not know by a range.
fn portable_integer(schema: &mut Map<String, Value>) {
    let largest = match schema.get("format").and_then(Value::as_str) {
        Some("uint8") => u64::from(u8::MAX),
        Some("uint16") => u64::from(u16::MAX),
        Some("uint32") => u64::from(u32::MAX),
        Some("uint64" | "uint") => u64::MAX,
        _ => return,
    };
    schema.remove("format");
    schema.entry("minimum").or_insert(0.into());
    if largest < u64::MAX {
        schema.entry("maximum").or_insert(largest.into());
    }
}

/// Converts `infinite_cylinder` to `InfiniteCylinder`.
fn pascal_case(key: &str) -> String {
    key.split('_')
        .flat_map(|word| {
            let (first, rest) = word.split_at(word.len().min(1));
            [first.to_ascii_uppercase(), rest.to_owned()]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    fn each_schema(value: &Value, check: &mut impl FnMut(&Value)) {
        match value {
            Value::Object(members) => {
                check(value);
                members.values().for_each(|member| each_schema(member, check));
            }
            Value::Array(members) => members.iter().for_each(|member| each_schema(member, check)),
            Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => {}
        }
    }

    fn tidied(definitions: Value) -> Map<String, Value> {
        let Value::Object(mut definitions) = definitions else { panic!("definitions are an object") };
        tidy(&mut definitions, DEFINITIONS);
        definitions
    }

    #[test]
    fn each_choice_has_a_definition_with_its_name() {
        let schema = schema();
        for (choice, key) in [("Node", "sphere"), ("Material", "flat"), ("Light", "spot"), ("Texture", "checker")] {
            let name = format!("{choice}{}", pascal_case(key));
            let reference = json!({ "$ref": format!("{DEFINITIONS}{name}") });
            assert!(schema["$defs"][choice]["oneOf"].as_array().is_some_and(|all| all.contains(&reference)), "{name}");
            assert_eq!(schema["$defs"][&name]["required"], json!([key]));
        }
        assert_eq!(schema["$defs"]["NodeSphere"]["properties"]["sphere"]["$ref"], "#/$defs/Sphere");
        // A type left in place after a key would be numbered by generators.
        for (name, definition) in schema["$defs"].as_object().expect("definitions") {
            for choice in definition["oneOf"].as_array().into_iter().flatten() {
                assert!(choice["$ref"].is_string(), "{name} has a choice without a name: {choice}");
            }
        }
    }

    #[test]
    fn no_definition_takes_the_name_of_another() {
        let mut definitions = written();
        let before: BTreeSet<String> = definitions.keys().cloned().collect();
        let mut parts = BTreeMap::new();
        for (name, definition) in &mut definitions {
            let mut own = BTreeMap::new();
            choices(name, definition.as_object_mut().expect("an object"), DEFINITIONS, &mut own);
            for (part, schema) in own {
                assert!(!before.contains(&part), "{part} is there already");
                assert_eq!(parts.insert(part, schema), None, "two parts of {name} and others are one");
            }
        }
        assert!(before.iter().all(|name| !name.ends_with(|last: char| last.is_ascii_digit())), "{before:?}");
    }

    #[test]
    fn words_become_an_enum_with_descriptions() {
        let schema = schema();
        let layer = &schema["$defs"]["Layer"];
        assert_eq!(
            layer["enum"],
            json!([
                "depth",
                "normal",
                "position",
                "albedo",
                "object",
                "steps",
                "samples",
                "noisy",
                "motion",
                "crypto_object",
                "crypto_material"
            ])
        );
        assert!(
            layer["description"].as_str().is_some_and(|about| about.contains("- `\"depth\"`: `Z`: distance")),
            "{layer}"
        );
        each_schema(&schema, &mut |part| assert!(!part["const"].is_string(), "{part}"));
    }

    #[test]
    fn only_required_members_can_be_null() {
        each_schema(&schema(), &mut |part| {
            for (key, property) in part["properties"].as_object().into_iter().flatten() {
                let may_be_null = property["type"].as_array().is_some_and(|types| types.contains(&json!("null")))
                    || property["anyOf"].as_array().is_some_and(|all| all.contains(&json!({ "type": "null" })));
                assert!(!may_be_null, "{key}: {property}");
            }
        });
        let given = json!({ "A": { "type": "object", "required": ["b"], "properties": {
            "b": { "type": ["string", "null"] }, "c": { "type": ["string", "null"], "default": null },
            "d": { "anyOf": [{ "$ref": "#/$defs/A" }, { "type": "null" }], "description": "D." },
        } } });
        let properties = &tidied(given)["A"]["properties"];
        assert_eq!(properties["b"]["type"], json!(["string", "null"]));
        assert_eq!(properties["c"], json!({ "type": "string" }));
        assert_eq!(properties["d"], json!({ "$ref": "#/$defs/A", "description": "D." }));
    }

    #[test]
    fn a_range_is_next_to_its_type() {
        let schema = schema();
        let length = &schema["$defs"]["Length"];
        assert_eq!(length["anyOf"][0], json!({ "type": "number", "minimum": 1e-6, "maximum": 1e6 }));
        assert!(length["minimum"].is_null());
        each_schema(&schema, &mut |part| {
            assert!(!part["format"].as_str().is_some_and(|format| format.starts_with("uint")), "{part}");
        });
    }

    #[test]
    fn defaults_have_the_digits_they_need() {
        let text = schema().to_string();
        assert!(!text.contains("99999") && !text.contains("00000238"), "a default is ragged");
    }

    #[test]
    fn every_example_matches_its_definition() {
        let schema = schema();
        assert_eq!(crate::parse(schema["examples"][0].to_string().as_bytes()).expect("a sound job").name, "example");
        let mut count = 0;
        for (name, definition) in schema["$defs"].as_object().expect("definitions") {
            assert_eq!(definition["title"], **name);
            for example in definition["examples"].as_array().into_iter().flatten() {
                if let Some(key) = only_key(definition) {
                    assert!(!example[&key].is_null(), "{name}: {example}");
                }
                count += 1;
            }
        }
        assert!(count >= crate::nodes::Node::examples().len(), "only {count} examples");
    }
}
