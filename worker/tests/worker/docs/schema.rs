//! Renders descriptions of the JSON Schema as Markdown.

use std::fmt::Write as _;

use scene::kinds::Example;
use serde_json::Value;

use super::shown;

fn referred(property: &Value) -> Option<&str> {
    property["$ref"].as_str().and_then(|reference| reference.rsplit('/').next())
}

/// The name of a property's type, with its range.
fn kind(schema: &Value, property: &Value) -> String {
    let name = referred(property);
    let resolved = name.map_or(property, |name| &schema["$defs"][name]);
    if let Some(choices) = resolved["anyOf"].as_array()
        && choices.iter().all(|choice| choice["$ref"].is_string())
    {
        let kinds: Vec<String> = choices.iter().map(|choice| kind(schema, choice)).collect();
        return kinds.join(" or ");
    }
    if resolved["type"] == "array" && name.is_none() && resolved["items"].is_object() {
        return format!("array of {}", kind(schema, &resolved["items"]));
    }
    // For a number or a track, the range is the number's.
    let number =
        resolved["anyOf"].as_array().and_then(|choices| choices.iter().find(|choice| choice["minimum"].is_number()));
    let ranged = number.unwrap_or(resolved);
    let range = match (&ranged["minimum"], &ranged["maximum"]) {
        (Value::Null, _) | (_, Value::Null) => String::new(),
        (low, high) => format!(", {low} to {high}"),
    };
    let name = name.or_else(|| resolved["type"].as_str()).or_else(|| ranged["type"].as_str()).unwrap_or("value");
    format!("{name}{range}")
}

/// Description of a type.
pub(crate) fn description<'a>(schema: &'a Value, name: &str) -> &'a str {
    schema["$defs"][name]["description"].as_str().unwrap_or_else(|| panic!("{name} is not described"))
}

/// Table of a type's members, a row each; empty if it has none.
pub(crate) fn table(schema: &Value, definition: &Value) -> String {
    if definition["properties"].as_object().is_none_or(serde_json::Map::is_empty) {
        return String::new();
    }
    let required: Vec<&str> =
        definition["required"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    let mut text = "| key | type | default | meaning |\n|---|---|---|---|\n".to_owned();
    for (key, property) in definition["properties"].as_object().into_iter().flatten() {
        let default =
            if required.contains(&key.as_str()) { "required".to_owned() } else { property["default"].to_string() };
        // A row of a table is one line.
        let meaning = property["description"].as_str().unwrap_or_default().replace('\n', " ");
        writeln!(text, "| `{key}` | {} | {default} | {meaning} |", kind(schema, property)).expect("a String takes all");
    }
    text
}

/// Section of one variant: its description before the first example, and each example's picture and JSON.
pub(crate) fn kind_section(schema: &Value, family: &str, example: &Example, file: &str) -> String {
    let shown = shown(&example.name, file, &example.json);
    if example.index > 0 {
        return shown;
    }
    let name = &example.name;
    if schema["$defs"][example.kind].is_object() {
        let table = table(schema, &schema["$defs"][example.kind]);
        return format!("\n## {name}\n\n{}\n\n{table}{shown}", description(schema, example.kind));
    }
    let words = description(schema, &format!("{family}Word"));
    format!("\n## {name}\n\n{}\n{shown}", word(words, name))
}

/// Description of one value in a list of enumerated values, one per item.
fn word<'a>(words: &'a str, name: &str) -> &'a str {
    let mut items = words.split("- `\"").filter_map(|item| item.split_once("\"`: "));
    items.find(|(word, _)| *word == name).expect("the schema has the word").1.trim_end()
}

/// Section about a type that others refer to: its variants, or its members.
pub(crate) fn part(schema: &Value, name: &str) -> String {
    let definition = &schema["$defs"][name];
    let mut text = format!("\n## {name}\n\n{}\n\n", description(schema, name));
    let Some(choices) = definition["oneOf"].as_array() else {
        return text + &table(schema, definition);
    };
    for choice in choices {
        // Each variant is a definition of its own.
        let choice = referred(choice).map_or(choice, |name| &schema["$defs"][name]);
        let meaning = choice["description"].as_str().unwrap_or_default();
        // The description of enumerated values has one line for each.
        if choice["enum"].is_array() {
            writeln!(text, "{meaning}").expect("a String takes all");
        }
        for (key, value) in choice["properties"].as_object().into_iter().flatten() {
            // A variant defined in place has the name of its choice; one with its own type is described there.
            let in_place = referred(value)
                .filter(|inner| inner.to_lowercase() == format!("{}{name}", key.replace('_', "")).to_lowercase());
            let keys: Vec<String> = in_place
                .map_or(&Value::Null, |inner| &schema["$defs"][inner]["properties"])
                .as_object()
                .into_iter()
                .flatten()
                .map(|(key, property)| {
                    let meaning = property["description"].as_str().unwrap_or_default();
                    format!("  - `{key}` ({}): {meaning}\n", kind(schema, property))
                })
                .collect();
            let own = referred(value).map_or(meaning, |name| description(schema, name));
            write!(text, "- `{key}`: {own}\n{}", keys.concat()).expect("a String takes all");
        }
    }
    text
}
