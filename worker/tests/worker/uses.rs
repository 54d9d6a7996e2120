//! Every option of the job language is used by a shipped scene, so that `selftest` compares it on a GPU.
//!
//! The options are the JSON Schema's: each member of each object, and each word.

use std::collections::BTreeSet;

use serde_json::{Map, Value};

use crate::shipped::shipped;

/// Options that no shipped scene needs, with the reason.
const EXCEPTIONS: [(&str, &str); 4] = [
    ("Job.$schema", "only editors read it"),
    ("Job.priority", "it orders jobs, and changes no picture"),
    ("Image.region", "a shipped picture is whole; tiles are regions, too"),
    ("Lens.aperture", "a lens with f_stop and focal_length is the same one"),
];

/// The options that a document uses, or that there are.
struct Options<'a> {
    definitions: &'a Map<String, Value>,
    found: BTreeSet<String>,
}

/// The schemas in a list or among the members of a schema.
fn parts<'a>(schema: &'a Value, keys: &'a [&str]) -> impl Iterator<Item = &'a Value> {
    keys.iter().filter_map(|key| schema[*key].as_array()).flatten()
}

/// The words that a schema allows.
fn words(schema: &Value) -> impl Iterator<Item = &str> {
    parts(schema, &["enum"]).chain([&schema["const"]]).filter_map(Value::as_str)
}

fn type_of(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "boolean",
        Value::Number(_) => "number",
        Value::String(_) => "string",
        Value::Array(_) => "array",
        Value::Object(_) => "object",
    }
}

impl<'a> Options<'a> {
    fn new(schema: &'a Value) -> Self {
        let definitions = schema["$defs"].as_object().expect("a schema has definitions");
        Self { definitions, found: BTreeSet::new() }
    }

    /// The definition that a schema refers to, with its name.
    fn definition(&self, schema: &Value) -> Option<(&'a str, &'a Value)> {
        let name = schema["$ref"].as_str()?.rsplit('/').next()?;
        self.definitions.get_key_value(name).map(|(name, definition)| (name.as_str(), definition))
    }

    /// Adds all options that there are below a schema.
    fn add_all(&mut self, name: &str, schema: &'a Value, seen: &mut BTreeSet<&'a str>) {
        if let Some((name, definition)) = self.definition(schema)
            && seen.insert(name)
        {
            self.add_all(name, definition, seen);
        }
        self.found.extend(words(schema).map(|word| format!("{name} {word:?}")));
        for (key, member) in schema["properties"].as_object().into_iter().flatten() {
            self.found.insert(format!("{name}.{key}"));
            self.add_all(name, member, seen);
        }
        for part in parts(schema, &["oneOf", "anyOf", "prefixItems"]) {
            self.add_all(name, part, seen);
        }
        for part in
            ["items", "additionalProperties"].map(|key| &schema[key]).into_iter().filter(|part| part.is_object())
        {
            self.add_all(name, part, seen);
        }
    }

    /// Whether a value is of a schema, as far as the choice between alternatives needs.
    fn is_of(&self, schema: &Value, value: &Value) -> bool {
        let types: Vec<&str> = match &schema["type"] {
            Value::String(name) => vec![name],
            names => names.as_array().into_iter().flatten().filter_map(Value::as_str).collect(),
        };
        let found = type_of(value);
        let has_type =
            types.is_empty() || types.iter().any(|name| *name == found || (*name, found) == ("integer", "number"));
        let mut choices = ["oneOf", "anyOf"].iter().filter_map(|key| schema[*key].as_array());
        let is_word = words(schema).next().is_none() || words(schema).any(|word| value == word);
        has_type
            && is_word
            && self.definition(schema).is_none_or(|(_, definition)| self.is_of(definition, value))
            && choices.all(|choices| choices.iter().any(|choice| self.is_of(choice, value)))
            && value.as_object().is_none_or(|members| {
                let is_known =
                    |key: &String| schema["additionalProperties"] != false || !schema["properties"][key].is_null();
                parts(schema, &["required"]).all(|key| members.contains_key(key.as_str().expect("a name")))
                    && members.keys().all(is_known)
            })
    }

    /// Adds the options that a value uses. A word that is a default is used by its absence.
    fn add_used(&mut self, name: &str, schema: &'a Value, value: &Value) {
        if let Some((name, definition)) = self.definition(schema) {
            self.add_used(name, definition, value);
        }
        self.found.extend(words(schema).filter(|word| value == word).map(|word| format!("{name} {word:?}")));
        for choice in parts(schema, &["oneOf", "anyOf"]) {
            if self.is_of(choice, value) {
                self.add_used(name, choice, value);
            }
        }
        if let Some(members) = value.as_object() {
            self.add_members(name, schema, members);
        }
        for (index, item) in value.as_array().into_iter().flatten().enumerate() {
            let items = schema["prefixItems"].get(index).unwrap_or(&schema["items"]);
            self.add_used(name, items, item);
        }
    }

    fn add_members(&mut self, name: &str, schema: &'a Value, members: &Map<String, Value>) {
        for (key, member) in schema["properties"].as_object().into_iter().flatten() {
            match members.get(key) {
                Some(value) => {
                    self.found.insert(format!("{name}.{key}"));
                    self.add_used(name, member, value);
                }
                None if member["default"].is_string() => self.add_used(name, member, &member["default"]),
                None => {}
            }
        }
        if schema["additionalProperties"].is_object() {
            for (_, value) in members.iter().filter(|(key, _)| schema["properties"][*key].is_null()) {
                self.add_used(name, &schema["additionalProperties"], value);
            }
        }
    }
}

#[test]
fn every_option_of_the_language_is_used_by_a_shipped_scene() {
    let schema = scene::schema();
    let (mut all, mut used) = (Options::new(&schema), Options::new(&schema));
    all.add_all("Job", &schema, &mut BTreeSet::new());
    assert!(all.found.len() > 600, "{} options", all.found.len());
    for shipped in shipped() {
        let job = serde_json::from_slice(&shipped.text).expect("a shipped scene is plain JSON");
        used.add_used("Job", &schema, &job);
    }
    let excepted = EXCEPTIONS.map(|(option, _)| option.to_owned());
    let unused: Vec<&String> = all.found.difference(&used.found).filter(|option| !excepted.contains(option)).collect();
    assert!(
        unused.is_empty(),
        "no scene in scenes/ uses {unused:#?}: add it to one, such as carousel, and to its hash"
    );
    let needless: Vec<&String> =
        excepted.iter().filter(|option| !all.found.contains(*option) || used.found.contains(*option)).collect();
    assert!(needless.is_empty(), "{needless:?} are no exceptions");
}
