//! The JSON Schema of a job file in the form that editors show best, with the same definitions as the form for client
//! generators. It must not change which jobs are valid.
//!
//! The JSON language server of VS Code, Helix and others puts the keywords of a reference's target in the place of those
//! beside the reference, shows the innermost title and description of the schemas that a value matches, and
//! completes a key with its only default or example. Validators in strict mode accept no lists with optional entries.

use std::collections::BTreeSet;

use serde_json::{Map, Value, json};

use super::{DEFINITIONS, examples, only_key};

/// Keywords with schemas in the same place as their own.
const ALTERNATIVES: [&str; 2] = ["anyOf", "oneOf"];
/// Keywords with one schema for what is inside.
const INSIDE: [&str; 2] = ["items", "additionalProperties"];

/// The JSON Schema (draft 2020-12) of a job file, for editors and validators.
pub fn editor_schema() -> Value {
    let written = super::written();
    let mut schema = super::schema();
    let mut definitions = match schema["$defs"].take() {
        Value::Object(definitions) => definitions,
        _ => Map::new(),
    };
    for (name, definition) in &mut definitions {
        words(definition, written.get(name).or_else(|| written.get(name.strip_suffix("Word")?)));
    }
    if let Some(job) = schema.as_object_mut() {
        job.remove("$defs");
    }
    // The job is one of the definitions until they are complete.
    definitions.insert("Job".into(), schema);
    examples::show_at_keys(&mut definitions);
    for definition in definitions.values_mut() {
        each_schema(definition, &mut |schema| {
            exact(schema);
            names_last(schema);
            examples::show_at_own_keys(schema);
        });
    }
    explain_at_keys(&mut definitions);
    let mut schema = definitions.remove("Job").unwrap_or_default();
    schema["$defs"] = definitions.into();
    schema
}

/// Calls a function for a schema and every one in it, innermost first.
fn each_schema(schema: &mut Value, change: &mut impl FnMut(&mut Map<String, Value>)) {
    let Some(keywords) = schema.as_object_mut() else { return };
    for (keyword, inside) in &mut *keywords {
        match (keyword.as_str(), inside) {
            ("properties", Value::Object(schemas)) => {
                for one in schemas.values_mut() {
                    each_schema(one, change);
                }
            }
            ("anyOf" | "oneOf" | "prefixItems", Value::Array(schemas)) => {
                for one in schemas {
                    each_schema(one, change);
                }
            }
            ("items" | "additionalProperties" | "not", inside) => each_schema(inside, change),
            _ => {}
        }
    }
    change(keywords);
}

/// Gives each word of an `enum` its own description, which an editor shows beside it. `written` is the definition
/// before its words were collected.
fn words(definition: &mut Value, written: Option<&Value>) {
    let Some(Value::Array(words)) = definition["enum"].as_array().map(|words| Value::from(words.clone())) else {
        return;
    };
    let about = |word: &Value| written?["oneOf"].as_array()?.iter().find(|choice| choice["const"] == *word).cloned();
    let Some(choices) = words.iter().map(about).collect::<Option<Vec<Value>>>() else { return };
    let choices: Vec<Value> = choices
        .into_iter()
        .map(|choice| json!({ "const": choice["const"], "description": choice["description"] }))
        .collect();
    definition["description"] = written.map_or(Value::Null, |written| written["description"].clone());
    if let Some(keywords) = definition.as_object_mut() {
        keywords.retain(|_, value| !value.is_null());
        keywords.remove("enum");
        keywords.insert("oneOf".into(), choices.into());
    }
}

/// Replaces keywords that a strict validator refuses: lists with optional entries, and formats of numbers.
fn exact(schema: &mut Map<String, Value>) {
    if schema.get("type").is_some_and(|kind| kind == "integer" || kind == "number") {
        schema.remove("format");
    }
    let Some(Value::Array(entries)) = schema.get("prefixItems") else { return };
    let least = schema.get("minItems").and_then(Value::as_u64).and_then(|least| usize::try_from(least).ok());
    let least = least.unwrap_or_default();
    let list = |length: usize| json!({ "type": "array", "prefixItems": entries[..length], "minItems": length, "maxItems": length });
    let lists: Vec<Value> = (least..=entries.len()).map(list).collect();
    let [only] = &lists[..] else {
        schema
            .retain(|keyword, _| !["type", "prefixItems", "items", "minItems", "maxItems"].contains(&keyword.as_str()));
        schema.insert("anyOf".into(), lists.into());
        return;
    };
    let only = only.as_object().cloned().unwrap_or_default();
    schema.remove("items");
    schema.extend(only);
}

/// Moves free text behind the other alternatives: an editor explains a wrong value by the first of those that
/// match equally little, and names say nothing about an object.
fn names_last(schema: &mut Map<String, Value>) {
    if let Some(Value::Array(choices)) = schema.get_mut("anyOf") {
        choices.sort_by_key(|choice| choice["type"] == "string" && choice["pattern"].is_null());
    }
}

/// References of the definitions to each other.
#[derive(Default)]
struct References {
    /// Definitions whose description would hide another, or would be hidden.
    silent: BTreeSet<String>,
    /// Definitions that only give a choice of another its name.
    names: BTreeSet<String>,
}

impl References {
    fn of(definitions: &mut Map<String, Value>) -> Self {
        let mut found = Self::default();
        for definition in definitions.values_mut() {
            each_schema(definition, &mut |schema| {
                if let (Some(name), true) = (target(schema), schema.contains_key("description")) {
                    found.silent.insert(name.to_owned());
                }
                for keyword in ALTERNATIVES {
                    let choices = schema.get(keyword).and_then(Value::as_array).into_iter().flatten();
                    for name in choices.filter_map(|choice| target(choice.as_object()?)) {
                        found.silent.insert(name.to_owned());
                        if keyword == "oneOf" {
                            found.names.insert(name.to_owned());
                        }
                    }
                }
            });
        }
        found
    }
}

/// Moves descriptions to the keys that editors show them for.
fn explain_at_keys(definitions: &mut Map<String, Value>) {
    let references = References::of(definitions);
    let about: Map<String, Value> = definitions
        .iter()
        .filter_map(|(name, definition)| Some((name.clone(), definition.get("description")?.clone())))
        .collect();
    for (name, definition) in definitions {
        if references.silent.contains(name) {
            silence(definition);
        }
        if references.names.contains(name)
            && only_key(definition).is_some()
            && let Some(definition) = definition.as_object_mut()
        {
            definition.remove("title");
        }
        each_schema(definition, &mut |schema| {
            for keyword in ALTERNATIVES {
                let choices = schema.get_mut(keyword).and_then(Value::as_array_mut).into_iter().flatten();
                choices.filter(|choice| choice["const"].is_null()).for_each(silence);
            }
            for keyword in INSIDE {
                if let Some(inside) = schema.get_mut(keyword) {
                    explain(inside, &about, &references);
                }
            }
            if let Some(Value::Object(properties)) = schema.get_mut("properties") {
                properties.values_mut().for_each(|property| explain(property, &about, &references));
            }
        });
    }
}

/// Name of the definition that a schema refers to.
fn target(schema: &Map<String, Value>) -> Option<&str> {
    schema.get("$ref")?.as_str()?.strip_prefix(DEFINITIONS)
}

/// Describes a reference as its target was described, if that is silent.
fn explain(schema: &mut Value, about: &Map<String, Value>, references: &References) {
    let Some(schema) = schema.as_object_mut() else { return };
    let Some(text) = target(schema).filter(|name| references.silent.contains(*name)).and_then(|name| about.get(name))
    else {
        return;
    };
    schema.entry("description").or_insert_with(|| text.clone());
}

/// Turns the description of a schema into a comment, unless it is that of its only key, or becomes it.
fn silence(schema: &mut Value) {
    let key = only_key(schema);
    let Some(text) = schema.as_object_mut().and_then(|schema| schema.remove("description")) else { return };
    let property = key.and_then(|key| schema.get_mut("properties")?.get_mut(key)?.as_object_mut());
    match property {
        Some(property) if property.contains_key("$ref") => {}
        Some(property) if !property.contains_key("description") => {
            property.insert("description".into(), text);
        }
        Some(_) | None => schema["$comment"] = text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parse;

    /// Calls a function for each definition and the job, with its name.
    fn each(check: &mut impl FnMut(&Value, &str, &mut Map<String, Value>)) {
        let schema = editor_schema();
        let mut definitions = schema["$defs"].as_object().expect("definitions").clone();
        let mut job = schema.clone();
        job.as_object_mut().expect("an object").remove("$defs");
        definitions.insert("Job".into(), job);
        for (name, definition) in &mut definitions {
            each_schema(definition, &mut |part| check(&schema["$defs"], name, part));
        }
    }

    /// A schema as editors see it: the keywords of a reference's target replace its own.
    fn merged(definitions: &Value, schema: &Map<String, Value>) -> Map<String, Value> {
        let mut merged = schema.clone();
        if let Some(name) = target(schema) {
            merged.extend(definitions[name].as_object().expect("a definition").clone());
        }
        merged
    }

    #[test]
    fn each_key_is_explained_once_and_completes_with_a_value() {
        let mut count = 0;
        each(&mut |definitions, name, schema| {
            for (key, property) in schema.get("properties").and_then(Value::as_object).into_iter().flatten() {
                let property = property.as_object().expect("a schema");
                let seen = merged(definitions, property);
                assert!(seen.contains_key("description"), "{name} {key}: {property:?}");
                let has_value = ["default", "examples", "type"].iter().any(|keyword| seen.contains_key(*keyword));
                assert!(has_value, "{name} {key} has neither a default, an example nor a type: {property:?}");
                count += 1;
            }
            if let (Some(target), true) = (target(schema), schema.contains_key("description")) {
                assert_eq!(definitions[target]["description"], Value::Null, "{target} hides a description of {name}");
            }
            for choice in ALTERNATIVES.iter().filter_map(|keyword| schema.get(*keyword)?.as_array()).flatten() {
                let seen = merged(definitions, choice.as_object().expect("a schema"));
                assert_eq!(seen.contains_key("const"), seen.contains_key("description"), "{name}: {choice}");
            }
        });
        assert!(count > 400, "only {count} keys");
    }

    #[test]
    fn each_key_without_a_default_is_required_or_may_be_absent() {
        let written = crate::schema::written();
        each(&mut |_, name, schema| {
            let required = schema.get("required").cloned().unwrap_or_default();
            let is_required = |key: &str| required.as_array().is_some_and(|keys| keys.iter().any(|named| named == key));
            for (key, property) in schema.get("properties").and_then(Value::as_object).into_iter().flatten() {
                assert!(
                    property["type"] != json!(["null"]) && !property["type"].is_array(),
                    "{name} {key}: {property}"
                );
                let is_null = |choice: &Value| choice["type"] == "null";
                assert!(!property["anyOf"].as_array().is_some_and(|all| all.iter().any(is_null)), "{name} {key}");
                if is_required(key) || !property["default"].is_null() {
                    continue;
                }
                let before = &written.get(name).unwrap_or(&Value::Null)["properties"][key];
                let may_be_absent = before["type"].as_array().is_some_and(|types| types.contains(&json!("null")))
                    || before["anyOf"].as_array().is_some_and(|all| all.iter().any(is_null))
                    || property["description"].as_str().is_some_and(|about| about.contains("absent"));
                assert!(may_be_absent, "{name} {key}: {property}");
            }
        });
    }

    #[test]
    fn each_word_has_its_description() {
        each(&mut |_, name, schema| {
            assert!(!schema.contains_key("enum") || schema.get("type") != Some(&json!("string")), "{name}: {schema:?}");
        });
    }

    #[test]
    fn the_form_for_editors_allows_what_the_other_does() {
        let (editors, clients) = (editor_schema(), crate::schema());
        let names =
            |schema: &Value| -> Vec<String> { schema["$defs"].as_object().expect("all").keys().cloned().collect() };
        assert_eq!(names(&editors), names(&clients));
        for name in names(&clients) {
            let keys = |schema: &Value| {
                let properties = schema["$defs"][&name]["properties"].as_object().cloned().unwrap_or_default();
                (properties.keys().cloned().collect::<Vec<_>>(), schema["$defs"][&name]["required"].clone())
            };
            assert_eq!(keys(&editors), keys(&clients), "{name}");
        }
    }

    /// A job with an example of a family.
    fn job(family: &str, example: &Value) -> Value {
        let mut job = editor_schema()["examples"][0].clone();
        let scene = &mut job["scene"];
        match family {
            "Node" => scene["objects"][0]["shape"] = example.clone(),
            "Profile" => scene["objects"][0]["shape"] = json!({ "extrude": { "profile": example, "height": 1 } }),
            "Material" => scene["objects"][0]["material"] = example.clone(),
            "Texture" => scene["objects"][0]["material"] = json!({ "flat": { "color": example } }),
            "Light" => {
                scene["lights"] = json!([example]);
                // The sun is that of a day.
                scene["background"] = json!({ "day": { "sun": [0, 1, 0] } });
            }
            "Background" => scene["background"] = example.clone(),
            "Projection" => scene["camera"]["projection"] = example.clone(),
            _ => panic!("{family} is no family"),
        }
        job
    }

    #[test]
    fn each_kind_has_one_example_that_the_parser_accepts() {
        let schema = editor_schema();
        for family in ["Node", "Profile", "Material", "Texture", "Light", "Background", "Projection"] {
            for kind in schema["$defs"][family]["oneOf"].as_array().expect("kinds") {
                let name = target(kind.as_object().expect("a schema")).expect("a reference");
                // Words stand for themselves, and a shape's name is only valid beside the shape.
                if name == format!("{family}Word") || name == "NodeUse" {
                    continue;
                }
                let examples = schema["$defs"][name]["examples"].as_array().unwrap_or_else(|| panic!("{name}"));
                let [example] = &examples[..] else { panic!("{name} has {} examples", examples.len()) };
                let parsed = parse(job(family, example).to_string().as_bytes());
                assert!(parsed.is_ok(), "{name}: {example}: {:?}", parsed.err());
            }
        }
    }
}
